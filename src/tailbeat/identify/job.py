"""`tailbeat identify fluid`: fit with several seeds, keep the best, and check it."""

import hashlib
import math
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from tailbeat.files import BadInput
from tailbeat.fish.description import Fish
from tailbeat.identify.bands import Discrepancy, Drawn, discrepancy, swim_all
from tailbeat.identify.doubt import Doubt, by_swims, draw
from tailbeat.identify.estimate import Estimate
from tailbeat.identify.fluid import (
    INSENSITIVE,
    apply,
    fluid_space,
    forward_checks,
    insensitive,
    owners,
    residual_function,
    with_row,
)
from tailbeat.identify.intervals import estimates
from tailbeat.identify.kinematic import fit_kinematic, predict_kinematic, replayable
from tailbeat.identify.launch import Launched, check_launches, gaits
from tailbeat.identify.predict import Prediction, predict, speed_mae
from tailbeat.identify.runs import Run
from tailbeat.identify.search import Effort, Fit, search_once
from tailbeat.identify.space import Parameter, Residuals, values

Array = NDArray[np.float64]
THIRD, MANY = 3, 12  # where there are so many swims, every third one is searched on ahead of all
BANDED = 32  # draws that swim the held-out swims
Progress = Callable[[int, str, float, float], None]  # seed, stage, fraction done, best cost


@dataclass(frozen=True)
class FluidConfig:
    """What to fit: `zones` (1: one shared set, 3: one set per zone), number of `seeds` from
    `first_seed` on, effort, whether the start of replayed runs counts four times the end (None: if
    a run starts from rest). Before the fit the description gets this `added_inertia` (None: as
    described), or the `whole` law (`fish.water.whole`). `draws` is the posterior's size."""

    zones: int = 3
    seeds: int = 5
    first_seed: int = 0
    effort: Effort = field(default_factory=Effort)
    start_weight: bool | None = None
    added_inertia: float | None = None
    whole: bool = False
    draws: int = 100


def check(config: FluidConfig) -> None:
    """Raises BadInput for a config whose numbers are not allowed."""
    seeds, generations, share = config.seeds, config.effort.generations, config.added_inertia
    if config.zones not in (1, 3):
        raise BadInput(f"--zones {config.zones}: give 1 (one coefficient set) or 3 (one per zone).")
    if config.effort.polish < 1:
        raise BadInput(f"--iterations {config.effort.polish}: give 1 or more.")
    if seeds < 1 or generations < 1:
        raise BadInput(f"--seeds {seeds} --generations {generations}: both must be 1 or more.")
    if config.draws < 1:
        raise BadInput(f"--draws {config.draws}: give 1 or more; with 1 there are no bands.")
    if share is not None and not 0 <= share <= 2:
        raise BadInput(f"--added-inertia {share:g}: give a fraction from 0 to 2.")
    if share is not None and config.whole:
        raise BadInput("--added-inertia: --law whole sets it to 1; leave one of them out.")


@dataclass(frozen=True)
class SeedResult:
    """One seed: its cost (sum of squares), mean absolute speed errors on the fitted and the
    held-out swims [m/s] (None without any), and the value of every free number."""

    seed: int
    cost: float
    fit_speed_mae: float
    validate_speed_mae: float | None
    values: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Identified:
    """The result: one fit per seed, best first, each with its doubt, and the best one's fish,
    predictions and launch checks. `idle` are parameters without effect, which were not fitted.
    `draws` (n, p) are the posterior's values, in each parameter's unit; `drawn` are the check swims
    (without any, the held-out ones) as the first of them swim. `rival` has the naive model's
    predictions of the held-out swims (`kinematic.py`), empty without replayed swims. `spread` has
    the seeds, best first; `seconds` [s] is the duration."""

    space: tuple[Parameter, ...]
    idle: tuple[str, ...]
    doubts: tuple[Doubt, ...]
    fish: Fish
    draws: Array
    drawn: tuple[Drawn, ...]
    fitted: tuple[Prediction, ...]
    validated: tuple[Prediction, ...]
    launched: tuple[Launched, ...]
    rival: tuple[Prediction, ...]
    spread: tuple[SeedResult, ...]
    seconds: float

    @property
    def fits(self) -> tuple[Fit, ...]:
        """One fit per seed, best first."""
        return tuple(one.fit for one in self.doubts)

    @property
    def discrepancy(self) -> Discrepancy | None:
        """The discrepancy on the swims of `drawn`, None without any."""
        return discrepancy(self.drawn) if self.drawn else None

    def estimates(self) -> dict[str, Estimate]:
        """Field -> value, unit, 95 % interval and prior of every free number."""
        best = self.doubts[0]
        return estimates(self.space, self.fits, best.excess, best.freedom)


def identify_fluid(
    fish: Fish,
    fit: Sequence[Run],
    validate: Sequence[Run],
    config: FluidConfig,
    scratch: Path,
    progress: Progress = lambda seed, stage, share, best: None,
    check: Sequence[Run] = (),
) -> Identified:
    """Fit on `fit`, and predict `validate` too. The discrepancy comes from `check`, swims unlike
    the fitted ones, else from `validate`. Interrupted work in the folder `scratch` is resumed.
    Raises BadInput if `fit` is empty or an uncertain number of the fish is outside its range."""
    began = time.monotonic()
    if not fit:
        raise BadInput("--fit is empty; give at least one recording to fit.")
    space, idle = _sensitive_space(fish, fit, config)
    search = _search(fish, fit, space, config, scratch)
    fits = [search(seed, progress) for seed in seeds_of(config)]
    fits.sort(key=lambda found: found.cost)
    owner = owners(apply(fish, values(space, fits[0].z)), fit)
    doubts = tuple(by_swims(one, owner) for one in fits)
    parts = parts_of(fish, fit, space, config.start_weight)
    first, cost = config.first_seed, fits[0].cost
    told = lambda share: progress(first, "draws", share, cost)  # noqa: E731
    drawn = draw(space, doubts, parts, config.draws, first, told)
    found = Found(
        fish, space, idle, doubts, np.array([list(values(space, z).values()) for z in drawn])
    )
    return _conclude(found, fit, validate, check or validate, began)


