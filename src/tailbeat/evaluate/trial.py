"""Swim a trial: a policy, fish in given waters and scenes, and everything that happened.

The policy gets only observations, from the same `World` as in training.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.control import actions as act
from tailbeat.control.actions import PERIOD, ActionSpace
from tailbeat.control.averages import Averages
from tailbeat.control.camera_yaw import Source
from tailbeat.control.corrections import Corrections
from tailbeat.control.measure import PATIENCE, Measure
from tailbeat.control.motion import MotionFilter
from tailbeat.env import randomize
from tailbeat.env.assess import Decide
from tailbeat.env.errors import Errors
from tailbeat.env.randomize import Randomisation
from tailbeat.env.sensors import SensorModel
from tailbeat.env.task import Scene, Settings, Task, as_seen, sized
from tailbeat.env.world import World, seeds_from
from tailbeat.evaluate import store
from tailbeat.evaluate.runs import SHOWN, Runs
from tailbeat.files import BadInput
from tailbeat.fish.description import Fish, Servo
from tailbeat.link.places import POOL
from tailbeat.pool.mess import Lab, in_lab
from tailbeat.pool.plant import Surroundings
from tailbeat.pool.simulator import PoolSimulator
from tailbeat.pool.water import Water
from tailbeat.pool.wear import Wear

Array = NDArray[np.float64]
CHUNK = 125  # swims in one batch, and in one file
LIMIT = 9.0  # m from the start at which the paper's fish is lost
Progress = Callable[[str, int, int], None]  # condition, swims done, all swims


@dataclass(frozen=True, eq=False)
class Condition:
    """n swims under one condition. Without `water` they are swum in the fish's own twin, with its
    `physics` randomised; `draws` as in `Settings`. `stop` ends a swim at its arrival. `physics` and
    `seconds` are those of the paper's fish, and are taken in the fish's own `measure`. `yaw_rate`
    is the source of the policy's yaw rate, `motion` the filter of its velocities, `averages` the
    time constants of its averages, `corrections` those of its robot."""

    name: str
    fish: Fish
    scene: Scene
    actions: ActionSpace
    water: tuple[Water, ...] | None  # one for each swim
    around: tuple[Surroundings, ...] = (Surroundings(),)  # one, or one for each swim
    servo: Servo | None = None
    wear: tuple[Wear, ...] = (Wear(),)  # one, or one for each swim
    wrong: tuple[Errors, ...] = ()  # none, or one for each swim
    sensors: SensorModel = field(default_factory=SensorModel)
    physics: Randomisation = field(default_factory=Randomisation)
    draws: Array | None = None
    seconds: float = PATIENCE
    stop: bool = True
    measure: Measure = field(default_factory=Measure)
    yaw_rate: Source = "imu"
    motion: MotionFilter | None = None
    averages: Averages | None = None
    corrections: Corrections | None = None

    @property
    def count(self) -> int:
        """Number of swims."""
        return len(self.scene.start)

    @property
    def task(self) -> Task:
        """Its times and limits."""
        return sized(Task(seconds=self.seconds, limit=LIMIT), self.measure)

    @property
    def chunks(self) -> int:
        """Number of files."""
        return -(-self.count // CHUNK)


@dataclass(frozen=True)
class Pool:
    """The pool for a policy.

    The pool's `fish` and `waters`; the `twin` that the policy was trained in; the `actions` of its
    contract, which has the fish's `measure`, what the policy sees (`yaw_rate`, `motion`,
    `averages`, as in `Condition`), and its robot's `corrections`, which swims in the twin do
    without;
    `count` swims per condition, drawn from `seed`;
    `walls` (length, width) [m] of the walled trials, the paper's pool by default; `draws` of the
    twin's posterior as in `Settings` (None: it has none); the level of the `lab` in which each swim
    after a moving target has its own errors.
    """

    fish: Fish
    twin: Fish
    actions: ActionSpace
    waters: tuple[Water, ...]
    count: int
    seed: int
    walls: tuple[float, float] = POOL
    draws: Array | None = None
    measure: Measure = field(default_factory=Measure)
    yaw_rate: Source = "imu"
    motion: MotionFilter | None = None
    averages: Averages | None = None
    corrections: Corrections | None = None
    lab: str = "clean"

    def condition(self, name: str, scene: Scene, **changed: Any) -> Condition:
        """A condition in the pool's waters, used in turn."""
        water = changed.pop("water", pools(self.waters, len(scene.start)))
        own = Condition(name, self.fish, scene, self.actions, water, measure=self.measure)
        return replace(as_seen(own, self), corrections=self.corrections, **changed)

    def in_twin(self, name: str, scene: Scene, draws: Array | None = None) -> Condition:
        """The same swims in the twin, with all noise and randomisation; with `draws`, the water's
        coefficients are drawn from these."""
        own = Condition(name, self.twin, scene, self.actions, None, measure=self.measure)
        return replace(as_seen(own, self), draws=draws)


def part(condition: Condition, chunk: int) -> Condition:
    """One chunk of a condition's swims."""
    own = slice(chunk * CHUNK, (chunk + 1) * CHUNK)
    scene = Scene(*(values[own] for values in vars(condition.scene).values()))
    around = condition.around if len(condition.around) == 1 else condition.around[own]
    wear = condition.wear if len(condition.wear) == 1 else condition.wear[own]
    water, wrong = condition.water and condition.water[own], condition.wrong[own]
    return replace(condition, scene=scene, water=water, around=around, wear=wear, wrong=wrong)


