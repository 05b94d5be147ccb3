"""Search for a servo's numbers from several seeds, with and without the gears' friction."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from pathlib import Path

import numpy as np

from tailbeat.files import BadInput
from tailbeat.identify.datasheet import Datasheet, known, prior
from tailbeat.identify.search import Effort, Fit, search_once
from tailbeat.identify.servo import COUNTED, GEARS, blocks, residual_function, servo_space
from tailbeat.identify.servo_doubt import delay_doubt, load_doubt, with_honest_intervals
from tailbeat.identify.shaft import Bench
from tailbeat.identify.space import Parameter, bounds, values

Progress = Callable[[int, str, float, float], None]  # seed, stage, fraction done, best cost
AT_LEAST = 0.002  # a smaller friction of the gears counts as none


@dataclass(frozen=True)
class ServoConfig:
    """Number of `seeds` from `first_seed` on, and how many `more` while none agrees with the
    recordings (one search of a hundred did not); effort; whether to fit the `gears`' friction too;
    the `gain` register that the fish will run with (None: the recordings' middle); the `load` on
    the shaft (None: as recorded, else the tail); whether to also fit without each gain in turn; the
    servo's `datasheet`, if it shall count."""

    seeds: int = 5
    first_seed: int = 0
    effort: Effort = field(
        default_factory=lambda: Effort(generations=150, population=32, polish=20, scouts=500)
    )
    gears: bool = True
    gain: float | None = None
    load: str | None = None
    cross_validate: bool = False
    more: int = 0
    datasheet: Datasheet | None = None


def check(config: ServoConfig) -> None:
    """Raises BadInput for no seeds, no generations or a gain that is not above 0."""
    seeds, generations = config.seeds, config.effort.generations
    if seeds < 1 or generations < 1:
        raise BadInput(f"--seeds {seeds} --generations {generations}: both must be 1 or more.")
    if config.gain is not None and not config.gain > 0:
        raise BadInput(f"--gain {config.gain:g}: give the gain register's value, above 0.")


def seeds_of(config: ServoConfig) -> range:
    """The seeds of the searches, without `more`."""
    return range(config.first_seed, config.first_seed + config.seeds)


def search_ahead(
    fit: Sequence[Bench], config: ServoConfig, scratch: Path, gears: bool, seed: int
) -> None:
    """One of the searches of `identify_servo`, with or without the gears' friction, which finds its
    result in the folder `scratch`. Raises BadInput as that does."""
    _search(fit, config, scratch, gears)(seed, lambda *_: None)


def without_gears(fit: Sequence[Bench], config: ServoConfig, scratch: Path) -> bool:
    """Whether searches without the gears' friction follow those from every seed in `scratch`."""
    if not config.gears:
        return False
    search = _search(fit, config, scratch, config.gears)
    fits = [search(seed, lambda *_: None) for seed in seeds_of(config)]
    return _frictionless(servo_space(fit, True), min(fits, key=lambda found: found.cost))


def _frictionless(space: tuple[Parameter, ...], fit: Fit) -> bool:
    found = values(space, fit.z)
    return max(found[name] for name in GEARS) < AT_LEAST


def _search(
    fit: Sequence[Bench],
    config: ServoConfig,
    scratch: Path,
    gears: bool,
    told: tuple[Parameter, ...] | None = None,
) -> Callable[[int, Progress], Fit]:
    """The search from a seed; of the numbers that a datasheet has `told`, if it is given."""
    space = told or servo_space(fit, gears)
    residuals = residual_function(fit, space)
    place = scratch / _key(fit, config) / ("gears" if gears else "plain")
    if told is not None:
        place = place / hashlib.sha256(repr(told).encode()).hexdigest()[:16]

    def search(seed: int, progress: Progress) -> Fit:
        return search_once(residuals, space, seed, config.effort, place, progress)

    return search


def searched(
    fit: Sequence[Bench], config: ServoConfig, scratch: Path, progress: Progress
) -> tuple[tuple[Parameter, ...], list[Fit]]:
    """Fits, best first; without the gears' friction if it is below `AT_LEAST`; then once more with
    the datasheet, if it is given."""
    gears, sheet = config.gears, config.datasheet
    space, fits = _seeds(fit, config, scratch, gears, progress)
    if gears and _frictionless(space, fits[0]):
        gears = False
        space, fits = _seeds(fit, config, scratch, gears, progress)
    if sheet is not None:
        space = known(space, sheet, fits[0].residuals, COUNTED * len(fit))
        search = _search(fit, config, scratch, gears, space)
        fits = sorted((search(f.seed, progress) for f in fits), key=lambda found: found.cost)
    groups, edges, residuals = blocks(fit), bounds(space), residual_function(fit, space)
    best = with_honest_intervals(fits[0], residuals, groups, edges, prior(space, sheet))
    doubt = load_doubt(space, best.z, fit) + delay_doubt(space)
    return space, [replace(best, covariance=best.covariance + doubt), *fits[1:]]


def _seeds(
    fit: Sequence[Bench], config: ServoConfig, scratch: Path, gears: bool, progress: Progress
) -> tuple[tuple[Parameter, ...], list[Fit]]:
    """Fits, best first. One agrees if it errs by less than an angle's assumed deviation (rms)."""
    space, fits = servo_space(fit, gears), list[Fit]()
    search = _search(fit, config, scratch, gears)
    seeds = seeds_of(config)
    for seed in range(seeds.start, seeds.stop + config.more):
        if len(fits) >= config.seeds and np.square(fits[0].residuals).sum() < COUNTED * len(fit):
            break
        fits.append(search(seed, progress))
        fits.sort(key=lambda found: found.cost)
    return space, fits


def _key(fit: Sequence[Bench], config: ServoConfig) -> str:
    """Name of the scratch folder, a digest of what is fitted: only the same work is resumed."""
    digest = hashlib.sha256(repr((config.effort, config.gears, version("tailbeat"))).encode())
    for bench in fit:
        digest.update(repr((bench.load, bench.gain)).encode())
        for signal in (bench.time, bench.command, bench.angle, bench.enabled):
            digest.update(signal.tobytes())
    return digest.hexdigest()[:16]
