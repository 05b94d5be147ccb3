"""Training recipes: the paper's, ours, and one of a minute for a smoke test."""

from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np

from tailbeat.env.curriculum import FOLLOWING, MOVING, STAGES, Stage
from tailbeat.env.task import Task
from tailbeat.files import BadInput
from tailbeat.fish.period import PERIOD

WIDTH, DEPTH = 286, 3  # of actor and critics (paper)
# numbers of a transition in single precision, beside two observations: action, reward, two ends,
# and the data for relabelling
NUMBERS = 6 + 3 + 42


@dataclass(frozen=True)
class Recipe:
    """Parameters of SAC and of the environment.

    `fish` swim at once. After every control step follow `updates` of `batch`; while too few of a
    stage's targets are decided for a promotion, only after every `waiting` steps. `discount` is per
    control step; `returns` steps make one transition; `reward_scale` keeps the critics' values near
    one; `entropy` is SB3's. The success rate is over `window` episodes. A stage longer than
    `budget_hours` counts as stalled.

    Greedy swims are asked for a verdict as soon as a share `promising` of the last episodes to end
    were arrivals, at most every `between` updates; with None once the success rate is high. After
    the first stage the last one is tried, for `leap` updates at `late_rate`; if it is not passed by
    then, the stages between come one by one. After the last stage follow `polish` updates, whose
    rate falls from `late_rate`.
    """

    name: str
    quick: bool  # critics and actor in parallel, else SB3's own update
    relabel: bool  # replayed transitions get other targets
    fish: int
    updates: int
    returns: int
    batch: int
    discount: float
    tau: float  # update factor of the target critics, if there are any
    rates: tuple[float, ...]  # the first learning rate of each phase
    entropy: str
    reward_scale: float
    buffer: int
    starts: int
    window: int
    budget_hours: float
    waiting: int = 1
    memory: float = 0.0  # correlation of the exploration noise from one control step to the next
    misses: float = 0.0  # m, distance of some relabelled targets from the path
    close_up: bool = False  # networks get the target features
    rounded: bool = False  # updates multiply in bfloat16 if the processor supports it
    normalised: bool = False  # critics with normalised layers and no targets; only if `quick`
    binds: Literal["fundamental", "signal"] = "fundamental"  # what stays below the ceiling
    promising: float | None = None
    between: int = 250
    leap: int = 0
    polish: int = 0
    late_rate: float = 3e-4
    greedy: bool = True  # a stage is passed by greedy swims; else by exploring ones (paper)
    width: int = WIDTH  # of every layer of actor and critics
    stages: tuple[Stage, ...] = STAGES
    task: Task = field(default_factory=Task)

    @property
    def torch_threads(self) -> int | None:
        """Threads of one torch operation, or None for torch's default. A quick update runs two
        threads of its own with one each; SB3's update runs on one and splits its operations."""
        return 1 if self.quick else None

    @property
    def horizon(self) -> float:
        """Time after which rewards count 1/e, in the measure of the paper's fish [s]."""
        return PERIOD / (1 - self.discount)

    def buffer_bytes(self, observed: int) -> int:
        """Size of the replay buffer in memory and in every checkpoint [bytes], with so many
        numbers in an observation."""
        return 4 * self.buffer * (2 * observed + NUMBERS)


# neither early verdicts nor a leap or polish
BY_STAGES: dict[str, Any] = {"promising": None, "leap": 0, "polish": 0}


def quick() -> Recipe:
    """Our recipe: 64 fish, one update per 32 of their steps, five-step returns, relabelled replay,
    normalised critics."""
    return Recipe(
        name="quick",
        quick=True,
        relabel=True,
        fish=64,
        updates=2,
        returns=5,
        batch=256,
        discount=0.996,
        tau=0.01,
        rates=(5e-4, 5e-4, 1e-4),
        entropy="auto_0.02",
        reward_scale=0.01,
        buffer=1_200_000,
        starts=20_000,
        window=200,
        budget_hours=1.0,
        waiting=4,
        memory=0.95,
        misses=0.1,
        close_up=True,
        rounded=True,
        normalised=True,
        promising=0.7,
        leap=4_000,
        polish=4_000,
    )


def paper() -> Recipe:
    """The paper's recipe: SB3's SAC at 50 Hz with SB3's defaults, as far as the paper says.

    32 fish, one update per eight transitions, reward times 0.01: these three are chosen, the paper
    does not give them.
    """
    return replace(
        quick(),
        name="paper",
        quick=False,
        relabel=False,
        fish=32,
        updates=4,
        returns=1,
        discount=0.99,
        tau=0.005,
        rates=(3e-4, 3e-4, 3e-4),
        entropy="auto",
        buffer=1_000_000,
        budget_hours=6.0,
        waiting=1,
        memory=0.0,
        misses=0.0,
        close_up=False,
        rounded=False,
        normalised=False,
        greedy=False,
        **BY_STAGES,
    )


def smoke() -> Recipe:
    """A recipe of one minute to see that training works, and usually learns: near and large targets
    ahead, small networks."""
    near = Task(nearest=0.3, farthest=0.5, arrival=0.15, seconds=6.0, limit=3.0)
    ahead = (Stage("ahead", 1, 0.0, 0.0, float(np.radians(20))),)
    return replace(
        quick(), name="smoke", fish=32, batch=128, starts=6_000, buffer=60_000, window=60,
        rates=(1e-3,), waiting=1, width=64, stages=ahead, task=near, binds="signal",
        **BY_STAGES,
    )  # fmt: skip


TASKS = ("reach", "follow")
HORIZONS = 1.0, 60.0  # s; a whole swim to a target lasts 30 (chosen)
EPISODES = 120  # with moving targets that are judged at once; all of them last half a minute
# With moving targets: the share of exploring fish beside them that asks for a verdict, and updates
# between two, since one takes half a minute in which nothing is learnt (chosen).
PROMISING, BETWEEN = 0.85, 1_000
RECIPES = {"quick": quick, "paper": paper, "smoke": smoke}


def following(recipe: Recipe) -> Recipe:
    """The recipe for following moving targets: other stages and another task. Its verdict asks that
    the fish stays beside its target. Its updates are not rounded and its critics not normalised,
    as in the trials of its reward."""
    task, promising = MOVING, PROMISING if recipe.promising else None
    recipe = replace(recipe, normalised=False, **BY_STAGES)
    if recipe.name == "smoke":
        task = replace(task, nearest=0.3, farthest=0.6, seconds=6.0, target_speed=0.1)
        return replace(recipe, stages=FOLLOWING[:1], task=task)
    judged = replace(recipe, window=EPISODES, promising=promising, between=BETWEEN)
    return replace(judged, stages=FOLLOWING, task=task, rounded=False)


def recipe_of(name: str, task: str = "reach", horizon: float | None = None) -> Recipe:
    """A recipe by its name, for a task, reach or follow, that looks ahead by `horizon` [s], None
    for its own. Raises BadInput."""
    if name not in RECIPES:
        raise BadInput(f"--recipe {name}: allowed are {', '.join(RECIPES)}.")
    if task not in TASKS:
        raise BadInput(f"--task {task}: allowed are {', '.join(TASKS)}.")
    found = RECIPES[name]()
    if horizon is not None:
        least, most = HORIZONS
        if not least <= horizon <= most:
            raise BadInput(f"--horizon {horizon:g}: allowed are {least:g} to {most:g} s.")
        found = replace(found, discount=1 - PERIOD / horizon)
    return following(found) if task == "follow" else found
