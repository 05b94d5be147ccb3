"""Ten stages in three phases: sensors, physics, targets; then one of targets that go on moving.

Data, and what follows from a stage. The paper gives the three phases, the rule of promotion and the
learning rate; where the difficulty of a stage stands between nothing and everything is chosen, and
named here. The eleventh stage is ours, and by hand: no policy has passed it, and what it costs of
the ten before it is not known.
"""

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from tailbeat.control.actions import ActionSpace
from tailbeat.env.randomize import Randomisation
from tailbeat.env.sensors import SensorModel
from tailbeat.env.task import Settings, Task

CONE = np.radians(30)  # half angle of the "narrow forward cone" (chosen)
FALL = 0.3  # of the learning rate, per stage within a phase (paper)
LOWEST = 3e-5  # the rate falls no further: at 1e-5 the tenth stage stood still, at 5e-5 unlearnt
FASTEST = 0.18  # m/s of targets that go on: half of what the fish swims (chosen)
FAR = 9.0  # m from the start at which a follower counts as lost (chosen)
PROMOTED = 0.95  # rolling share of targets acquired (paper)
Figures = TypeVar("Figures", SensorModel, Randomisation)
RATES = ("frame_rate",)  # figures of a sensor model that are no errors


@dataclass(frozen=True)
class Stage:
    """One stage: `noise` and `physics` are shares of the full figures, `arc` [rad] the half angle
    of the targets' bearings, `following` the share of targets that go on moving; `by_hand` it is
    entered when asked for by name alone."""

    name: str
    phase: int
    noise: float
    physics: float
    arc: float
    following: float = 0.0
    by_hand: bool = False


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
    Stage("following", 4, 1.0, 1.0, np.pi, 0.5, by_hand=True),
)


OPEN_WATER = Task()  # the paper's targets


def settings_of(
    stage: Stage, actions: ActionSpace | None = None, task: Task = OPEN_WATER
) -> Settings:
    """The environment's settings in a stage of a task."""
    task = replace(task, arc=float(stage.arc))
    if stage.following:
        task = replace(task, following=stage.following, target_speed=FASTEST, limit=FAR)
    return Settings(
        actions=actions,
        task=task,
        sensors=scaled(SensorModel(), stage.noise),
        physics=scaled(Randomisation(), stage.physics),
    )


def scaled(figures: Figures, share: float) -> Figures:
    """Every error or width times `share`."""
    small = {name: share * size for name, size in vars(figures).items() if name not in RATES}
    return replace(figures, **small)


def learning_rate(stages: tuple[Stage, ...], index: int, first: tuple[float, ...]) -> float:
    """The phase's `first` rate, times `FALL` with every stage in it (paper), and not below
    `LOWEST`."""
    phase = stages[index].phase
    before = sum(stage.phase == phase for stage in stages[:index])
    return max(float(first[phase - 1] * FALL**before), LOWEST)
