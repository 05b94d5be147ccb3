"""What a training run was asked to do, and whether it can: checked before anything is built."""

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path

import psutil
from torch import cuda

from tailbeat.control.actions import ActionSpace, Direct, Filtered, Generator
from tailbeat.env.curriculum import settings_of
from tailbeat.env.task import Settings, check_settings
from tailbeat.files import BadInput, leaves, write_json
from tailbeat.fish.description import Fish
from tailbeat.fish.store import digest
from tailbeat.train.recipes import Recipe, quick

ACTIONS = ("generator", "direct", "filtered")
WORKING_SET = 1.5e9  # bytes that torch, engine and 64 fish take beside the buffer (measured: 1.1e9)


@dataclass(frozen=True)
class RunRecord:
    """What `run.json` holds: the fish's name and digest, action space, recipe, seed."""

    fish: str
    fish_digest: str
    actions: ActionSpace
    recipe: Recipe
    seed: int


@dataclass(frozen=True)
class RunConfig:
    """One training run.

    `out` is its folder; `actions` None is the generator up to the fish's band, as the recipe binds
    it; `hours` is what this session may take, `checkpoint_minutes` lie between two checkpoints;
    `device` is cpu or cuda.
    """

    fish: Fish
    out: Path
    recipe: Recipe = field(default_factory=quick)
    actions: ActionSpace | None = None
    seed: int = 0
    hours: float = 12.0
    device: str = "cpu"
    checkpoint_minutes: float = 5.0

    def space(self) -> ActionSpace:
        """The action space."""
        return self.actions or action_space("generator", self.fish, self.recipe.binds)

    def settings(self, stage: int) -> Settings:
        """The environment's settings in a stage."""
        return settings_of(self.recipe.stages[stage], self.space(), self.recipe.task)

    def record(self) -> RunRecord:
        """What must be the same when the run is resumed."""
        fish = self.fish
        return RunRecord(fish.name, digest(fish), self.space(), self.recipe, self.seed)


def action_space(
    kind: str, fish: Fish, binds: str = "fundamental", floor: float = 0.0
) -> ActionSpace:
    """A fish's action space by name. The generator's ceiling is the band's upper edge, `binds` is
    what keeps below it, and `floor` [Hz] is the lowest fundamental."""
    if kind not in ACTIONS:
        raise BadInput(f"--actions {kind}: allowed are {', '.join(ACTIONS)}.")
    if floor and kind != "generator":
        raise BadInput(f"--floor {floor:g}: {kind} actions have no floor; leave it out.")
    low, high = fish.motor.range or (-3.141592653589793, 3.141592653589793)
    if kind == "direct":
        return Direct(low, high)
    if kind == "filtered":
        return Filtered(low, high)
    if binds == "signal":
        return Generator(low, high, ceiling=fish.band[1], binds="signal", floor=floor)
    if binds != "fundamental":
        raise BadInput(f"--binds {binds}: allowed are fundamental, signal.")
    return Generator(low, high, ceiling=fish.band[1], floor=floor)


def check(run: RunConfig, resume: bool) -> None:
    """Raises BadInput for a folder, a fish, a device or a memory that will not do."""
    if not run.hours > 0:
        raise BadInput(f"--hours {run.hours:g}: give a time above 0.")
    if run.device not in ("cpu", "cuda") or (run.device == "cuda" and not cuda.is_available()):
        raise BadInput(f"--device {run.device}: allowed are cpu, and cuda where there is one.")
    check_settings(run.fish, run.settings(0))
    _check_memory(run.recipe)
    if resume:
        _check_same(run)
    elif run.out.exists() and any(run.out.iterdir()):
        raise BadInput(
            f"{run.out}: holds another run; go on with --resume, or choose a new folder."
        )


def check_stage(run: RunConfig, stage: str) -> None:
    """Raises BadInput for a stage that the recipe does not have."""
    names = [one.name for one in run.recipe.stages]
    if stage not in names:
        raise BadInput(f"--stage {stage!r}: allowed are {', '.join(names)}.")


def _check_memory(recipe: Recipe) -> None:
    free = psutil.virtual_memory().available
    needed = recipe.buffer_bytes + WORKING_SET
    if free < needed:
        raise BadInput(
            f"training needs {needed / 1e9:.1f} GB of memory, {recipe.buffer_bytes / 1e9:.1f} of it"
            f" for the replay buffer) and {free / 1e9:.1f} are free; close something."
        )


def _check_same(run: RunConfig) -> None:
    """The run in the folder must have been asked for the same; names each difference."""
    path = run.out / "run.json"
    if not path.is_file():
        raise BadInput(
            f"{run.out}: no run to resume (run.json is missing); start without --resume."
        )
    try:
        held = leaves("", json.loads(path.read_text(encoding="utf-8")))
    except ValueError:
        raise BadInput(f"{path}: not readable JSON; the run cannot be resumed.") from None
    if held.get("actions.kind") == "generator":
        held.setdefault("actions.floor", 0.0)  # runs begun before the floor have none
    asked = leaves("", json.loads(json.dumps(asdict(run.record()))))
    wrong = [
        f"{name} was {held.get(name)}, now {asked.get(name)}"
        for name in sorted(set(held) | set(asked))
        if held.get(name) != asked.get(name)
    ]
    if wrong:
        raise BadInput(f"{run.out}: another run: {'; '.join(wrong)}. Give what it was begun with.")


def begin(run: RunConfig) -> None:
    """Make the folder and note what was asked for."""
    write_json(run.out / "run.json", asdict(run.record()), overwrite=True)
