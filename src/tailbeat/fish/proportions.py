"""A plausible fish from a few measured numbers, with the pulley fish's proportions.

Lengths scale with the fish's length. Widths and heights scale so that the sealed shell displaces
the shell's share of the mass, so the fish floats. Arms and pulley scale with the width. Everything
that is not given is chosen here; `sketch_file.py` marks it as assumed.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tailbeat.files import BadInput
from tailbeat.fish.buoyancy import slender_mass
from tailbeat.fish.catalogue import Profile, profile
from tailbeat.fish.linkage import spread

Array = NDArray[np.float64]
WATER = 1000.0  # kg/m^3
LENGTH = 0.54  # m, the pulley fish's; its numbers below are mm at this length
SHARES = {"shell": 900 / 1218, "mid": 180 / 1218, "tail": 98 / 1218, "fin": 20 / 1218}
MOTOR_SHARE = 20 / 1218
ARMS = (19.5, 14.5, 10.8, 7.6, 4.5)  # mm, from the first hinge to the last
HEIGHTS = (90.0, 80.0, 70.0, 62.0, 55.0)  # mm, of its links
WIDTHS = (40.0, 32.0, 25.0, 18.0, 12.0)  # mm
STIFFNESS = (2.98, 1.31)  # first and last hinge, in proportion
K_EFF = 0.98  # N m/rad at `LENGTH`; it grows with the cube of the length
BAND = (1.0, 4.0)  # Hz at `LENGTH`; it falls with the square root of the length
STROKE = math.radians(80)  # the tendons stay on the pulley
BEND_SHARE = 0.6  # of the stall torque, to bend the tail by the whole stroke
LEAST_STROKE = 0.15  # rad that the servo still makes at the band's top
HIGHEST = 5.0  # Hz: ten of the robot's commands per beat
SOFTEST = 0.01  # of the usual stiffness at its length; below, a unit is wrong (chosen)
LARGEST_TAG = 150.0  # mm of the black square, with its white border on a sheet of A4
# Of a link's length, from a hinge to the guides on both sides. Wider fish have longer arms, and the
# guides would meet in their full stroke: there the gap grows with the width.
GAP = 0.2
SLENDER = (0.5, 2.0)  # allowed ratio of width over length to the pulley fish's
# Added mass of a rectangular plate broadside on, over that of the strip pi/4 short^2 long, by long
# over short side (DNV-RP-C205, appendix D).
PLATE = ((1.0, 0.579), (1.5, 0.69), (2.0, 0.757), (2.5, 0.801), (3.0, 0.83),
         (4.0, 0.872), (6.25, 0.917), (10.0, 0.947))  # fmt: skip


@dataclass(frozen=True)
class Given:
    """What a user measures: `length` from nose to fin [m], `mass` [kg], number of `hinges`, name of
    the `servo`, `fin` chord and span [m], and `k_eff` at the shaft [N m/rad]; None: assumed."""

    length: float
    mass: float
    hinges: int = 5
    servo: str = "xw430"
    fin: tuple[float, float] | None = None
    k_eff: float | None = None


@dataclass(frozen=True)
class Box:
    """A part: `x` of its centre, its `size` [m], `mass` and `added_mass` [kg]."""

    x: float
    size: tuple[float, float, float]
    mass: float
    added_mass: float


@dataclass(frozen=True)
class Segment:
    """A tail link: `hinge` x, `arm` of the tendon, `gap` from the hinge to its guides, next `guide`
    (x, y) or None, flexible strip's height and length [m], `stiffness` [N m/rad], and its part."""

    hinge: float
    arm: float
    gap: float
    guide: tuple[float, float] | None
    strip: tuple[float, float]
    stiffness: float
    box: Box


@dataclass(frozen=True)
class Sketch:
    """All numbers of a fish in SI. `scale` is its length over the pulley fish's, `wide` its width
    over the pulley fish's; `tag` the side of a tag that fits [m]."""

    given: Given
    profile: Profile
    scale: float
    wide: float
    shell: Box
    mid: Box
    tail: tuple[Segment, ...]
    fin: Box
    radius: float
    motor_mass: float
    k_eff: float
    band: tuple[float, float]
    tag: float


