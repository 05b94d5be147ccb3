"""The task: targets and ends of episodes, reward, sensors, physics."""

from dataclasses import Field, dataclass, field, replace
from typing import Any, ClassVar, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from tailbeat.control import actions as act
from tailbeat.control.actions import PERIOD, ActionSpace, Generator, Turning
from tailbeat.control.averages import Averages
from tailbeat.control.camera_yaw import Source
from tailbeat.control.corrections import Corrections
from tailbeat.control.measure import ARRIVAL, PATIENCE, Measure
from tailbeat.control.motion import MotionFilter
from tailbeat.control.policy import Contract
from tailbeat.env import errors, hardship, randomize
from tailbeat.env.errors import Errors
from tailbeat.env.hardship import Hardship
from tailbeat.env.randomize import Randomisation
from tailbeat.env.reward import Reward
from tailbeat.env.sensors import SensorModel
from tailbeat.files import BadInput
from tailbeat.fish.description import Fish

Array = NDArray[np.float64]


class Record(Protocol):
    """Any dataclass."""

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]


Seeing = TypeVar("Seeing", bound=Record)
SEEN = ("yaw_rate", "motion", "averages")  # fields of a contract that say what a policy sees


@dataclass(frozen=True)
class Task:
    """Where targets are and when an episode ends.

    Targets are drawn at `nearest` to `farthest` [m] and at `least_arc` to `arc` [rad] to either
    side of straight ahead. `arrival` [m] is the paper's. `seconds` until time-out; `limit` [m] from
    the start at which the fish is lost; `walls` (length, width) [m] of a pool about the start, or
    None. With `follow` an arrival ends nothing: targets stay or move at up to `target_speed` [m/s]
    (`target_paths`) until time-out.
    """

    nearest: float = 0.5
    farthest: float = 2.5
    arc: float = np.pi
    least_arc: float = 0.0
    arrival: float = ARRIVAL
    seconds: float = PATIENCE
    limit: float = 6.0
    walls: tuple[float, float] | None = None
    target_speed: float = 0.0
    follow: bool = False


@dataclass(frozen=True, eq=False)
class Scene:
    """Given starts and targets instead of drawn ones, for trials.

    `start` (n, 3) x, y, yaw of the fish frame; `velocity` (n, 3) of it, in world axes. `target` (n,
    k, 2): position of each target at the start and after every control step; the last one is kept.
    A target waits while its fish is farther than `lead` (n,) [m] away; with infinite `lead` it
    moves on a fixed schedule.
    """

    start: Array
    velocity: Array
    target: Array
    lead: Array

    def at(self, step: NDArray[np.int64]) -> Array:
        """Positions (n, 2) of the targets after `step` (n,) control steps."""
        last = self.target.shape[1] - 1
        return np.asarray(self.target[np.arange(len(step)), np.minimum(step, last)])


@dataclass(frozen=True)
class Settings:
    """Settings of an environment, except the fish. `draws` (d, zones, 5): coefficients of a
    posterior over the fish's own, drawn instead of `physics.fluid` (None: without). `errors`: half
    widths of what each episode's robot has wrong (None: nothing)."""

    actions: ActionSpace | None = None  # None: the motor's own, over its range
    task: Task = field(default_factory=Task)
    reward: Reward = field(default_factory=Reward)
    sensors: SensorModel = field(default_factory=SensorModel)
    physics: Randomisation = field(default_factory=Randomisation)
    draws: Array | None = field(default=None, compare=False)
    measure: Measure = field(default_factory=Measure)  # of rewards and observations
    yaw_rate: Source = "imu"  # what the observed yaw rate comes from
    motion: MotionFilter | None = None  # of the observed velocities; None: they are not observed
    averages: Averages | None = None  # their time constants; None: they are not observed
    errors: Errors | None = None
    hard: Hardship | None = None  # in the twin alone; None: no robot is worse than usual
    corrections: Corrections | None = None  # of one robot; None: its readings stay as they are


def settings_for(contract: Contract) -> Settings:
    """The settings that a policy's contract asks for: its actions, targets in its measure, what it
    sees, and the corrections of its robot."""
    measure = contract.measure
    found = Settings(contract.actions, sized(Task(), measure), measure=measure)
    return replace(as_seen(found, contract), corrections=contract.corrections)


def as_seen(one: Seeing, other: Any) -> Seeing:
    """The first with what fish see as in the second: the source of the yaw rate, the filter of the
    velocities, the averages. Either may be settings, a contract, or a trial's pool or condition."""
    return replace(one, **{name: getattr(other, name) for name in SEEN})


def sized(task: Task, measure: Measure) -> Task:
    """A task of the paper's fish in another fish's measure."""
    reach, walls = measure.reach, task.walls
    return replace(
        task,
        nearest=task.nearest * reach,
        farthest=task.farthest * reach,
        arrival=task.arrival * measure.size,
        seconds=round(task.seconds * measure.time / PERIOD) * PERIOD,
        limit=task.limit * reach,
        walls=walls and (walls[0] * reach, walls[1] * reach),
        target_speed=task.target_speed * measure.speed,
    )


def check_settings(fish: Fish, settings: Settings) -> ActionSpace:
    """Check the settings; returns the action space. Raises BadInput for settings that
    contradict."""
    low, high = fish.motor.range or (-np.inf, np.inf)
    turns = fish.motor.kind == "crank"
    space = settings.actions or (Turning(fish.band[1]) if turns else Generator(low, high))
    act.check_space(space)
    if turns != isinstance(space, Turning):
        fits = "turning" if turns else "generator, direct or filtered"
        raise BadInput(
            f"actions: {space.kind} for {fish.name}, whose motor is a {fish.motor.kind}; give"
            f" {fits}."
        )
    if space.low < low or space.high > high:
        raise BadInput(
            f"actions: range {space.low:g} to {space.high:g} rad; {fish.name}'s motor allows"
            f" {low:g} to {high:g} rad."
        )
    act.check_band(space, fish.band[1])
    if settings.averages is not None and settings.motion is None:
        raise BadInput("averages: they are of velocities too; give motion, the filter of these.")
    randomize.check(settings.physics)
    if settings.errors is not None:
        errors.check_widths(settings.errors)
    if settings.hard is not None:
        hardship.check(settings.hard)
    _check_task(settings.task)
    return space


def _check_task(task: Task) -> None:
    if not task.arrival < task.nearest <= task.farthest:
        raise BadInput(
            f"task: targets from {task.nearest:g} to {task.farthest:g} m with arrival at"
            f" {task.arrival:g} m; allowed is arrival < nearest <= farthest."
        )
    if task.farthest > task.limit:
        raise BadInput(
            f"task: farthest {task.farthest:g} m is above limit {task.limit:g} m; reduce it."
        )
    if task.walls is not None and task.nearest > min(task.walls) / 2:
        raise BadInput(
            f"task: no target at {task.nearest:g} m or more fits into walls {task.walls}; use a"
            f" larger pool or nearer targets."
        )
    if not 0 <= task.least_arc <= task.arc <= np.pi or not task.seconds > 0:
        raise BadInput(
            f"task: bearings from {task.least_arc:g} to {task.arc:g} rad, {task.seconds:g} s;"
            f" allowed are 0 to pi, the least one first, and above 0 s."
        )
