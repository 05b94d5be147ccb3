"""The rigid pieces of a fish, head and tail links, and what their geometry must be."""

from collections.abc import Mapping, Sequence
from itertools import pairwise

from pydantic import BaseModel, ConfigDict, Field, model_validator

from tailbeat.fish import units as u

SHORTEST = 1e-3  # m: a wet part shorter than this has no chord that could have a trailing edge
OVERHANG = 1.25  # of the head's width: the widest tag that lies on it (chosen)
BESIDE = 0.5  # of the length: how far from the parts a tag, a marker or the motor may be (chosen)


class Model(BaseModel):
    """A table of a fish's file: frozen, without unknown fields."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Part(Model):
    """A box-shaped piece of a body. With a `zone` it feels water, as an ellipsoid whose semi-axes
    are half its size."""

    name: str
    """Name of the part, for messages."""
    position: u.Point3
    """Centre of the box."""
    size: u.Point3
    """Full length, width and height of the box, each above 0."""
    mass: u.Mass = Field(default=0.0, ge=0)
    """Mass of a uniform box. It enters the body's mass, centre and inertia."""
    zone: str | None = None
    """Name of the zone whose coefficients act on the part. Without it the part feels no water."""
    added_mass: u.Mass = Field(default=0.0, ge=0)
    """Water that the part carries sideways. It counts only if the fish's `added_inertia` is above
    0."""
    flooded: bool = False
    """Whether water fills the part. `show` then takes it as neutral. No effect on the twin."""

    @model_validator(mode="after")
    def _sizes(self) -> "Part":
        if min(self.size) <= 0:
            raise ValueError("size must be above 0 in all three directions")
        return self


class Inertial(Model):
    """Mass, centre and inertias of a body, from CAD or a balance."""

    mass: u.Mass = Field(gt=0)
    """Mass of the body."""
    centre: u.Point3
    """Centre of mass."""
    inertia: u.Inertia3
    """Principal moments of inertia about x, y, z through the centre."""

    @model_validator(mode="after")
    def _real(self) -> "Inertial":
        least, middle, most = sorted(self.inertia)
        if least <= 0 or least + middle < most:
            raise ValueError("inertia: each must be above 0, and no larger than the other two sum")
        return self


class Mesh(Model):
    """The user's own STL or OBJ, for pictures of a body."""

    file: str
    """Path of the STL or OBJ, absolute or from the working folder."""
    scale: u.Ratio = Field(default=1.0, gt=0)
    """Factor from the mesh's units to metres."""
    position: u.Point3 = (0.0, 0.0, 0.0)
    """Place of the mesh's origin."""


class Body(Model):
    """A rigid piece of the fish."""

    parts: tuple[Part, ...] = Field(min_length=1)
    """Boxes that the body is made of."""
    inertial: Inertial | None = None
    """Mass, centre and inertias, where they are known better than from the parts."""
    mesh: Mesh | None = None
    """Mesh for pictures. It has no effect on the physics."""


class Link(Body):
    """One tail link behind its passive hinge."""

    hinge: u.Length
    """x of the hinge. It falls from link to link."""
    stiffness: u.AngularStiffness = Field(gt=0)
    """Stiffness of the hinge."""
    strip_height: u.Length | None = Field(default=None, gt=0)
    """Height of the flexible strip that the hinge stands for. A tail's identification spreads the
    measured stiffness in proportion to height over length."""
    strip_length: u.Length | None = Field(default=None, gt=0)
    """Length of the flexible strip that the hinge stands for."""
    guides: u.Points2 = ()
    """Holes (x, y) of the left tendon, from the head. The right tendon's are the mirror image."""
    crossed: bool = False
    """Whether the two tendons swap sides on this link."""


# ---- what is wrong with them, one sentence each -------------------------------------------------


def ends(bodies: Sequence[Body]) -> tuple[float, float]:
    """x of the rear of the rearmost part and of the front of the foremost part [m]."""
    places = [(part.position[0], part.size[0] / 2) for body in bodies for part in body.parts]
    return min(x - half for x, half in places), max(x + half for x, half in places)


def hinge_errors(bodies: Sequence[Body], links: Sequence[Link]) -> list[str]:
    """Hinges out of order, or outside the fish."""
    if any(b.hinge >= a.hinge for a, b in pairwise(links)):
        return ["hinges must run from the head to the fin: each hinge's x below the last"]
    rear, front = ends(bodies)
    return [
        f"tail.links.{i}.hinge is x = {link.hinge:g} m, and all parts are between {rear:g} and"
        f" {front:g} m; give its place in the frame of the parts"
        for i, link in enumerate(links)
        if not rear - 1e-9 <= link.hinge <= front + 1e-9
    ]


def place_errors(bodies: Sequence[Body], places: Mapping[str, u.Triple]) -> list[str]:
    """Places by field that are far ahead of, behind or beside the fish."""
    rear, front = ends(bodies)
    room = BESIDE * (front - rear)
    return [
        f"{field} is x = {x:g}, y = {y:g} m, and all parts are between x = {rear:g} and"
        f" {front:g} m; it may be {room:.2g} m from them"
        for field, (x, y, _) in places.items()
        if not (rear - room <= x <= front + room and abs(y) <= room)
    ]


def mass_errors(bodies: Sequence[Body]) -> list[str]:
    """Head and links without a mass."""
    names = ["head", *(f"link {i}" for i in range(len(bodies) - 1))]
    return [
        f"{name} has no mass; give its parts their masses"
        for name, body in zip(names, bodies, strict=True)
        if body.inertial is None and sum(part.mass for part in body.parts) <= 0
    ]


def tag_errors(head: Body, side: float | None) -> list[str]:
    """A tag that cannot lie on the head: wider than all of its parts by more than a quarter."""
    widest = max((part.size[1] for part in head.parts), default=0.0)
    if side is None or side <= OVERHANG * widest:
        return []
    return [
        f"tag is {1e3 * side:g} mm wide, and the head {1e3 * widest:g} mm; give a tag of"
        f" {1e3 * OVERHANG * widest:.0f} mm or less"
    ]


def chord_errors(bodies: Sequence[Body]) -> list[str]:
    """Wet parts that are too short along x to have a rear end."""
    wet = [part for body in bodies for part in body.parts if part.zone is not None]
    return [
        f"part {part.name!r} is {1e3 * part.size[0]:g} mm long and trailing_edge needs a length of"
        f" {1e3 * SHORTEST:g} mm or more; give its length along x, or remove trailing_edge"
        for part in wet
        if part.size[0] < SHORTEST
    ]


def repeated(what: str, names: Sequence[str]) -> list[str]:
    """A sentence for each name that stands twice: the engine knows things by their names."""
    return [
        f"{what} {name!r} stands there twice; rename one"
        for name in dict.fromkeys(names)
        if names.count(name) > 1
    ]