def seeds_of(config: FluidConfig) -> range:
    """The seeds of the searches."""
    return range(config.first_seed, config.first_seed + config.seeds)


def search_ahead(
    fish: Fish, fit: Sequence[Run], config: FluidConfig, scratch: Path, seed: int
) -> None:
    """One of the searches of `identify_fluid`, which finds its result in the folder `scratch`."""
    space, _ = _sensitive_space(fish, fit, config)
    _search(fish, fit, space, config, scratch)(seed, lambda *_: None)


def _search(
    fish: Fish,
    fit: Sequence[Run],
    space: tuple[Parameter, ...],
    config: FluidConfig,
    scratch: Path,
) -> Callable[[int, Progress], Fit]:
    """The search from a seed."""
    residuals = residual_function(fish, fit, space, config.start_weight)
    some = _cheap(fit)
    cheap = residual_function(fish, some, space, config.start_weight) if some else None
    key = _key(fish, fit, config)

    def search(seed: int, progress: Progress) -> Fit:
        return search_once(residuals, space, seed, config.effort, scratch / key, progress, cheap)

    return search


def parts_of(
    fish: Fish, fit: Sequence[Run], space: tuple[Parameter, ...], start_weight: bool | None
) -> list[Residuals]:
    """The residuals of a third of the swims each; of all in one if they have forward checks, which
    are of all swims."""
    whole = forward_checks(fish, fit) or len(fit) < THIRD
    groups = [fit] if whole else [fit[k::THIRD] for k in range(THIRD)]
    return [residual_function(fish, some, space, start_weight) for some in groups]


def _cheap(fit: Sequence[Run]) -> Sequence[Run]:
    """Every third swim, if there are many; else none."""
    return fit[::THIRD] if len(fit) >= MANY else ()


def _sensitive_space(
    fish: Fish, fit: Sequence[Run], config: FluidConfig
) -> tuple[tuple[Parameter, ...], tuple[str, ...]]:
    """The free numbers that change the result, and the names of those that do not."""
    space = fluid_space(fish, config.zones)
    some = _cheap(fit) or fit
    least = INSENSITIVE * math.sqrt(len(some) / len(fit))
    idle = insensitive(residual_function(fish, some, space, config.start_weight), space, least)
    return tuple(p for p in space if p.path not in idle), tuple(idle)


def _key(fish: Fish, fit: Sequence[Run], config: FluidConfig) -> str:
    """Name of the scratch folder, a digest of what is fitted: only the same work is resumed."""
    digest = hashlib.sha256(fish.model_dump_json().encode())
    digest.update(repr((config.zones, config.effort, config.start_weight)).encode())
    digest.update((mujoco.__version__ + version("tailbeat")).encode())
    for run in fit:
        digest.update(run.track.time.tobytes() + run.track.pose.tobytes())
        digest.update(b"" if run.motor is None else run.motor.tobytes())
        digest.update(repr((run.launch, run.gait)).encode())
        digest.update(b"" if run.track.markers is None else run.track.markers.tobytes())
    return digest.hexdigest()[:16]


@dataclass(frozen=True, eq=False)
class Found:
    """What the searches found for a described `fish`; the other fields as in `Identified`."""

    fish: Fish
    space: tuple[Parameter, ...]
    idle: tuple[str, ...]
    doubts: tuple[Doubt, ...]
    draws: Array


def _conclude(
    found: Found, fit: Sequence[Run], validate: Sequence[Run], judged: Sequence[Run], began: float
) -> Identified:
    """Predict all swims with every seed's fish, and the held-out ones with the draws."""
    everything, space = [*fit, *validate], found.space
    fits = [one.fit for one in found.doubts]
    predicted = [predict(apply(found.fish, values(space, f.z)), everything) for f in fits]
    seeds = [_seed_result(f, p, len(fit), space) for f, p in zip(fits, predicted, strict=True)]
    best = apply(found.fish, values(space, fits[0].z))
    paths = [p.path for p in space]
    drawn = [with_row(found.fish, paths, row) for row in found.draws[:BANDED]]
    return Identified(
        space,
        found.idle,
        found.doubts,
        best,
        found.draws,
        tuple(swim_all(drawn, judged)),
        tuple(predicted[0][: len(fit)]),
        tuple(predicted[0][len(fit) :]),
        tuple(check_launches(best, gaits(best, [run.gait.frequency for run in everything]))),
        _rival(fit, validate),
        tuple(seeds),
        time.monotonic() - began,
    )


def _rival(fit: Sequence[Run], validate: Sequence[Run]) -> tuple[Prediction, ...]:
    if not validate or not any(map(replayable, fit)):
        return ()
    return tuple(predict_kinematic(fit_kinematic(fit), validate))


def _seed_result(
    fit: Fit, found: list[Prediction], fitted: int, space: tuple[Parameter, ...]
) -> SeedResult:
    held_out = found[fitted:]
    return SeedResult(
        fit.seed,
        fit.cost,
        speed_mae(found[:fitted]),
        speed_mae(held_out) if held_out else None,
        values(space, fit.z),
    )


def clear(scratch: Path) -> None:
    """Remove a finished search's checkpoints."""
    shutil.rmtree(scratch, ignore_errors=True)