def in_labs(condition: Condition, labs: Sequence[Lab]) -> Condition:
    """A condition of the pool, each swim in its own lab."""
    n = condition.count
    around = condition.around if len(condition.around) == n else condition.around * n
    water = condition.water or ()
    pairs = [in_lab(*one) for one in zip(labs, water, around, strict=True)]
    waters, places = zip(*pairs, strict=True)
    wear, wrong = tuple(lab.wear for lab in labs), tuple(lab.errors for lab in labs)
    return replace(condition, water=waters, around=places, wear=wear, wrong=wrong)


@dataclass(frozen=True, eq=False)
class Chunk:
    """A chunk of a condition's swims, their seeds, and the file to write."""

    condition: Condition
    seeds: tuple[int, ...]
    path: Path


def chunks_of(conditions: Sequence[Condition], out: Path, seed: int) -> list[Chunk]:
    """Every chunk of some conditions. The same seed gives the same noise under all conditions, so
    swim i of one is paired with swim i of another."""
    found = []
    for condition in conditions:
        seeds = seeds_from(seed, condition.count)
        for chunk in range(condition.chunks):
            own = tuple(seeds[chunk * CHUNK :][:CHUNK])
            path = store.chunk_path(out, condition.name, chunk)
            found.append(Chunk(part(condition, chunk), own, path))
    return found


def swim_all(decide: Decide, chunks: Sequence[Chunk], progress: Progress) -> None:
    """Swim every chunk that is not on disk."""
    total, swum = sum(one.condition.count for one in chunks), 0
    for one in chunks:
        if not one.path.is_file():
            swim_chunk(decide, one)
        swum += one.condition.count
        progress(one.condition.name, swum, total)


def swim_chunk(decide: Decide, chunk: Chunk) -> None:
    """Swim a chunk and write its file."""
    store.save(swim(decide, chunk.condition, list(chunk.seeds)), chunk.path)


def swim(decide: Decide, condition: Condition, seeds: list[int]) -> Runs:
    """All swims of a condition together."""
    world, steps = _world(condition, seeds), round(condition.task.seconds / PERIOD)
    log = _Log(world, steps)
    seen, going = world.reset(), np.ones(world.count, bool)
    log.note(world, going, 0)
    for step in range(steps):
        done = world.step(np.asarray(decide(seen), dtype=np.float64))
        seen = done.observation
        log.note(world, going, step + 1)
        out = going & (done.terminated & ~done.reached | log.away(world))
        log.reached |= going & done.reached & ~out
        log.lost |= out
        still = going & ~out & ~(done.reached & condition.stop)
        if not still.any():
            break
        if still.sum() < going.sum():
            world.simulator.keep(still)
        going = still
    return log.runs(world, condition)


def _world(one: Condition, seeds: list[int]) -> World:
    simulator: Any = None
    if one.water is not None:
        simulator = PoolSimulator(one.fish, one.water, one.around, one.servo, one.wear)
    settings = Settings(
        one.actions,
        one.task,
        sensors=one.sensors,
        physics=randomize.sized(one.physics, one.measure),
        draws=one.draws,
        measure=one.measure,
        corrections=one.corrections,
    )
    settings = as_seen(settings, one)
    return World(one.fish, settings, seeds, simulator=simulator, scene=one.scene, wrong=one.wrong)


class _Log:
    """Arrays that are filled while the fish swim."""

    def __init__(self, world: World, steps: int) -> None:
        n, shape = world.count, (world.count, steps + 1)
        self.pose = np.full((*shape, 3), np.nan, np.float32)
        self.target = np.full((*shape, 2), np.nan, np.float32)
        self.motor, self.setpoint = (np.full(shape, np.nan, np.float32) for _ in range(2))
        self.shape = np.full(
            (min(n, SHOWN), steps + 1, world.simulator.qpos.shape[1]), np.nan, "f4"
        )
        self.steps, self.energy = np.zeros(n, np.int64), np.full(n, np.nan, np.float32)
        self.reached, self.lost = np.zeros(n, bool), np.zeros(n, bool)
        self.last = 0

    def note(self, world: World, going: Any, step: int) -> None:
        """Store the state after a control step of the fish still swimming."""
        simulator, shown = world.simulator, going[: len(self.shape)]
        self.pose[going, step], self.target[going, step] = world.pose[going], world.target[going]
        self.motor[going, step] = simulator.qpos[going, simulator.motor]
        self.setpoint[going, step] = act.setpoint(world.space, world.state)[going]
        self.shape[shown, step] = simulator.qpos[: len(self.shape)][shown]
        self.steps[going] = self.last = step
        if hasattr(simulator, "energy"):
            self.energy[going] = simulator.energy[going]

    def away(self, world: World) -> Any:
        """Which fish are out of range of their starts."""
        offset = world.pose[:, :2] - self.pose[:, 0, :2]
        return np.hypot(offset[:, 0], offset[:, 1]) > world.task.limit

    def runs(self, world: World, condition: Condition) -> Runs:
        """The stored arrays, cut after the end of the last swim."""
        end, kinds = self.last + 1, list(dict.fromkeys(condition.water or ()))
        m = condition.measure
        water = np.array([kinds.index(one) for one in condition.water or ()] or [-1] * world.count)
        return Runs(
            self.pose[:, :end], self.target[:, :end], self.motor[:, :end], self.setpoint[:, 1:end],
            self.steps, self.reached, self.lost, self.energy, self.shape[:, :end], water,
            *(np.full(world.count, ratio, np.float32) for ratio in (m.size, m.reach)),
        )  # fmt: skip


def pools(waters: Sequence[Water], count: int) -> tuple[Water, ...]:
    """The waters in turn, for `count` swims. Raises BadInput."""
    if not waters:
        raise BadInput("no waters; give at least one.")
    return tuple(waters[i % len(waters)] for i in range(count))
