"""Configuration of a training run, and its checks before anything is built."""

import hashlib
import json
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np
import psutil
from numpy.typing import NDArray
from torch import cuda

from tailbeat.control.actions import ActionSpace
from tailbeat.control.camera_yaw import Source
from tailbeat.control.measure import PAPER, Measure
from tailbeat.control.observation import rows
from tailbeat.env import hardship, randomize
from tailbeat.env.curriculum import averages_of, scaled, settings_of, velocity_filter
from tailbeat.env.errors import Errors
from tailbeat.env.hardship import Hardship
from tailbeat.env.hidden import HIDDEN
from tailbeat.env.measured import measure_of
from tailbeat.env.randomize import Randomisation
from tailbeat.env.task import Settings, check_settings
from tailbeat.files import BadInput, leaves, write_json
from tailbeat.fish.description import Fish
from tailbeat.fish.store import digest
from tailbeat.train.progress import RUN, begun, measure_of_run
from tailbeat.train.recipes import Recipe, quick
from tailbeat.train.spaces import action_space

Array = NDArray[np.float64]
# Options of `train` by the entry of `run.json` that they set, or by its first part.
OPTIONS = {
    "actions.kind": "--actions", "actions.binds": "--binds", "actions.floor": "--floor",
    "actions.offset": "--centre", "recipe": "--recipe or --task",
    "recipe.normalised": "--normalised or --no-normalised", "recipe.discount": "--horizon",
    "seed": "--seed",
    "physics": "--physics", "yaw_rate": "--imu", "errors": "--mess", "build": "--build",
    "hard": "--hard", "velocities": "--velocities", "averages": "--averages", "start": "--start",
}  # fmt: skip
# What older runs had, whose `run.json` does not say so.
EARLIER = {
    "errors": None, "velocities": False, "averages": False, "recipe.normalised": False,
    "hard": None, "build": None, "start": None, "physics": "ranges", "yaw_rate": "imu",
    **{f"measure.{name}": ratio for name, ratio in vars(PAPER).items()},
}  # fmt: skip
LONGER = 10  # times the recipe's polish, with hardships (chosen)
WORKING_SET = 1.5e9  # bytes for torch, engine and 64 fish without the buffer (measured: 1.1e9)


@dataclass(frozen=True)
class RunRecord:
    """Contents of `run.json`: the fish's name and digest, action space, recipe, seed, what the
    physics are drawn from (`ranges` or `posterior` with its digest), the fish's measure, the
    source of the yaw rate, the half widths of what a robot has wrong (None: nothing), the run whose
    networks it started with (None: none), and the hardships of its polish (None: none)."""

    fish: str
    fish_digest: str
    actions: ActionSpace
    recipe: Recipe
    seed: int
    physics: str = "ranges"
    measure: Measure = field(default_factory=Measure)
    yaw_rate: Source = "imu"
    errors: Errors | None = None
    velocities: bool = False
    averages: bool = False
    build: Randomisation | None = None
    start: str | None = None
    hard: Hardship | None = None