def sketch(given: Given) -> Sketch:
    """Every number of a fish from the few given. Raises BadInput for a fish that cannot be."""
    _check(given)
    servo, scale = profile(given.servo), given.length / LENGTH
    wide = _width(given, scale)
    _check_servo(given, servo)
    radius = 17.5e-3 * wide
    fin = _fin(given, scale)
    arms, pattern = _arms(given.hinges) * wide, _pattern(given.hinges)
    k_eff = given.k_eff or _stiffness(scale, servo)
    stiffness = spread(radius, arms, pattern, k_eff)
    _check_bend(given, servo, k_eff)
    return Sketch(
        given, servo, scale, wide,
        _box(10e-3 * scale, (220e-3 * scale, 70e-3 * wide, 110e-3 * wide),
             SHARES["shell"] * given.mass),
        _box(-150e-3 * scale, (100e-3 * scale, 60e-3 * wide, 100e-3 * wide),
             SHARES["mid"] * given.mass),
        _tail(given, scale, wide, fin, arms, stiffness),
        fin, radius, MOTOR_SHARE * given.mass, k_eff, _band(scale, servo),
        _tag(min(scale, wide)),
    )  # fmt: skip


def _check(given: Given) -> None:
    limits = {
        "--length": (given.length, 0.1, 3.0, "m"),
        "--mass": (given.mass, 0.01, 200.0, "kg"),
        "--hinges": (given.hinges, 2, 12, ""),
    }
    for option, (value, low, high, unit) in limits.items():
        if not low <= value <= high:
            said = f"{option} {value:g} {unit}".rstrip()
            raise BadInput(f"{said}: allowed is {f'{low:g} to {high:g} {unit}'.rstrip()}.")
    for side, size, most in zip(("chord", "span"), given.fin or (), (0.25, 1.0), strict=False):
        low, high = 0.02 * given.length, most * given.length
        if not low <= size <= high:
            raise BadInput(
                f"--fin: {side} {1e3 * size:g} mm; a fish of {1e3 * given.length:g} mm may have"
                f" {1e3 * low:.0f} to {1e3 * high:.0f} mm."
            )
    usual = K_EFF * (given.length / LENGTH) ** 3
    if given.k_eff is not None and not given.k_eff >= SOFTEST * usual:
        raise BadInput(
            f"--k-eff {given.k_eff:g} N m/rad: a tail of a fish of {given.length:g} m usually has"
            f" {usual:.2g}; allowed is {SOFTEST * usual:.2g} or more, so check the unit."
        )


def _width(given: Given, scale: float) -> float:
    """Width over the pulley fish's at which the sealed shell carries its share of the mass."""
    volume = SHARES["shell"] * given.mass / WATER
    wide = math.sqrt(volume / (math.pi / 6 * 220e-3 * scale * 70e-3 * 110e-3))
    low, high = (SLENDER[i] * scale for i in (0, 1))
    if not low <= wide <= high:
        masses = [given.mass * (edge / wide) ** 2 for edge in (low, high)]
        raise BadInput(
            f"--mass {given.mass:g} kg: a fish of {given.length:g} m that floats would be"
            f" {1e3 * 70e-3 * wide:.0f} mm wide; allowed is {masses[0]:.2g} to {masses[1]:.2g} kg."
        )
    return wide


def _check_servo(given: Given, servo: Profile) -> None:
    room = (SHARES["shell"] + SHARES["mid"]) * given.mass / 2
    if 1e-3 * servo.mass_g > room:
        raise BadInput(
            f"--servo {servo.name}: it weighs {servo.mass_g:g} g, more than half of the hull of a"
            f" fish of {given.mass:g} kg; choose a lighter servo."
        )


def _check_bend(given: Given, servo: Profile, k_eff: float) -> None:
    if k_eff * LEAST_STROKE > servo.stall_nm:
        raise BadInput(
            f"--servo {servo.name}: its stall torque of {servo.stall_nm:g} N m bends a tail of"
            f" {k_eff:.3g} N m/rad by {math.degrees(servo.stall_nm / k_eff):.1f} deg; choose a"
            f" stronger servo or a softer tail ({servo.stall_nm / LEAST_STROKE:.2g} N m/rad or"
            f" less)."
        )


