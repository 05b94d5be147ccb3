"""Train a policy again for one robot: with the twin that its logs tell, and its own corrections.

With the folder of its training it begins with those networks and polishes them, else from nothing.
Parent and new policy then swim to the same targets in the new twin: a polish can also lose.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from tailbeat.control.policy import Contract, Policy, decide, load_policy
from tailbeat.env import randomize
from tailbeat.env.assess import Summary, Swims, assess
from tailbeat.env.errors import Errors
from tailbeat.env.hardship import Hardship
from tailbeat.env.randomize import Randomisation
from tailbeat.env.world import World
from tailbeat.files import BadInput, refuse_existing
from tailbeat.fish.description import Fish
from tailbeat.fish.store import load_fish
from tailbeat.identify.log_pieces import pieces
from tailbeat.identify.logs import Progress
from tailbeat.robot.fits import twin_of
from tailbeat.robot.logged import logged
from tailbeat.robot.refit import Refitted, refit
from tailbeat.train.config import RunConfig, check
from tailbeat.train.progress import Report
from tailbeat.train.recipes import RECIPES, recipe_of
from tailbeat.train.refine import write
from tailbeat.train.train import silent, train

Array = NDArray[np.float64]
Widths = TypeVar("Widths", Errors, Randomisation, Hardship)
RETRAINED = "retrained.onnx"
SURE = 1.64  # standard errors by which the new policy must be sooner: 95 %
TARGETS, SEED = 250, 31_000  # by which parent and new policy are compared


@dataclass(frozen=True)
class AgainConfig:
    """What to train again: the file or name of the `fish` that the policy was trained on; the
    folder `out`; the folder of its training to `start` from, None without; at most `hours`."""

    fish: str
    out: Path
    start: Path | None = None
    hours: float = 0.5


@dataclass(frozen=True)
class Again:
    """A policy trained again: its file, how both reach the same targets in the new twin, and
    whether the new one surely reaches them sooner (a miss counts as the longest)."""

    policy: str
    before: Summary
    after: Summary
    better: bool


def planned(policy: str, logs: Sequence[Path], config: AgainConfig) -> RunConfig:
    """The training, before anything is fitted or written. Raises BadInput for a training that would
    be refused, or logs that are too short."""
    parent = load_policy(policy)
    refuse_existing(config.out / RETRAINED)
    fish, out = twin_of(parent, config.fish), config.out / "train"
    run = replace(run_again(parent.contract, fish, out, config.start), hours=config.hours)
    check(run, resume=False)
    pieces([logged(path) for path in logs])
    return run


def refitted(
    parent: Policy, run: RunConfig, logs: Sequence[Path], source: str, told: Progress
) -> tuple[Refitted, RunConfig]:
    """Refit the fish of the file `source` to logs, freed of the parent's corrections; also the
    training with it. Writes `NAME-refitted.toml` and its report beside the run's folder. Raises
    BadInput."""
    twin = run.out.parent / f"{run.fish.name}-refitted.toml"
    found = refit(source, run.fish, logs, twin, parent.contract.corrections, told)
    own = load_fish(str(twin)).model_copy(update={"servo": run.fish.servo})
    return found, replace(run, fish=own)


def run_again(contract: Contract, fish: Fish, out: Path, start: Path | None) -> RunConfig:
    """The training of a contract's policy, in the same measure, with another twin of its fish.
    Raises BadInput for a policy that was not trained, or with a posterior."""
    told = contract.training
    name, physics = str(told.get("recipe", "")), str(told.get("physics", "ranges"))
    if name not in RECIPES or physics != "ranges":
        what = f"recipe {name!r}" if name not in RECIPES else f"physics {physics!r}"
        raise BadInput(f"policy: {what}; only a policy trained with ranges can be trained again.")
    task = "follow" if told.get("target_speed", 0.0) else "reach"
    return RunConfig(
        fish=fish,
        out=out,
        recipe=recipe_of(name, task, told.get("horizon")),
        actions=contract.actions,
        seed=int(told.get("seed", 0)),
        yaw_rate=contract.yaw_rate,
        velocities=contract.motion is not None,
        averages=contract.averages is not None,
        errors=_widths(Errors(), told.get("errors")),
        build=_widths(randomize.none(), told.get("build")),
        hard=_widths(Hardship(), told.get("hard")),
        start=start,
        measure=contract.measure,
        measured=True,
    )


def _widths(nothing: Widths, said: object) -> Widths | None:
    """Half widths as `callback` writes them into a contract: "horn 0.262, left 0.03"; None for
    none."""
    if not isinstance(said, str) or said == "none":
        return None
    try:
        pairs = (one.rsplit(" ", 1) for one in said.split(", "))
        return replace(nothing, **{name: float(width) for name, width in pairs})
    except (TypeError, ValueError):
        raise BadInput(f"policy: trained with {said!r}, which this tailbeat cannot read.") from None


def train_again(parent: Policy, run: RunConfig, report: Report = silent) -> Again:
    """Train a run of `refitted`, and write its policy with the parent's corrections as
    `retrained.onnx` beside the run's folder. Raises BadInput as `train` does."""
    train(run, report=report)
    made, policy = run.out / "policy.onnx", run.out.parent / RETRAINED
    write(
        made, replace(load_policy(made).contract, corrections=parent.contract.corrections), policy
    )
    before, after = (_swum(run, one) for one in (parent, load_policy(policy)))
    longest = run.settings(len(run.recipe.stages) - 1).task.seconds
    better = surely_less(after.lateness(longest), before.lateness(longest))
    return Again(str(policy), before.summary(), after.summary(), better)


def surely_less(some: Array, others: Array) -> bool:
    """Whether the mean of some (n,) is below that of the others, pair by pair, beyond chance."""
    less = others - some
    return bool(less.mean() > SURE * less.std(ddof=1) / np.sqrt(less.size))


def _swum(run: RunConfig, policy: Policy) -> Swims:
    """Greedy swims in the run's last stage."""
    settings = run.settings(len(run.recipe.stages) - 1)
    return assess(partial(decide, policy), partial(World, run.fish, settings), TARGETS, SEED)
