"""The fish as the plant uses it: bodies, strips, fins, tendons and springs.

The same tree as the twin's, from the same description: planar root (x, y, yaw), motor, one hinge
per link, in that order. Positions along a body are x towards the nose from the body's own origin
(the fish frame's for the head, the hinge for a link).
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from tailbeat.files import BadInput
from tailbeat.fish.bodies import Body, Part
from tailbeat.fish.description import FIN_ZONE, Fish, Servo
from tailbeat.fish.linkage import moment_arms
from tailbeat.fish.twin import compile_twin, inertial
from tailbeat.pool.kinematics import FRAME, pose
from tailbeat.pool.tendons import tendon_lengths

Array = NDArray[np.float64]
Rows = NDArray[np.void]
LONGEST = 0.06  # m, longest strip: a head has four to six
TIE = 3e5  # N/m, for inextensible tendons: 0.5 % softer at the shaft than rigid
TIE_DAMPING = 30.0  # N s/m

# Added mass of a rectangular plate over that of a section (DNV-RP-C205), heave and pitch, by aspect
# ratio; 1 to 3 were checked against a vortex-ring lattice.
ASPECT = np.array([1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 10.0])
HEAVE = np.array([0.579, 0.690, 0.757, 0.830, 0.872, 0.897, 0.947])
PITCH = np.array([0.83, 0.89, 0.92, 0.95, 0.96, 0.97, 0.98])  # above 3: extrapolated by eye


# Rows of a `Chain`; lengths and places [m], places along a body from its own origin.
BODY = np.dtype([(name, float) for name in ("origin", "mass", "centre", "inertia")])
STRIP = np.dtype([("body", int), *((name, float) for name in ("x", "length", "height"))])
SHAPE = ("x", "chord", "height", "slope", "heave", "pitch")
FIN = np.dtype([("body", int), *((name, float) for name in SHAPE)])
HINGE = np.dtype([(name, float) for name in ("stiffness", "damping", "rest", "dry")])
GUIDE = np.dtype([("body", int), ("x", float), ("y", float)])
SIZES = ("x", "radius", "half_width", "sign", "inertia", "mass")
MOTOR = np.dtype([("crank", bool), *((name, float) for name in SIZES)])  # no crank: a pulley
LAW = (("stiffness", float), ("damping", float), ("slack", float), ("two_way", bool))
TENDON = np.dtype([*LAW, ("tied", bool), ("left_cut", bool), ("right_cut", bool)])


class Chain(NamedTuple):
    """A fish as the compiled step uses it.

    `bodies` (b,) head, then links: x of the origin behind the parent's, mass [kg], x of the centre,
    inertia [kg m^2]. `strips` (s,) and `fins` (f,): body, x, length or chord, height; for a fin its
    lift slope over 2 pi and the factors of `fin_factors` on added mass. `hinges` (links,):
    stiffness [N m/rad], damping [N m s/rad], angle at rest [rad], friction [N m]. `guides` (2, g)
    of left and right tendon: body, x, y. `motor` and `tendon` (1,): see `MOTOR`, `TENDON`;
    stiffness [N/m], damping [N s/m]. `neutral` (2,): tendon lengths of the straight fish [m].
    `nose`, `rear`: x of the nose on the head, and of the fin's rear edge on the last body.
    """

    bodies: Rows
    strips: Rows
    fins: Rows
    hinges: Rows
    guides: Rows
    motor: Rows
    tendon: Rows
    neutral: Array
    nose: float
    rear: float


def dofs(chain: Chain) -> int:
    """Degrees of freedom: root x, y, yaw, motor, one hinge per link."""
    return 4 + len(chain.hinges)


def build_chain(fish: Fish) -> Chain:
    """Build the chain of a description. Raises BadInput if no part is a fin."""
    bodies = (fish.head, *fish.tail.links)
    hinges = np.array([0.0, *(link.hinge for link in fish.tail.links)])
    strips = [row for b, body in enumerate(bodies) for row in _strips(b, body, hinges[b])]
    fins = [row for b, body in enumerate(bodies) for row in _fins(b, body, hinges[b])]
    if not fins:
        raise BadInput(
            f"{fish.name}: no part has zone fin; the virtual pool needs one. Set it in the file."
        )
    front = [x + length / 2 for body, x, length, _ in strips if body == 0]
    if not front:
        raise BadInput(
            f"{fish.name}: no part of the head outside zone fin has a zone; the virtual pool needs"
            f" one. Set it in the file."
        )
    if fish.motor.kind == "pulley" and not fish.tendons.head_guides:
        raise BadInput(
            f"{fish.name}: tendons.head_guides is missing; the virtual pool needs the hole through"
            f" which the tendon leaves the head. Set it in the file."
        )
    chain = Chain(
        _bodies(bodies, hinges),
        np.array(strips, dtype=STRIP),
        np.array(fins, dtype=FIN),
        _springs(fish),
        _guides(fish, hinges),
        _motor(fish),
        _tendon(fish),
        np.zeros(2),
        max(front),
        fins[-1][1] - fins[-1][2] / 2,
    )
    return chain._replace(neutral=_neutral(chain))


def _bodies(bodies: Sequence[Body], hinges: Array) -> Rows:
    rows, known = np.empty(len(bodies), BODY), [inertial(body) for body in bodies]
    rows["origin"] = np.diff(hinges, prepend=0.0)
    rows["mass"] = [k.mass for k in known]
    rows["centre"] = np.array([k.centre[0] for k in known]) - hinges
    rows["inertia"] = [k.inertia[2] for k in known]
    return rows


def _springs(fish: Fish) -> Rows:
    rows = np.zeros(len(fish.tail.links), HINGE)
    scale = fish.tail.stiffness_scale
    rows["stiffness"] = np.array([link.stiffness * scale for link in fish.tail.links])
    rows["damping"] = rows["stiffness"] * fish.tail.damping_time
    return rows


def _neutral(chain: Chain) -> Array:
    """Tendon lengths (2,) of the straight fish."""
    frames, q = np.zeros(len(chain.bodies), FRAME), np.zeros(dofs(chain))
    lengths = np.zeros(2)
    pose(q, q, chain.bodies, frames)
    tendon_lengths(q, chain, frames, lengths, np.zeros((2, len(q))))
    return lengths


def _wet(body: Body) -> list[Part]:
    return [p for p in body.parts if p.zone is not None]


def _strips(number: int, body: Body, x0: float) -> list[tuple[float, ...]]:
    """Slices of a body along x. Where parts overlap, only the tallest counts."""
    parts = [p for p in _wet(body) if p.zone != FIN_ZONE]
    ends = [(p.position[0] - p.size[0] / 2, p.position[0] + p.size[0] / 2) for p in parts]
    cuts = sorted({round(x, 6) for pair in ends for x in pair})
    found: list[tuple[float, ...]] = []
    for low, high in pairwise(cuts):
        middle = (low + high) / 2
        over = [p.size[2] for p, (a, b) in zip(parts, ends, strict=True) if a <= middle <= b]
        pieces = max(int(np.ceil((high - low) / LONGEST)), 1)
        width = (high - low) / pieces
        if over:
            middles = low + width * (np.arange(pieces) + 0.5)
            found += [(number, float(x) - x0, width, max(over)) for x in middles]
    return found


def _fins(number: int, body: Body, x0: float) -> list[tuple[float, ...]]:
    fins = [(p.position[0], p.size[0], p.size[2]) for p in _wet(body) if p.zone == FIN_ZONE]
    return [(number, x - x0, c, h, *map(float, fin_factors(c, h))) for x, c, h in fins]


def fin_factors(chord: ArrayLike, height: ArrayLike) -> tuple[Array, Array, Array]:
    """Lift slope over 2 pi (Helmbold), and the factors of a finite span on added mass in heave and
    pitch, for fins of any number."""
    aspect = np.asarray(height, float) / np.asarray(chord, float)
    slope = np.asarray(aspect / (2 + np.sqrt(aspect**2 + 4)))
    return slope, plate_factor(aspect), np.asarray(np.interp(aspect, ASPECT, PITCH))


def plate_factor(aspect: Array) -> Array:
    """Added mass in heave of a plate over that of the strip pi/4 chord^2 span, by span over chord.
    The table is by the longer side; where that is the chord, the strip counts it too often."""
    longer = np.maximum(aspect, 1 / aspect)
    return np.asarray(np.minimum(aspect, 1.0) * np.interp(longer, ASPECT, HEAVE))


def _guides(fish: Fish, hinges: Array) -> Rows:
    """Tendon guides (2, g), left then right."""
    rows = [(0, x, y, 1.0) for x, y in fish.tendons.head_guides]
    for number, link in enumerate(fish.tail.links, start=1):
        side = -1.0 if link.crossed else 1.0
        rows += [(number, x - hinges[number], y, side) for x, y in link.guides]
    sides = [[(body, x, sign * side * y) for body, x, y, side in rows] for sign in (1, -1)]
    return np.array(sides, dtype=GUIDE)


def _motor(fish: Fish) -> Rows:
    motor = fish.motor
    twin = compile_twin(fish)
    data = mujoco.MjData(twin.model)
    mujoco.mj_forward(twin.model, data)
    sign = float(np.sign(moment_arms(twin, data)[1]))
    mass = max(motor.mass, 1e-6)
    inertia = mass * motor.radius**2 / 2
    x, crank = motor.position[0], motor.kind == "crank"
    row = (crank, x, motor.radius, motor.half_width, sign, inertia, mass)
    return np.array([row], dtype=MOTOR)


def _tendon(fish: Fish) -> Rows:
    tendons = fish.tendons
    row = (tendons.stiffness, tendons.damping, tendons.slack, tendons.two_way, False, False, False)
    tie = (TIE, TIE_DAMPING, 0.0, True, True, False, False)
    return np.array([tie if tendons.stiffness is None else row], dtype=TENDON)


NAMES = ("kp", "kv", "armature", "damping", "friction", "force_limit", "delay")
# Units as in `description.Servo`; `fade`: see `dynamics.fading`.
SERVO = np.dtype([(name, float) for name in (*NAMES, "fade")])


def servo_rows(servos: Sequence[Servo], tail_friction: float) -> Rows:
    """Servos (n,) as rows of `SERVO`, the tail's friction [N m] added to the servo's own."""
    rows = np.array([(*(getattr(one, name) for name in NAMES), 0.0) for one in servos], dtype=SERVO)
    rows["friction"] += tail_friction
    return rows