def _tag(scale: float) -> float:
    """The largest side in whole 5 mm that fits and that a sheet of A4 holds. `scale` is the hull's
    length or width over the pulley fish's, whichever is smaller; that one's tag has 80 mm."""
    return 5e-3 * max(math.floor(min(80 * scale, LARGEST_TAG) / 5 + 1e-9), 1)


def _box(x: float, size: tuple[float, float, float], mass: float) -> Box:
    """A box with the added mass of a slender body, water * pi/4 height^2 length."""
    return Box(x, size, mass, slender_mass(WATER, size))


def _fin(given: Given, scale: float) -> Box:
    chord, span = given.fin or (70e-3 * scale, 160e-3 * scale)
    rear = -420e-3 * scale
    short, long = sorted((chord, span))  # the table is by the longer side
    end = np.interp(long / short, [row[0] for row in PLATE], [row[1] for row in PLATE])
    water = WATER * math.pi / 4 * short**2 * long * float(end)
    size = (chord, 2e-3 * scale, span)
    return Box(rear + chord / 2, size, SHARES["fin"] * given.mass, water)


def _arms(hinges: int) -> Array:
    return 1e-3 * np.interp(np.linspace(0, 1, hinges), np.linspace(0, 1, 5), ARMS)


def _pattern(hinges: int) -> Array:
    """Stiffness of every hinge, in proportion."""
    return np.linspace(*STIFFNESS, hinges)


def _stiffness(scale: float, servo: Profile) -> float:
    """Stiffness at the shaft, no more than the servo can bend."""
    return min(K_EFF * scale**3, BEND_SHARE * servo.stall_nm / STROKE)


def _band(scale: float, servo: Profile) -> tuple[float, float]:
    reach = servo.no_load / (2 * math.pi * LEAST_STROKE)
    top = min(BAND[1] / math.sqrt(scale), reach, HIGHEST)
    return round(top * BAND[0] / BAND[1], 2), round(top, 2)


def _tail(
    given: Given, scale: float, wide: float, fin: Box, arms: Array, stiffness: Array
) -> tuple[Segment, ...]:
    """Links of equal pitch from the mid-body to the fin; the last is half as long."""
    first, front = -215e-3 * scale, fin.x + fin.size[0] / 2
    pitch = (first - front) / (given.hinges - 0.5)
    volumes, gap = _sections(given.hinges, wide), GAP * max(wide / scale, 1.0) * pitch
    found = []
    for i, (height, width) in enumerate(volumes):
        last = i == given.hinges - 1
        hinge, long = first - i * pitch, pitch / 2 if last else pitch
        box = _box(hinge - long / 2, (long, width, height), _tail_mass(given, volumes, i))
        strip = (float(np.interp(i, [0, given.hinges - 1], [61.5e-3, 27.1e-3])) * scale, pitch)
        guide = None if last else (hinge - pitch + gap, float(arms[i + 1]))
        found.append(Segment(hinge, float(arms[i]), gap, guide, strip, float(stiffness[i]), box))
    return tuple(found)


def _sections(hinges: int, wide: float) -> list[tuple[float, float]]:
    """Height and width [m] of every link."""
    along, own = np.linspace(0, 1, hinges), np.linspace(0, 1, 5)
    rows = zip(np.interp(along, own, HEIGHTS), np.interp(along, own, WIDTHS), strict=True)
    return [(1e-3 * wide * float(height), 1e-3 * wide * float(width)) for height, width in rows]


def _tail_mass(given: Given, sections: list[tuple[float, float]], i: int) -> float:
    """The tail's share of the mass, by the links' volumes."""
    halves = [1.0] * (len(sections) - 1) + [0.5]
    volumes = [h * w * half for (h, w), half in zip(sections, halves, strict=True)]
    return SHARES["tail"] * given.mass * volumes[i] / sum(volumes)