@dataclass(frozen=True)
class RunConfig:
    """One training run.

    `out` is its folder. `actions` None are the motor's own up to the fish's band, bound as the
    recipe says. `draws` are a posterior's coefficients (`Settings.draws`), None for ranges. `hours`
    is the most time of this session, `checkpoint_minutes` the time between two checkpoints.
    `device` is cpu or cuda. `measure` is that of the fish, by `measured_run`, or given
    (`measured`). `yaw_rate` is the source of the yaw rate that the policy sees: imu, or camera for
    a robot without an IMU.
    `errors` are half widths of what each episode's robot has wrong, in full once all noise is; None
    without. `build` are half widths of the physics; None takes the usual ones. With `velocities`
    the policy also observes filtered velocities, its own and the target's, as a policy that follows
    always does; with `averages` slow averages too, which takes the velocities along. `start` is the
    folder of a run with whose networks it begins, as if they had passed the last stage. With `hard`
    the polish is `LONGER` and draws these hardships and farther targets, and critics see what is
    hidden from the actor.
    """

    fish: Fish
    out: Path
    recipe: Recipe = field(default_factory=quick)
    actions: ActionSpace | None = None
    seed: int = 0
    hours: float = 12.0
    device: str = "cpu"
    checkpoint_minutes: float = 5.0
    draws: Array | None = field(default=None, compare=False)
    measure: Measure = field(default_factory=Measure)
    yaw_rate: Source = "imu"
    errors: Errors | None = None
    velocities: bool = False
    averages: bool = False
    build: Randomisation | None = None
    start: Path | None = None
    measured: bool = False
    hard: Hardship | None = None

    @property
    def discount(self) -> float:
        """Discount per control step: the recipe's, over the fish's own time."""
        return float(self.recipe.discount ** (1 / self.measure.time))

    def space(self) -> ActionSpace:
        """The action space."""
        return self.actions or action_space(None, self.fish, self.recipe.binds)

    @property
    def informed(self) -> bool:
        """Whether the critics see what is hidden from the actor."""
        return self.hard is not None

    @property
    def polish(self) -> int:
        """Updates after the last stage; with hardships half as many from another run's networks."""
        if self.hard is None:
            return self.recipe.polish
        return self.recipe.polish * LONGER // (1 if self.start is None else 2)

    def settings(self, stage: int, polishing: bool = False) -> Settings:
        """The environment's settings in a stage, or in the polish after the last one."""
        recipe, share = self.recipe, self.recipe.stages[stage].noise
        found = settings_of(recipe.stages[stage], self.space(), recipe.task, self.measure)
        if self.velocities or self.averages:
            found = replace(found, motion=velocity_filter(self.measure))
        if self.build is not None:
            widths = scaled(self.build, recipe.stages[stage].physics)
            found = replace(found, physics=randomize.sized(widths, self.measure))
        if self.averages:
            found = replace(found, averages=averages_of(self.measure))
        wrong = scaled(self.errors, share) if self.errors is not None and share else None
        if polishing and self.hard is not None:
            hard = hardship.sized(self.hard, self.measure)
            farthest = max(found.task.farthest, hard.farthest)
            found = replace(found, hard=hard, task=replace(found.task, farthest=farthest))
        return replace(found, draws=self.draws, yaw_rate=self.yaw_rate, errors=wrong)

    @property
    def buffer_bytes(self) -> int:
        """Size of the replay buffer in memory and in every checkpoint [bytes]."""
        settings = self.settings(0)
        kinds = settings.motion is not None, settings.averages is not None
        return self.recipe.buffer_bytes(len(rows(*kinds)) + HIDDEN * self.informed)

    def record(self) -> RunRecord:
        """What must be equal when the run is resumed."""
        return RunRecord(
            self.fish.name,
            digest(self.fish),
            self.space(),
            self.recipe,
            self.seed,
            _physics(self.draws),
            self.measure,
            self.yaw_rate,
            self.errors,
            self.velocities,
            self.averages,
            self.build,
            None if self.start is None else str(self.start),
            self.hard,
        )


def measured_run(run: RunConfig) -> RunConfig:
    """The run in its fish's own measure, unless one is given; of a run with a `start`, in that
    run's, by which its networks see. Raises BadInput for a fish that hardly swims."""
    if run.measured:
        return run
    found = measure_of(run.fish) if run.start is None else measure_of_run(run.start)
    return replace(run, measure=found, measured=True)


def _physics(draws: Array | None) -> str:
    """Name of what the physics are drawn from."""
    if draws is None:
        return "ranges"
    return f"posterior {hashlib.sha256(draws.tobytes()).hexdigest()[:12]}"


