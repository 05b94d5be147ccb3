"""Robots that are worse than their description: drawn at the end of a training.

A policy that reaches its targets in all usual fish meets these in most of its episodes. The numbers
are those that decide in messy labs: a weak servo, friction, a stiff and sticking tail, low fins
(docs/experiments/2026-11-hard-robots.md).
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tailbeat.control.measure import Measure
from tailbeat.env.randomize import Physics, set_servo
from tailbeat.files import BadInput
from tailbeat.fish.description import FIN_ZONE

Array = NDArray[np.float64]
# Powers of 1 + size: fish that swim worse are drawn more often than such as swim better (chosen).
POWERS = ((-1.0, 0.0), (-1.0, 0.25), (-0.5, 1.0), (-1.0, 0.5))  # of torque, gain, stiffness, fin
SHARES = ("share", "full")  # fractions of episodes


@dataclass(frozen=True)
class Hardship:
    """Largest sizes, in a fraction `share` of all episodes.

    The factors on the servo's `torque` and `gain`, the tail's `stiffness` and the height of every
    `fin` are 1 plus these, to a power drawn between those above. `friction` at the shaft [N m],
    `sticking` of the loose tail [rad] and the steady `pull` of a tether [N] are drawn from 0 up,
    `bend` of the tail at rest [rad] to either side. In a fraction `full` of these episodes every
    size is a whole one, as in a lab: a factor is its worst or its best, to a side by chance.
    `farthest` [m] is how far targets are then, 0 for the task's own.
    """

    share: float = 0.0
    full: float = 0.0
    farthest: float = 0.0
    torque: float = 0.0
    gain: float = 0.0
    stiffness: float = 0.0
    fin: float = 0.0
    friction: float = 0.0
    sticking: float = 0.0
    bend: float = 0.0
    pull: float = 0.0


def check(hard: Hardship) -> None:
    """Raises BadInput for a share beyond 0 to 1, or a size that is negative or not finite."""
    for name, value in vars(hard).items():
        most = 1.0 if name in SHARES else np.inf
        if not 0 <= value <= most or not np.isfinite(value):
            allowed = "0 to 1" if name in SHARES else "0 or more"
            raise BadInput(f"hardship: {name} = {value:g}; allowed is {allowed}.")


def sized(paper: Hardship, measure: Measure) -> Hardship:
    """The sizes for the paper's fish in another fish's measure. Friction is that of its lab."""
    return replace(paper, pull=paper.pull * measure.push, farthest=paper.farthest * measure.reach)


def harden(physics: Physics, hard: Hardship, fish: int, rng: np.random.Generator) -> Array:
    """Draw one fish's hardships, after its other physics and before `refresh`. Returns the steady
    pull (2,) [N]."""
    worse, *draws, rub, stick, bent, pull, towards = rng.uniform(size=10).tolist()
    if worse >= hard.share:
        return np.zeros(2)
    if worse < hard.share * hard.full:
        draws, bent, rub, stick, pull = [round(one) for one in draws], round(bent), 1, 1, 1
    fields, usual = physics.fields, physics.nominal
    sizes = zip((hard.torque, hard.gain, hard.stiffness, hard.fin), POWERS, draws, strict=True)
    torque, gain, stiffness, fin = (_factor(*one) for one in sizes)
    set_servo(physics, fish, gain, torque)
    joints, dofs, places = first_hinge(physics)
    springs = stiffness * usual["jnt_stiffness"][joints:]
    fields["jnt_stiffness"][fish, joints:] = springs
    fields["dof_frictionloss"][fish, dofs - 1] += rub * hard.friction
    fields["dof_frictionloss"][fish, dofs:] += stick * hard.sticking / len(springs) * springs
    fields["qpos_spring"][fish, places:] += (2 * bent - 1) * hard.bend / len(springs)
    _lower(physics, fish, fin)
    angle = 2 * np.pi * towards
    return pull * hard.pull * np.array([np.cos(angle), np.sin(angle)])


def first_hinge(physics: Physics) -> tuple[int, int, int]:
    """Joint, degree of freedom and coordinate of the first hinge; the hinges come last, after the
    motor."""
    shaft = physics.twin.model.joint("motor")
    return int(shaft.id) + 1, int(shaft.dofadr[0]) + 1, int(shaft.qposadr[0]) + 1


def _factor(size: float, powers: tuple[float, float], draw: float) -> float:
    low, high = powers
    return float((1 + size) ** (low + (high - low) * draw))


def _lower(physics: Physics, fish: int, factor: float) -> None:
    """Other heights of the fins: forces in proportion, since the law of a plate is of its area. The
    water that the fins carry stays as it is."""
    zones = list(physics.twin.fish.zones)
    if FIN_ZONE not in zones:
        return
    own = physics.twin.zones == zones.index(FIN_ZONE)
    physics.fields["geom_fluid"][fish, own, 1:6] *= factor
    physics.fins[fish] = factor
