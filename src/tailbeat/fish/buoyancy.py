"""Does a described fish float, and level? Does every wet part carry water?"""

import math
from dataclasses import dataclass

import numpy as np

from tailbeat.fish.bodies import Body, Part
from tailbeat.fish.description import Fish, parts_of

FLOATS = 0.15  # share of the mass by which a hull may displace more or less: boxes are rounded
TRIM = 0.05  # share of the length between the centres of mass and of volume
MISSING = 0.02  # share of the mass: added mass that a part may lack


@dataclass(frozen=True)
class Buoyancy:
    """What floats: `mass` and what the sealed parts displace, as ellipsoids and as boxes [kg], with
    flooded parts neutral; x of the centres of mass and of what is displaced [m]."""

    mass: float
    ellipsoids: float
    boxes: float
    centre_of_mass: float
    centre_of_volume: float


def buoyancy(fish: Fish) -> Buoyancy:
    """Mass against displacement. A flooded part displaces what its own material does: taken as
    neutral. Bodies with a stated inertial are taken at its mass."""
    parts = [pair for body in (fish.head, *fish.tail.links) for pair in _masses(body)]
    places = np.array([part.position[0] for part, _ in parts] + [fish.motor.position[0]])
    masses = np.array([mass for _, mass in parts] + [fish.motor.mass])
    boxes = np.array([_displaced(fish, *pair, 1.0) for pair in parts] + [fish.motor.mass])
    round_ = np.array([_displaced(fish, *pair, math.pi / 6) for pair in parts] + [fish.motor.mass])
    return Buoyancy(
        float(masses.sum()),
        float(round_.sum()),
        float(boxes.sum()),
        float(masses @ places / masses.sum()),
        float(round_ @ places / round_.sum()),
    )


def _displaced(fish: Fish, part: Part, mass: float, share: float) -> float:
    """Water that a part displaces [kg] if it fills a `share` of its box; its mass if flooded."""
    return mass if part.flooded else share * fish.medium.density * float(np.prod(part.size))


def _masses(body: Body) -> list[tuple[Part, float]]:
    """The wet parts with their masses; a stated inertial is shared out by volume."""
    stated = body.inertial
    if stated is None:
        return [(part, part.mass) for part in body.parts]
    volumes = np.array([float(np.prod(part.size)) for part in body.parts])
    shares = stated.mass * volumes / volumes.sum()
    return list(zip(body.parts, shares.tolist(), strict=True))


def float_warnings(found: Buoyancy, length: float) -> list[str]:
    """What is wrong with how a fish of a `length` [m] floats."""
    said = []
    if found.mass > (1 + FLOATS) * found.boxes:
        said.append(
            f"it sinks: {found.mass:.3g} kg in a hull that displaces {found.boxes:.3g} kg at most;"
            f" make the sealed parts larger or the fish lighter"
        )
    if found.mass < (1 - FLOATS) * found.ellipsoids:
        ballast = found.ellipsoids - found.mass
        said.append(
            f"it floats up: {found.mass:.3g} kg in a hull that displaces {found.ellipsoids:.3g} kg;"
            f" add {ballast:.2g} kg of ballast, or mark parts that fill with water as flooded"
        )
    apart = found.centre_of_mass - found.centre_of_volume
    if abs(apart) > TRIM * length:
        end = "nose" if apart > 0 else "tail"
        said.append(
            f"it hangs {end}-down: the centre of mass is {1e3 * abs(apart):.0f} mm from the centre"
            f" of what it displaces; move mass towards the {'tail' if apart > 0 else 'nose'}"
        )
    return said


def water_warnings(fish: Fish, mass: float) -> list[str]:
    """Wet parts of a fish of a `mass` [kg] that lack their added mass."""
    if fish.added_inertia == 0:
        return []
    bare = [part for part in parts_of(fish) if part.zone is not None and part.added_mass == 0]
    rho, least = fish.medium.density, MISSING * mass
    dry = [part.name for part in bare if slender_mass(rho, part.size) > least]
    names = ", ".join(dry)
    return [f"no added mass on {names}: density pi/4 height^2 length is a start"] if dry else []


def slender_mass(density: float, size: tuple[float, float, float]) -> float:
    """Water [kg] that a slender part of this size [m] carries sideways: density pi/4 h^2 l."""
    length, _, height = size
    return density * math.pi / 4 * height**2 * length
