"""Evaluation of a policy in the pool: swim all trials into a folder, then read the numbers."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tailbeat.control.policy import Policy, contract_digest, decide
from tailbeat.env.task import as_seen
from tailbeat.evaluate import (
    disturb,
    fresh_recordings,
    messy,
    out_of_distribution,
    reach,
    spectrum,
    store,
)
from tailbeat.evaluate import track as tracks
from tailbeat.evaluate.fresh_recordings import FreshResult
from tailbeat.evaluate.names import NAMES, TRIALS, check_tasks
from tailbeat.evaluate.provenance import Provenance, provenance
from tailbeat.evaluate.rates import ConditionResult
from tailbeat.evaluate.reach import ReachResult
from tailbeat.evaluate.runs import Runs
from tailbeat.evaluate.spectrum import SpectrumRow
from tailbeat.evaluate.store import RunDescription
from tailbeat.evaluate.track import TrackResult
from tailbeat.evaluate.trial import (
    CHUNK,
    Chunk,
    Condition,
    Pool,
    Progress,
    chunks_of,
    swim_all,
)  # fmt: skip
from tailbeat.files import BadInput, write_json
from tailbeat.fish.description import Fish
from tailbeat.fish.store import digest, load_fish
from tailbeat.identify import posterior
from tailbeat.link.places import room
from tailbeat.pool import mess
from tailbeat.pool.water import Water, ablations, ensemble, fingerprint
from tailbeat.robot.fits import check_swims

Swim = Callable[[Sequence[Chunk], Progress], None]  # swims the chunks that are not on disk

POOLS = 16  # waters of the ensemble
ENSEMBLE_SEED = 0
CONDITIONS: Mapping[str, Callable[[Pool], list[Condition]]] = dict(
    zip(
        TRIALS,
        (
            reach.conditions,
            disturb.conditions,
            tracks.conditions,
            out_of_distribution.conditions,
            messy.conditions,
        ),
        strict=True,
    )
)


@dataclass(frozen=True)
class EvaluationConfig:
    """What to evaluate a policy in.

    The pool's `fish`; the `twin` that the policy was trained in (None: the one that it names); the
    waters of the `pool` ("ensemble", or one of the ablations); the `tasks`; swims per condition
    (`episodes`); `walls` (length, width) [m] of the walled trials (None: the paper's pool in the
    fish's measure); the seed; what the `lab` of every swim of the task track gets wrong, a level of
    `pool.mess`.
    """

    fish: str = "pulley-fish"
    twin: str | None = None
    pool: str = "ensemble"
    tasks: tuple[str, ...] = NAMES
    episodes: int = 250
    walls: tuple[float, float] | None = None
    seed: int = 0
    lab: str = "clean"


@dataclass(frozen=True)
class Evaluation:
    """Results of a folder: its description, the conditions that were `cut_short`, and the result of
    each task; empty or None if it was not swum."""

    run: RunDescription
    provenance: Provenance
    cut_short: tuple[str, ...]
    reach: Mapping[str, ReachResult]
    disturb: tuple[ConditionResult, ...]
    track: tuple[TrackResult, ...]
    out_of_distribution: tuple[ConditionResult, ...]
    messy: tuple[ConditionResult, ...]
    spectrum: tuple[SpectrumRow, ...]
    twin: FreshResult | None


def waters_of(name: str) -> tuple[Water, ...]:
    """The waters of `--pool`: "ensemble", or one of the ablations ("full" is the default water).
    Raises BadInput."""
    if name == "ensemble":
        return tuple(ensemble(POOLS, ENSEMBLE_SEED))
    if name not in ablations():
        raise BadInput(f"--pool {name!r}: allowed are ensemble, {', '.join(ablations())}.")
    return (ablations()[name],)


def pool_of(policy: Policy, config: EvaluationConfig) -> Pool:
    """The pool for a policy. Raises BadInput if the policy does not fit the pool's fish."""
    if config.episodes < 2:
        raise BadInput(f"--episodes {config.episodes}: give 2 or more.")
    own = load_fish(config.fish)
    trained = check_swims(policy, config.twin, own)
    waters, actions = waters_of(config.pool), policy.contract.actions
    draws = _draws(config.twin or policy.contract.fish, trained)
    measure = policy.contract.measure
    walls = config.walls or room(measure.reach)
    found = Pool(own, trained, actions, waters, config.episodes, config.seed, walls, draws, measure)
    held = policy.contract
    return replace(as_seen(found, held), corrections=held.corrections, lab=config.lab)


def _draws(fish: str, trained: Fish) -> NDArray[np.float64] | None:
    """The draws of the posterior beside the fish that the policy was `trained` on, if there is
    one."""
    known = posterior.at_hand(fish, trained)
    return None if known is None else posterior.coefficient_factors(load_fish(fish), known)


def conditions_of(pool: Pool, tasks: Sequence[str]) -> list[Condition]:
    """All conditions of some tasks."""
    return [one for name in tasks if name in CONDITIONS for one in CONDITIONS[name](pool)]


def _check_lab(level: str, tasks: Sequence[str]) -> None:
    """Check the level of the labs in which the task track swims. Raises BadInput."""
    mess.level(level)
    used = (tracks.TRACK,) if level in mess.LEVELS else (tracks.TRACK, "messy")
    if Path(level).stem in mess.LEVELS and level not in mess.LEVELS:
        raise BadInput(f"--mess {level}: has the name of a level; rename the file.")
    if level != "clean" and not set(used) & set(tasks):
        raise BadInput(
            f"--mess {level}: it is for the task {' or '.join(used)}; give --tasks {used[-1]}, or"
            f" omit it."
        )


def evaluate(
    policy: Policy,
    config: EvaluationConfig,
    out: Path,
    progress: Progress,
    swim: Swim | None = None,
) -> Evaluation:
    """Swim what is missing, then `read`; an evaluation that was stopped continues. `swim` may swim
    elsewhere; default: in this process.

    Raises BadInput if the policy does not fit, or the folder has other runs.
    """
    swim = swim or partial(swim_all, partial(decide, policy))
    pool, tasks = pool_of(policy, config), config.tasks
    check_tasks(tasks)
    _check_lab(config.lab, tasks)
    swum = dict.fromkeys(["reach", *tasks] if "spectrum" in tasks else tasks)
    conditions = conditions_of(pool, list(swum))
    store.begin(out, describe(policy, pool))
    store.keep_fish(out, pool.twin)
    swim(chunks_of(conditions, out, pool.seed), progress)
    if "twin" in tasks:
        fresh_recordings.record(pool.fish, out / "twin", pool.seed)
        found = fresh_recordings.numbers(out / "twin", pool.fish, pool.twin)
        write_json(out / "twin" / "twin.json", found, overwrite=True)
    if "spectrum" in tasks:
        own = spectrum.identification(pool.fish, policy.contract.band, pool.seed)
        write_json(out / "identification.json", own, overwrite=True)
    done = read(out)
    write_json(out / "evaluation.json", done, overwrite=True)
    return done


def describe(policy: Policy, pool: Pool) -> RunDescription:
    """Description of an evaluation; a folder holds one."""
    contract = policy.contract
    return RunDescription(
        policy=contract_digest(contract),
        actions=contract.actions.kind,
        band=contract.band,
        training=contract.training,
        twin=contract.fish,
        fish=pool.fish.name,
        fish_digest=digest(pool.fish),
        water=fingerprint(pool.waters),
        waters=len(pool.waters),
        seed=pool.seed,
        episodes=pool.count,
        walls=pool.walls,
        conditions=counts(pool),
        measure=pool.measure,
        mess=mess.fingerprint(),
        lab=mess.named(pool.lab),
    )


def counts(pool: Pool) -> dict[str, int]:
    """Number of swims of every condition that these walls allow."""
    found: dict[str, int] = {}
    for conditions in CONDITIONS.values():
        with suppress(BadInput):
            found |= {one.name: one.count for one in conditions(pool)}
    return found


def read(out: Path) -> Evaluation:
    """Read the numbers of everything swum in a folder. Raises BadInput if there is nothing."""
    run = store.read_description(out)
    held = {name: store.load(out, name, -(-n // CHUNK)) for name, n in present(out, run).items()}
    fresh = out / "twin" / "twin.json"
    if not held and not fresh.is_file():
        raise BadInput(f"{out}: no swims in this folder; run `tailbeat evaluate` into it first.")
    swum = {name: one for name, (one, _) in held.items()}
    reached, beyond = _of(swum, "reach"), _of(swum, out_of_distribution.PREFIX)
    disturbed = _of(swum, "disturb")
    return Evaluation(
        run=run,
        provenance=provenance(),
        cut_short=tuple(name for name, (_, short) in held.items() if short),
        reach={name: reach.numbers(one) for name, one in reached.items()},
        disturb=disturb.numbers(disturbed) if disturb.CALM in disturbed else (),
        track=tracks.numbers(swum, run.measure) if tracks.TRACK in swum else (),
        out_of_distribution=out_of_distribution.numbers(beyond)
        if out_of_distribution.AS_TRAINED in beyond
        else (),
        messy=messy.numbers(labs) if messy.CLEAN in (labs := _of(swum, messy.PREFIX)) else (),
        spectrum=(*_identification(out), *spectrum.numbers(reached, run.band)),
        twin=store.read_record(FreshResult, fresh) if fresh.is_file() else None,
    )


def _of(swum: Mapping[str, Runs], prefix: str) -> dict[str, Runs]:
    return {name: one for name, one in swum.items() if name.startswith(prefix)}


def _identification(out: Path) -> list[SpectrumRow]:
    path = out / "identification.json"
    return [store.read_record(SpectrumRow, path)] if path.is_file() else []


def present(out: Path, run: RunDescription) -> dict[str, int]:
    """Conditions with at least one chunk on disk, and their number of swims."""
    return {
        name: count
        for name, count in run.conditions.items()
        if any(store.chunk_path(out, name, k).is_file() for k in range(-(-count // CHUNK)))
    }
