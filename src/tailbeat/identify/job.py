"""`tailbeat identify fluid`: fit with several seeds, keep the best, and check it."""

import hashlib
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from tailbeat.files import BadInput
from tailbeat.fish.description import Fish
from tailbeat.identify.estimate import Estimate, as_row
from tailbeat.identify.fluid import apply, fluid_space, insensitive, residual_function
from tailbeat.identify.glitch_report import as_rows
from tailbeat.identify.kinematic import errors_row, fit_kinematic, predict_kinematic, replayable
from tailbeat.identify.launch import Launched, check_launches, stuck
from tailbeat.identify.naive_swim import Compared, compare
from tailbeat.identify.predict import Prediction, predict, row, speed_mae
from tailbeat.identify.protocol import largest, limits
from tailbeat.identify.runs import Run
from tailbeat.identify.search import (
    Effort,
    Fit,
    Parameter,
    estimates,
    search_once,
    trade_offs,
    values,
)
from tailbeat.identify.trust import Contest, Verdict, share_left_out, verdict

Array = NDArray[np.float64]
NAMED = 8  # most swims that every identified number names; if there are more, the heading does
Progress = Callable[[int, str, float, float], None]  # seed, stage, fraction done, best cost


@dataclass(frozen=True)
class FluidConfig:
    """What to fit: `zones` (1: one shared set, 3: one set per zone), number of `seeds` from
    `first_seed` on, effort, whether the start of replayed runs counts four times the end (None: if
    a run starts from rest). Before the fit the description gets this `added_inertia` (None: as
    described), or the `whole` law (`fish.water.whole`)."""

    zones: int = 3
    seeds: int = 5
    first_seed: int = 0
    effort: Effort = field(default_factory=Effort)
    start_weight: bool | None = None
    added_inertia: float | None = None
    whole: bool = False


def check(config: FluidConfig) -> None:
    """Raises BadInput for a config whose numbers are not allowed."""
    seeds, generations, share = config.seeds, config.effort.generations, config.added_inertia
    if config.zones not in (1, 3):
        raise BadInput(f"--zones {config.zones}: give 1 (one coefficient set) or 3 (one per zone).")
    if seeds < 1 or generations < 1:
        raise BadInput(f"--seeds {seeds} --generations {generations}: both must be 1 or more.")
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
    """The result: one fit per seed, best first, and the best one's fish, predictions and launch
    checks. `idle` are parameters without effect, which were not fitted. `rival` has the naive
    model's predictions of the held-out swims (`kinematic.py`), empty without replayed swims.
    `spread` has the seeds, best first; `seconds` [s] is the duration."""

    space: tuple[Parameter, ...]
    idle: tuple[str, ...]
    fits: tuple[Fit, ...]
    fish: Fish
    fitted: tuple[Prediction, ...]
    validated: tuple[Prediction, ...]
    launched: tuple[Launched, ...]
    rival: tuple[Prediction, ...]
    spread: tuple[SeedResult, ...]
    seconds: float

    def estimates(self) -> dict[str, Estimate]:
        """Field -> value, unit, 95 % interval and prior of every free number."""
        return estimates(self.space, self.fits)


def identify_fluid(
    fish: Fish,
    fit: Sequence[Run],
    validate: Sequence[Run],
    config: FluidConfig,
    scratch: Path,
    progress: Progress = lambda seed, stage, share, best: None,
) -> Identified:
    """Fit on `fit`, and predict both. Interrupted work in the folder `scratch` is resumed. Raises
    BadInput if `fit` is empty or an uncertain number of the fish is outside its range."""
    began = time.monotonic()
    if not fit:
        raise BadInput("--fit is empty; give at least one recording to fit.")
    space, idle = _sensitive_space(fish, fit, config)
    residuals = residual_function(fish, fit, space, config.start_weight)
    key = _key(fish, fit, config)
    fits = [
        search_once(residuals, space, seed, config.effort, scratch / key, progress)
        for seed in range(config.first_seed, config.first_seed + config.seeds)
    ]
    fits.sort(key=lambda found: found.cost)
    return _conclude(fish, fit, validate, space, idle, fits, time.monotonic() - began)


def _sensitive_space(
    fish: Fish, fit: Sequence[Run], config: FluidConfig
) -> tuple[tuple[Parameter, ...], tuple[str, ...]]:
    """The free numbers that change the result, and the names of those that do not."""
    space = fluid_space(fish, config.zones)
    idle = insensitive(residual_function(fish, fit, space, config.start_weight), space)
    return tuple(p for p in space if p.path not in idle), tuple(idle)


def _key(fish: Fish, fit: Sequence[Run], config: FluidConfig) -> str:
    """Name of the scratch folder, a digest of what is fitted: only the same work is resumed."""
    digest = hashlib.sha256(fish.model_dump_json().encode())
    digest.update(repr((config.zones, config.effort, config.start_weight)).encode())
    digest.update((mujoco.__version__ + version("tailbeat")).encode())
    for run in fit:
        digest.update(run.track.time.tobytes() + run.track.pose.tobytes())
        digest.update(b"" if run.motor is None else run.motor.tobytes())
    return digest.hexdigest()[:16]


