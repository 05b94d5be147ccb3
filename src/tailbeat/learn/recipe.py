"""How a policy is trained: the paper's way, ours, and a minute's for a smoke test. Data."""

from dataclasses import dataclass, field, replace

from tailbeat.files import BadInput
from tailbeat.learn.curriculum import STAGES, Stage
from tailbeat.learn.world import Task

WIDTH, DEPTH = 286, 3  # of actor and critics (paper)
# float32: two observations, action, reward, two ends, and what lay behind
BYTES_PER_TRANSITION = 4 * (2 * 24 + 6 + 3 + 37)


@dataclass(frozen=True)
class Recipe:
    """Numbers of SAC and of what feeds it.

    `fish` swim at once; each action is held for `holds[phase - 1]` control steps; for every control
    step of all fish come `updates` of `batch`, at least one per decision. `discount` is per control
    step; `reward_scale` keeps the critics' numbers near one; `entropy` is SB3's. `window` episodes
    make a rolling share; `budget_hours` a stage may last before it counts as stalled.
    """

    name: str
    quick: bool  # critics and actor side by side, else SB3's own update
    relabel: bool  # other targets and mirror images in the buffer
    fish: int
    holds: tuple[int, int, int]
    updates: float
    batch: int
    discount: float
    tau: float  # of the target critics
    rate: float
    entropy: str
    reward_scale: float
    buffer: int
    starts: int
    window: int
    budget_hours: float
    stages: tuple[Stage, ...] = STAGES
    task: Task = field(default_factory=Task)

    def hold(self, stage: int) -> int:
        """Control steps that an action is held for in a stage."""
        return self.holds[self.stages[stage].phase - 1]

    def updates_per_decision(self, stage: int) -> int:
        """Of all fish in a stage."""
        return max(round(self.updates * self.hold(stage)), 1)

    @property
    def buffer_bytes(self) -> int:
        """What the replay buffer takes in memory, and in every checkpoint on disk."""
        return self.buffer * BYTES_PER_TRANSITION


def quick() -> Recipe:
    """Ours: 64 fish that decide ten times a second in the first phase, where the first competence
    is won, then twenty-five times, then fifty times a second as the robot does."""
    return Recipe(
        name="quick",
        quick=True,
        relabel=True,
        fish=64,
        holds=(5, 2, 1),
        updates=1.6,
        batch=256,
        discount=0.996,
        tau=0.01,
        rate=5e-4,
        entropy="auto_0.02",
        reward_scale=0.01,
        buffer=400_000,
        starts=5_000,
        window=200,
        budget_hours=1.0,
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
        holds=(1, 1, 1),
        updates=4,
        discount=0.99,
        tau=0.005,
        rate=3e-4,
        entropy="auto",
        buffer=1_000_000,
        budget_hours=6.0,
    )


def smoke() -> Recipe:
    """One minute to see that everything works: the first stage with near and large targets."""
    near = Task(nearest=0.3, farthest=0.7, arrival=0.12, seconds=10.0)
    return replace(
        quick(), name="smoke", fish=32, updates=0.8, batch=128, starts=1_000, buffer=50_000,
        window=60, stages=STAGES[:1], task=near,
    )  # fmt: skip


def adapted(recipe: Recipe, actions: str) -> Recipe:
    """A recipe for an action space: without a generator the beat itself is made of decisions, so
    they come at least 25 times a second."""
    if actions == "generator":
        return recipe
    first, second, third = (min(hold, 2) for hold in recipe.holds)
    return replace(recipe, holds=(first, second, third))


RECIPES = {"quick": quick, "paper": paper, "smoke": smoke}


def recipe_of(name: str) -> Recipe:
    """A recipe by its name."""
    if name not in RECIPES:
        raise BadInput(f"--recipe {name}: allowed are {', '.join(RECIPES)}.")
    return RECIPES[name]()
