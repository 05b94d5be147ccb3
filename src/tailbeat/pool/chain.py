"""The fish as the plant sees it: bodies, strips, tendons and springs as arrays.

The same tree as the twin's, from the same description: planar root (x, y, yaw), motor, one hinge
per link, in that order. Lengths along a body are x towards the nose from the body's own origin
(the fish frame's for the head, the hinge for a link).
"""

from dataclasses import dataclass
from itertools import pairwise

import mujoco
import numpy as np
from numpy.typing import NDArray

from tailbeat.files import BadInput
from tailbeat.fish.description import Body, Fish, Part, Servo
from tailbeat.fish.show import moment_arms
from tailbeat.fish.twin import compile_twin, inertial

Array = NDArray[np.float64]
Index = NDArray[np.int64]
LONGEST = 0.06  # m, of a strip: four to six on a head
TIE = 3e5  # N/m: an inextensible pair, 0.5 % softer at the shaft than none
TIE_DAMPING = 30.0  # N s/m
FIN = "fin"  # zone whose parts carry circulation

# Added mass of a rectangular plate over that of a section (DNV-RP-C205), heave and pitch, by aspect
# ratio; 1 to 3 were checked against a vortex-ring lattice.
ASPECT = np.array([1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 10.0])
HEAVE = np.array([0.579, 0.690, 0.757, 0.830, 0.872, 0.897, 0.947])
PITCH = np.array([0.83, 0.89, 0.92, 0.95, 0.96, 0.97, 0.98])  # beyond 3 extended by eye


@dataclass(frozen=True, eq=False)
class Chain:
    """Arrays for the compiled step; `nv` = 4 + links. Bodies: head, then links.

    `origin` (b,) x of each body's origin behind its parent's; `mass`, `centre` (x), `inertia` (b,).
    Strips: `strip_body`, `strip` (s, 3) x, length, height. Fins: `fin_body`, `fin` (f, 3) x, chord,
    height. Springs `stiffness`, `damping` (links,). Tendon guides per side: `guide_body`, `guide`
    (2, g, 2) x, y. `motor` (7,): kind (0 pulley, 1 crank), x, radius, half width, sign, inertia,
    mass. `tendon` (5,): stiffness, damping, slack, two-way, tied.
    """

    fish: Fish
    origin: Array
    mass: Array
    centre: Array
    inertia: Array
    strip_body: Index
    strip: Array
    fin_body: Index
    fin: Array
    stiffness: Array
    damping: Array
    guide_body: Index
    guide: Array
    motor: Array
    tendon: Array

    @property
    def nv(self) -> int:
        """Degrees of freedom."""
        return 4 + len(self.stiffness)


def build_chain(fish: Fish) -> Chain:
    """Arrays of a description. Raises BadInput where the plant cannot carry it."""
    bodies = (fish.head, *fish.tail.links)
    hinges = np.array([0.0, *(link.hinge for link in fish.tail.links)])
    known = [inertial(body) for body in bodies]
    strips = [row for b, body in enumerate(bodies) for row in _strips(b, body, hinges[b])]
    fins = [row for b, body in enumerate(bodies) for row in _fins(b, body, hinges[b])]
    if not fins:
        raise BadInput(
            f"{fish.name}: no part is in zone fin; the plant needs a fin to shed a wake."
        )
    scale = fish.tail.stiffness_scale
    stiffness = np.array([link.stiffness * scale for link in fish.tail.links])
    guide_body, guide = _guides(fish, hinges)
    return Chain(
        fish,
        np.diff(hinges, prepend=0.0),
        np.array([k.mass for k in known]),
        np.array([k.centre[0] for k in known]) - hinges,
        np.array([k.inertia[2] for k in known]),
        np.array([row[0] for row in strips], dtype=np.int64),
        np.array([row[1:] for row in strips]).reshape(-1, 3),
        np.array([row[0] for row in fins], dtype=np.int64),
        np.array([row[1:] for row in fins]),
        stiffness,
        stiffness * fish.tail.damping_time,
        guide_body,
        guide,
        _motor(fish),
        _tendon(fish),
    )


def _wet(body: Body) -> list[Part]:
    return [p for p in body.parts if p.zone is not None]


def _strips(number: int, body: Body, x0: float) -> list[tuple[float, ...]]:
    """Slices of a body along x: where parts overlap, the tallest counts, once."""
    parts = [p for p in _wet(body) if p.zone != FIN]
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
    return [(number, p.position[0] - x0, p.size[0], p.size[2]) for p in _wet(body) if p.zone == FIN]


def fin_factors(chord: float, height: float) -> tuple[float, float, float]:
    """Lift slope over 2 pi (Helmbold), and what finite span leaves of a fin's added mass, in heave
    and in pitch."""
    aspect = height / chord
    slope = aspect / (2 + np.sqrt(aspect**2 + 4))
    heave, pitch = np.interp(aspect, ASPECT, HEAVE), np.interp(aspect, ASPECT, PITCH)
    return float(slope), float(heave), float(pitch)


def _guides(fish: Fish, hinges: Array) -> tuple[Index, Array]:
    """Bodies (g,) and places (2, g, 2) of the tendon guides, left then right."""
    rows = [(0, x, y, 1.0) for x, y in fish.tendons.head_guides]
    for number, link in enumerate(fish.tail.links, start=1):
        side = -1.0 if link.crossed else 1.0
        rows += [(number, x - hinges[number], y, side) for x, y in link.guides]
    bodies = np.array([row[0] for row in rows], dtype=np.int64)
    places = np.array([[(x, sign * side * y) for _, x, y, side in rows] for sign in (1, -1)])
    return bodies, places


def _motor(fish: Fish) -> Array:
    motor = fish.motor
    twin = compile_twin(fish)
    data = mujoco.MjData(twin.model)
    mujoco.mj_forward(twin.model, data)
    sign = np.sign(moment_arms(twin, data)[1])
    mass = max(motor.mass, 1e-6)
    kind = 0.0 if motor.kind == "pulley" else 1.0
    inertia = mass * motor.radius**2 / 2
    return np.array([kind, motor.position[0], motor.radius, motor.half_width, sign, inertia, mass])


def _tendon(fish: Fish) -> Array:
    tendons = fish.tendons
    if tendons.stiffness is None:
        return np.array([TIE, TIE_DAMPING, 0.0, 1.0, 1.0])
    two_way = float(tendons.two_way)
    return np.array([tendons.stiffness, tendons.damping, tendons.slack, two_way, 0.0])


SERVO = ("kp", "kv", "armature", "damping", "friction", "force_limit", "delay")


def servo_row(servo: Servo, tail_friction: float) -> Array:
    """The numbers of `SERVO`, the tail's friction added to the servo's own."""
    row = np.array([getattr(servo, name) for name in SERVO])
    row[4] += tail_friction
    return row
