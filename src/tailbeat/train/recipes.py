"""How a policy is trained: the paper's way, ours, and a minute's for a smoke test. Data."""

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from tailbeat.env.curriculum import STAGES, Stage
from tailbeat.env.task import Task
from tailbeat.files import BadInput

WIDTH, DEPTH = 286, 3  # of actor and critics (paper)
# float32: two observations, action, reward, two ends, and what lay behind
BYTES_PER_TRANSITION = 4 * (2 * 24 + 6 + 3 + 28)


@dataclass(frozen=True)
class Recipe:
    """Numbers of SAC and of what feeds it.

    `fish` swim at once; after every control step of all come `updates` of `batch`, after every
    `waiting` steps while too few of a stage's targets are judged for a verdict. `discount` is per
    control step, `returns` of them make one transition; `reward_scale` keeps the critics'
    numbers near one; `entropy` is SB3's. `window` episodes make a rolling share; `budget_hours` a
    stage may last before it counts as stalled.
    """

    name: str
    quick: bool  # critics and actor side by side, else SB3's own update
    relabel: bool  # other targets in the buffer
    fish: int
    updates: int
    returns: int
    batch: int
    discount: float
    tau: float  # of the target critics
    rates: tuple[float, ...]  # the first learning rate of each phase
    entropy: str
    reward_scale: float
    buffer: int
    starts: int
    window: int
    budget_hours: float
    waiting: int = 1
    memory: float = 0.0  # of the exploring noise, per control step
    misses: float = 0.0  # m, by which some replayed targets lie beside the way swum
    close_up: bool = False  # networks are given the target's bearing where centimetres count
    rounded: bool = False  # updates multiply in bfloat16 where the processor has units for it
    binds: Literal["fundamental", "signal"] = "fundamental"  # what the generator's ceiling binds
    width: int = WIDTH  # of every layer of actor and critics
    stages: tuple[Stage, ...] = STAGES
    task: Task = field(default_factory=Task)

    @property
    def torch_threads(self) -> int | None:
        """How many threads share one of torch's sums, or None for torch's own number: a quick
        update runs two threads of its own, on one each; SB3's runs on one and shares its sums."""
        return 1 if self.quick else None

    @property
    def buffer_bytes(self) -> int:
        """What the replay buffer takes in memory, and in every checkpoint on disk."""
        return self.buffer * BYTES_PER_TRANSITION


def quick() -> Recipe:
    """Ours: 64 fish, one update per 32 of their steps, five-step returns, replay relabelled."""
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
        rates=(5e-4, 5e-4, 1e-4, 1e-4),
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
    )


def paper() -> Recipe:
    """Plain SB3 SAC at 50 Hz with SB3's defaults, as far as the paper says; 32 fish, one update
    per eight transitions, reward times 0.01 (a trial's; the paper gives none of the three)."""
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
        rates=(3e-4, 3e-4, 3e-4, 3e-4),
        entropy="auto",
        buffer=1_000_000,
        budget_hours=6.0,
        waiting=1,
        memory=0.0,
        misses=0.0,
        close_up=False,
        rounded=False,
        stages=STAGES[:10],
    )


def smoke() -> Recipe:
    """A minute to see that everything works and, mostly, something is learnt: near and large
    targets ahead, small networks."""
    near = Task(nearest=0.3, farthest=0.5, arrival=0.15, seconds=6.0, limit=3.0)
    ahead = (Stage("ahead", 1, 0.0, 0.0, float(np.radians(20))),)
    return replace(
        quick(), name="smoke", fish=32, batch=128, starts=6_000, buffer=60_000, window=60,
        rates=(1e-3,), waiting=1, width=64, stages=ahead, task=near, binds="signal",
    )  # fmt: skip


RECIPES = {"quick": quick, "paper": paper, "smoke": smoke}


def recipe_of(name: str) -> Recipe:
    """A recipe by its name."""
    if name not in RECIPES:
        raise BadInput(f"--recipe {name}: allowed are {', '.join(RECIPES)}.")
    return RECIPES[name]()