def _conclude(
    fish: Fish,
    fit: Sequence[Run],
    validate: Sequence[Run],
    space: tuple[Parameter, ...],
    idle: tuple[str, ...],
    fits: list[Fit],
    seconds: float,
) -> Identified:
    everything = [*fit, *validate]
    found = [predict(apply(fish, values(space, f.z)), everything) for f in fits]
    spread = tuple(_seed_result(f, p, len(fit), space) for f, p in zip(fits, found, strict=True))
    best = apply(fish, values(space, fits[0].z))
    return Identified(
        space,
        idle,
        tuple(fits),
        best,
        tuple(found[0][: len(fit)]),
        tuple(found[0][len(fit) :]),
        tuple(check_launches(best, gaits(best, everything))),
        _rival(fit, validate),
        spread,
        seconds,
    )


def gaits(fish: Fish, runs: Sequence[Run]) -> list[tuple[float, float | None]]:
    """Steady beats (frequency [Hz], stroke [rad], None for a crank) over the recorded band."""
    known = [r.gait.frequency for r in runs if np.isfinite(r.gait.frequency)]
    beats = np.clip(known or [max(fish.band[0], fish.band[1] / 4), fish.band[1]], *fish.band)
    chosen = np.geomspace(beats.min(), beats.max(), 6)
    if fish.motor.range is None:
        return [(float(rate), None) for rate in chosen]
    limit = limits(fish)
    return [(float(rate), 0.7 * largest(limit, float(rate))) for rate in chosen]


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


def as_report(found: Identified, config: FluidConfig) -> dict[str, Any]:
    """The JSON report."""
    known = found.estimates()
    naive = compare(found.fitted, found.validated, found.rival)
    said = _verdict(found, naive)
    return {
        "verdict": list(said.sentences),
        "trusted": said.trusted,
        "parameters": {path: as_row(one) for path, one in known.items()},
        "undecided": [path for path, one in known.items() if not one.decided],
        "without_effect": list(found.idle),
        "trade_offs": [
            {"parameters": [a, b], "correlation": r}
            for a, b, r in trade_offs(found.space, found.fits[0])
        ],
        "zones": config.zones,
        "added_inertia": found.fish.added_inertia,
        "seeds": [asdict(one) for one in found.spread],
        "fit": [row(p) for p in found.fitted],
        "validate": [row(p) for p in found.validated],
        "fit_speed_mae": speed_mae(found.fitted),
        "validate_speed_mae": speed_mae(found.validated) if found.validated else None,
        "launches": [asdict(one) for one in found.launched],
        "launches_that_end_backward": len(stuck(found.launched)),
        "naive": [{**asdict(one), "best": one.best, "ratio": one.ratio} for one in naive],
        "glitches": as_rows(g for p in (*found.fitted, *found.validated) for g in p.run.glitches),
        "rival": [errors_row(p) for p in found.rival],
        "engine": f"mujoco {mujoco.__version__}",
        "tailbeat": version("tailbeat"),
        "seconds": found.seconds,
    }


def _verdict(found: Identified, naive: Sequence[Compared]) -> Verdict:
    contests = [Contest(one.quantity, one.ratio, one.best) for one in naive]
    samples = [(p.run, p.run.track.time.size) for p in found.fitted]
    return verdict(contests, [(r.name, share_left_out(r.glitches, n)) for r, n in samples])


def toml_values(found: Identified, recordings: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Field -> {value, unit, interval, source} for `store.write_identified`, one for each zone."""
    few = len(recordings) <= NAMED
    swims = ", ".join(recordings) if few else f"{len(recordings)} swims, named on top"
    source = f"identified on {swims}"
    written: dict[str, dict[str, Any]] = {}
    for path, known in found.estimates().items():
        remark = source if known.decided else f"{source}; not decided by the data"
        entry = {
            "value": float(f"{known.value:.6g}"),
            "unit": known.unit,
            "interval": [float(f"{edge:.4g}") for edge in known.interval],
            "source": remark,
        }
        for zone in found.fish.zones if "*" in path else [""]:
            written[path.replace("*", zone)] = entry
    return {**_assumed(found.fish), **written}


def _assumed(fish: Fish) -> dict[str, Any]:
    """The numbers of the fluid law that the fit assumed, from the fitted fish."""
    numbers = {"added_inertia": (fish.added_inertia, "1"), "added_along": (fish.added_along, "1")}
    if (blend := fish.trailing_edge) is not None:
        numbers["trailing_edge.speed"] = (blend.speed, "m/s")
        numbers["trailing_edge.reverse"] = (blend.reverse, "1")
    written: dict[str, Any] = {
        path: {"value": value, "unit": unit, "source": "the fit's assumption"}
        for path, (value, unit) in numbers.items()
    }
    return {**written, "simulation.integrator": fish.simulation.integrator}


def heading(found: Identified, config: FluidConfig) -> str:
    """The first lines of an identified fish: what was fitted, with which error and engine."""
    lines = [
        "Identified by `tailbeat identify fluid`; the report beside this file has the details.",
        f"Fitted on {', '.join(p.run.name for p in found.fitted)}, cost {found.fits[0].cost:.3g},"
        f" best of {len(found.fits)} seeds, {config.zones} zone(s).",
        f"Mean absolute speed error {speed_mae(found.fitted):.4f} m/s fitted"
        + (f", {speed_mae(found.validated):.4f} m/s held out." if found.validated else "."),
        f"mujoco {mujoco.__version__}, tailbeat {version('tailbeat')}.",
    ]
    return "\n".join(lines)


def clear(scratch: Path) -> None:
    """Remove a finished search's checkpoints."""
    shutil.rmtree(scratch, ignore_errors=True)
