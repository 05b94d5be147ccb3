"""A fish, as numbers: TOML read into frozen, validated models.

Frame of every position: the fish frame at the straight pose, x towards the nose, y left, z up, one
common origin of the author's choice. Everything is SI inside; a file may use any unit of
`units.UNITS`. What the engine makes of it is in `twin.py`.
"""

from itertools import pairwise
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from tailbeat.fish import units as u

SHORTEST = 1e-3  # m: a wet part shorter than this has no chord that could have a trailing edge
COEFFICIENTS = ("blunt", "slender", "angular", "kutta", "magnus")  # the engine's order


class _Model(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Medium(_Model):
    """The water: one density [kg/m^3] and one dynamic viscosity [Pa s]."""

    density: u.Density = Field(gt=0)
    viscosity: u.Viscosity = Field(ge=0)


class Simulation(_Model):
    """Step [s] and integrator. Why `implicit` and 2 ms by default: docs/explain/twin.md."""

    step: u.Time = Field(default=0.002, gt=0, le=0.02)
    integrator: Literal["implicit", "implicitfast", "Euler", "RK4"] = "implicit"


class Zone(_Model):
    """Five coefficients of the ellipsoid law (no unit, 0 or more): docs/explain/fluid-law.md."""

    blunt: u.Ratio = Field(ge=0)
    slender: u.Ratio = Field(ge=0)
    angular: u.Ratio = Field(ge=0)
    kutta: u.Ratio = Field(ge=0)
    magnus: u.Ratio = Field(ge=0)

    def row(self) -> tuple[float, ...]:
        """The five numbers in the engine's order."""
        return tuple(getattr(self, name) for name in COEFFICIENTS)


class TrailingEdge(_Model):
    """Only the rear end of a wet part sheds circulation (`edge.py`).

    Its lift is that of the engine's law ahead and `reverse` times it astern; the two are blended
    over `speed` [m/s] of the flow along the chord. `reverse` is 1 in the bare engine, 0 without
    lift astern, and -1 where the rear end keeps the circulation whichever way the water goes.
    """

    speed: u.Speed = Field(default=0.03, gt=0, le=0.5)
    reverse: u.Ratio = Field(default=-1.0, ge=-1, le=1)


class Part(_Model):
    """A box-shaped piece of a body: `size` is its full length, width and height.

    `mass` enters the body's mass, centre and inertia as a uniform box. With a `zone` the part also
    feels water, as an ellipsoid whose semi-axes are half its size. `added_mass` [kg] is the water
    it carries sideways; it counts only when `added_inertia` of the fish is above zero.
    """

    name: str
    position: u.Point3
    size: u.Point3
    mass: u.Mass = Field(default=0.0, ge=0)
    zone: str | None = None
    added_mass: u.Mass = Field(default=0.0, ge=0)

    @model_validator(mode="after")
    def _sizes(self) -> "Part":
        if min(self.size) <= 0:
            raise ValueError("size must be above 0 in all three directions")
        return self


class Inertial(_Model):
    """Mass, centre of mass and principal inertias (x, y, z) of a body, from CAD or a balance."""

    mass: u.Mass = Field(gt=0)
    centre: u.Point3
    inertia: u.Inertia3


class Mesh(_Model):
    """The user's own STL or OBJ for the looks of a body; `scale` turns its units into metres."""

    file: str
    scale: u.Ratio = Field(default=1.0, gt=0)
    position: u.Point3 = (0.0, 0.0, 0.0)


class Body(_Model):
    """A rigid piece: its parts, and `inertial` where it is known better than from the parts."""

    parts: tuple[Part, ...] = Field(min_length=1)
    inertial: Inertial | None = None
    mesh: Mesh | None = None


class Link(Body):
    """One tail link behind its passive hinge.

    `hinge` is the x of the hinge [m]; `guides` the tendon holes (x, y) of the left tendon, in order
    from the head, the right tendon's being their mirror image; `crossed` swaps sides on this link.
    `strip_height` and `strip_length` are of the flexible strip that the hinge stands for: a tail's
    identification spreads the measured stiffness in proportion to height over length.
    """

    hinge: u.Length
    stiffness: u.AngularStiffness = Field(gt=0)
    strip_height: u.Length | None = Field(default=None, gt=0)
    strip_length: u.Length | None = Field(default=None, gt=0)
    guides: u.Points2 = ()
    crossed: bool = False


class Motor(_Model):
    """What moves the tendons.

    A `pulley` turns about the vertical axis and winds one tendon while paying out the other; a
    `crank` turns about the transverse axis with one arm per side, 180 degrees apart, and may turn
    for ever. `radius` is the pulley's or the crank's; `half_width` the |y| of the crank's arms.
    """

    kind: Literal["pulley", "crank"]
    position: u.Point3
    radius: u.Length = Field(gt=0)
    half_width: u.Length = Field(default=0.0, ge=0)
    mass: u.Mass = Field(default=0.0, ge=0)
    range: u.AngleRange | None = None


class Servo(_Model):
    """Position servo: torque = kp (command(t - delay) - angle) - kv speed, within the limit.

    `armature` and `damping` and `friction` sit on the shaft. Units: N m/rad, N m s/rad, kg m^2,
    N m, s.
    """

    kp: u.AngularStiffness = Field(gt=0)
    kv: u.AngularDamping = Field(ge=0)
    armature: u.Inertia = Field(gt=0)
    damping: u.AngularDamping = Field(ge=0)
    friction: u.Torque = Field(default=0.0, ge=0)
    force_limit: u.Torque = Field(gt=0)
    delay: u.Time = Field(ge=0, le=0.2)


class Tendons(_Model):
    """The antagonistic pair.

    Without `stiffness` the pair is inextensible (a constraint). With it, each tendon is a spring
    [N/m] with `damping` [N s/m] that pulls once it is longer than its rest length by `slack` [m],
    and never pushes; with `two_way` it pushes too.
    """

    stiffness: u.LinearStiffness | None = Field(default=None, gt=0)
    damping: u.LinearDamping = Field(default=0.0, ge=0)
    slack: u.Length = Field(default=0.0, ge=0)
    two_way: bool = False
    head_guides: u.Points2 = ()


class Tail(_Model):
    """The chain of links. `k_eff` is the stiffness at the shaft that the numbers must give,
    `damping_time` the ratio of damping to stiffness in every hinge, `friction` the Coulomb friction
    of tail and tendons as the shaft feels it."""

    k_eff: u.AngularStiffness | None = None
    stiffness_scale: u.Ratio = Field(default=1.0, gt=0)
    damping_time: u.Time = Field(default=0.0, ge=0)
    friction: u.Torque = Field(default=0.0, ge=0)
    links: tuple[Link, ...] = Field(min_length=1)


class Marker(_Model):
    """A point that a camera follows. `body` is `head` or the index of a link."""

    name: str
    body: Literal["head"] | int
    position: u.Point3


class Uncertain(_Model):
    """A number that no bench measured and the fluid fit may move, with its range and spread.

    `field` is a dotted path such as `tendons.slack`; `low`, `high` and the values are SI. With
    `log`, `spread` is the standard deviation of ln(value), else in SI.
    """

    field: str
    unit: str
    low: float
    high: float
    spread: float = Field(gt=0)
    log: bool = True


class Fish(_Model):
    """A fish; see the module's docstring for frame and units.

    `tracked` is the point whose pose recordings hold; `band` the beat frequencies [Hz] that the
    description is meant for; `added_inertia` scales the parts' `added_mass` (0 is off), of which
    the share `added_along` acts along the parts too (1: alike in all directions; `surge.py`).
    `trailing_edge` says how lift depends on the direction of the flow; without it the rear and the
    front end of each part count alike, as in the bare engine and the paper.
    """

    name: str
    summary: str = ""
    medium: Medium
    simulation: Simulation = Simulation()
    band: u.FrequencyRange
    zones: dict[str, Zone]
    head: Body
    motor: Motor
    servo: str
    servos: dict[str, Servo]
    tendons: Tendons = Tendons()
    tail: Tail
    markers: tuple[Marker, ...] = ()
    tracked: u.Point3 = (0.0, 0.0, 0.0)
    uncertain: tuple[Uncertain, ...] = ()
    added_inertia: u.Ratio = Field(default=0.0, ge=0)
    added_along: u.Ratio = Field(default=1.0, ge=0, le=1)
    trailing_edge: TrailingEdge | None = None

    @model_validator(mode="after")
    def _consistent(self) -> "Fish":
        for complaint in (*_name_errors(self), *_geometry_errors(self)):
            raise ValueError(complaint)
        return self


def _name_errors(fish: Fish) -> list[str]:
    """Names that point to nothing."""
    zones, links = ", ".join(fish.zones), len(fish.tail.links)
    found = []
    if fish.servo not in fish.servos:
        found.append(f"servo {fish.servo!r} is not one of {', '.join(fish.servos)}")
    for part in (p for body in (fish.head, *fish.tail.links) for p in body.parts):
        if part.zone is not None and part.zone not in fish.zones:
            found.append(
                f"part {part.name!r} names zone {part.zone!r}, which is not one of {zones}"
            )
    for marker in fish.markers:
        if marker.body != "head" and not 0 <= marker.body < links:
            found.append(f"marker {marker.name!r} sits on link {marker.body} of {links}")
    return found


def _geometry_errors(fish: Fish) -> list[str]:
    """Shapes that cannot be: hinges out of order, an empty band, a pulley that unwinds."""
    hinges = [link.hinge for link in fish.tail.links]
    found = []
    if any(b >= a for a, b in pairwise(hinges)):
        found.append("hinges must run from the head to the fin, x falling from link to link")
    if not 0 <= fish.band[0] < fish.band[1]:
        found.append(f"band {list(fish.band)} must rise from a frequency of 0 or more [Hz]")
    if fish.motor.kind == "pulley" and fish.motor.range is None:
        found.append("a pulley needs motor.range, within -85 to 85 deg")
    if fish.motor.range is not None and max(map(abs, fish.motor.range)) > 1.4836:
        found.append(
            "motor.range must lie within -85 to 85 deg: beyond, the tendon leaves the pulley"
        )
    if fish.trailing_edge is not None:
        found += _chord_errors(fish)
    if fish.tendons.stiffness is None and (fish.tendons.slack or fish.tendons.two_way):
        found.append("tendons.slack and two_way need a tendons.stiffness")
    return found


def _chord_errors(fish: Fish) -> list[str]:
    """Wet parts that are discs across the flow: they have no rear end."""
    wet = [p for body in (fish.head, *fish.tail.links) for p in body.parts if p.zone is not None]
    return [
        f"part {part.name!r} is {1e3 * part.size[0]:g} mm long and trailing_edge needs a length of"
        f" {1e3 * SHORTEST:g} mm or more; give its length along x, or remove trailing_edge"
        for part in wet
        if part.size[0] < SHORTEST
    ]
