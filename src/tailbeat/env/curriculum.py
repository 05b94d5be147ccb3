"""The curriculum of reaching, ten stages in three phases (sensors, physics, targets), and that of
following.

The paper gives the three phases, the rule of promotion and the learning rate. The numbers of each
stage are chosen here. The stages of following are ours.
"""

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from tailbeat.control import averages, motion
from tailbeat.control.actions import ActionSpace
from tailbeat.control.measure import PAPER, Measure
from tailbeat.control.policy import Contract
from tailbeat.env import randomize
from tailbeat.env.errors import Errors
from tailbeat.env.randomize import Randomisation
from tailbeat.env.sensors import SensorModel, motion_filter
from tailbeat.env.task import Settings, Task, sized

CONE = np.radians(30)  # half angle of the "narrow forward cone" (chosen)
FALL = 0.3  # factor on the learning rate per stage within a phase (paper)
LOWEST = 3e-5  # lowest rate: with 1e-5 stage ten did not improve, with 5e-5 it got worse
FASTEST = 0.25  # m/s of moving targets: two thirds of the fish's speed (chosen)
FOLLOWED = 30.0  # s of an episode with moving targets (chosen)
FAR = 12.0  # m from the start at which a fish that follows a target is lost (chosen)
PROMOTED = 0.95  # rolling success rate for promotion (paper)
Figures = TypeVar("Figures", SensorModel, Randomisation, Errors)
RATES = ("frame_rate",)  # numbers of a sensor model that are not errors


@dataclass(frozen=True)
class Stage:
    """One stage. `noise` and `physics` are fractions of the full values; `arc` [rad] is the half
    angle of the targets' bearings at the start."""

    name: str
    phase: int
    noise: float
    physics: float
    arc: float


STAGES = (
    Stage("exact", 1, 0.0, 0.0, CONE),
    Stage("half noise", 1, 0.5, 0.0, CONE),
    Stage("full noise", 1, 1.0, 0.0, CONE),
    Stage("third physics", 2, 1.0, 1 / 3, CONE),
    Stage("two thirds physics", 2, 1.0, 2 / 3, CONE),
    Stage("full physics", 2, 1.0, 1.0, CONE),
    Stage("arc 60", 3, 1.0, 1.0, np.radians(60)),
    Stage("arc 90", 3, 1.0, 1.0, np.radians(90)),
    Stage("arc 120", 3, 1.0, 1.0, np.radians(120)),
    Stage("arc 180", 3, 1.0, 1.0, np.pi),
)
FOLLOWING = (
    Stage("exact", 1, 0.0, 0.0, np.pi),
    Stage("full noise", 1, 1.0, 0.0, np.pi),
    Stage("half physics", 2, 1.0, 0.5, np.pi),
    Stage("full physics", 2, 1.0, 1.0, np.pi),
)


OPEN_WATER = Task()  # the paper's targets
MOVING = Task(0.3, 2.0, seconds=FOLLOWED, limit=FAR, target_speed=FASTEST, follow=True)


def settings_of(
    stage: Stage,
    actions: ActionSpace | None = None,
    task: Task = OPEN_WATER,
    measure: Measure = PAPER,
) -> Settings:
    """The environment's settings in a stage of a task, which is given for the paper's fish, in
    another fish's measure."""
    task = replace(task, arc=float(stage.arc))
    return Settings(
        actions=actions,
        task=sized(task, measure),
        sensors=scaled(SensorModel(), stage.noise),
        physics=randomize.sized(scaled(Randomisation(), stage.physics), measure),
        measure=measure,
        motion=velocity_filter(measure) if task.follow else None,
    )


def velocity_filter(measure: Measure) -> motion.MotionFilter:
    """The filter of observed velocities, in a fish's measure."""
    return motion.sized(motion_filter(), measure)


def averages_of(measure: Measure) -> averages.Averages:
    """The time constants of observed averages, in a fish's measure."""
    return averages.sized(averages.Averages(), measure)


def trained_speed(contract: Contract) -> float:
    """Speed [m/s] of the fastest targets that a policy was trained with; 0 if they stayed. A policy
    that follows, of before this number was in its contract, was trained with `MOVING`."""
    held = contract.training.get("target_speed")
    if isinstance(held, int | float):
        return float(held)
    return 0.0 if contract.motion is None else sized(MOVING, contract.measure).target_speed


def scaled(figures: Figures, share: float) -> Figures:
    """Multiply every error or width by the factor `share`."""
    small = {name: share * size for name, size in vars(figures).items() if name not in RATES}
    return replace(figures, **small)


def learning_rate(stages: tuple[Stage, ...], index: int, first: tuple[float, ...]) -> float:
    """Learning rate of a stage: the phase's `first` rate times `FALL` for every earlier stage of
    the phase (paper), at least `LOWEST`."""
    phase = stages[index].phase
    before = sum(stage.phase == phase for stage in stages[:index])
    return max(float(first[phase - 1] * FALL**before), LOWEST)