def check(run: RunConfig, resume: bool) -> None:
    """Check folder, fish, device and memory. Raises BadInput."""
    if not run.hours > 0:
        raise BadInput(f"--hours {run.hours:g}: give a time above 0.")
    if run.device not in ("cpu", "cuda") or (run.device == "cuda" and not cuda.is_available()):
        raise BadInput(f"--device {run.device}: allowed are cpu, and cuda if this machine has it.")
    if run.recipe.normalised and not run.recipe.quick:
        raise BadInput(
            f"recipe.normalised = true: recipe {run.recipe.name} has SB3's own update, which has no"
            f" such critics; leave it out, or take recipe quick or smoke."
        )
    if run.hard is not None and not (run.recipe.quick and run.recipe.polish):
        raise BadInput(
            f"--hard: recipe {run.recipe.name} has no polish for this task; take recipe quick and"
            f" task reach."
        )
    if run.start is not None and not run.recipe.quick:
        raise BadInput(f"--start: recipe {run.recipe.name} has no warm start; take quick or smoke.")
    check_settings(run.fish, run.settings(0))
    _check_memory(run.buffer_bytes)
    if resume:
        _check_same(run)
    elif begun(run.out):
        raise BadInput(
            f"{run.out}: contains another run; continue it with --resume, or choose a new folder."
        )
    elif _filled(run.out):
        raise BadInput(f"{run.out}: contains files of something else; choose a new folder.")


def _filled(folder: Path) -> bool:
    return folder.exists() and any(folder.iterdir())


def check_stage(run: RunConfig, stage: str) -> None:
    """Check that the recipe has this stage. Raises BadInput."""
    names = [one.name for one in run.recipe.stages]
    if stage not in names:
        raise BadInput(f"--stage {stage!r}: allowed are {', '.join(names)}.")


def _check_memory(buffer: int) -> None:
    free = psutil.virtual_memory().available
    needed = buffer + WORKING_SET
    if free < needed:
        raise BadInput(
            f"training needs {needed / 1e9:.1f} GB of memory ({buffer / 1e9:.1f} GB"
            f" for the replay buffer), but {free / 1e9:.1f} GB are free; close other programs."
        )


def _check_same(run: RunConfig) -> None:
    """Check that the run in the folder has the same configuration. Raises BadInput naming each
    difference."""
    path = run.out / RUN
    if not begun(run.out):
        where = " in a new folder" if _filled(run.out) else ""
        raise BadInput(
            f"{run.out}: no run to resume ({RUN} is missing); start without --resume{where}."
        )
    try:
        held = leaves("", json.loads(path.read_text(encoding="utf-8")))
    except ValueError:
        raise BadInput(f"{path}: not readable JSON; the run cannot be resumed.") from None
    if held.get("actions.kind") == "generator":
        held.setdefault("actions.floor", 0.0)  # older runs have no floor
    held = EARLIER | held
    for name in ("greedy", "promising", "between", "leap", "polish", "late_rate"):
        held.setdefault(f"recipe.{name}", getattr(run.recipe, name))
    asked = leaves("", json.loads(json.dumps(asdict(run.record()))))
    names = {name for name in set(held) | set(asked) if held.get(name) != asked.get(name)}
    if names:
        wrong = [f"{name} was {held.get(name)}, now {asked.get(name)}" for name in sorted(names)]
        raise BadInput(
            f"{run.out}: another run: {'; '.join(wrong)}. Give the options it was started with"
            f"{_options(names)}."
        )


def _options(names: set[str]) -> str:
    """The options that set these entries of `run.json`, in brackets. Two kinds of actions differ in
    all their entries."""
    if "actions.kind" in names:
        names = {one for one in names if not one.startswith("actions.")} | {"actions.kind"}
    found = {OPTIONS.get(one) or OPTIONS.get(one.split(".")[0]) for one in names}
    told = sorted(one for one in found if one)
    return f" ({', '.join(told)})" if told else ""


def begin(run: RunConfig) -> None:
    """Make the folder and write `run.json`."""
    write_json(run.out / RUN, asdict(run.record()), overwrite=True)
