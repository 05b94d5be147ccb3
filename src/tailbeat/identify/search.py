"""Find parameters: CMA-ES over the whole range and a least-squares polish."""

import pickle
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cma
import numpy as np

from tailbeat.files import new_file
from tailbeat.identify.polish import Polished, polish
from tailbeat.identify.space import (
    FAILED,
    WIDE_STEP,
    Array,
    Parameter,
    Progress,
    Residuals,
    bounds,
    cost,
    covariance,
    sensitivity,
)

NOISE_FLOOR = 0.3
STARTS, APART = 3, 1000  # starts of a cheap exploration (chosen), and the distance of their seeds
RESCALINGS = 2  # rounds of polish with the noise estimated from the residuals


@dataclass(frozen=True)
class Effort:
    """How long to search: CMA-ES generations of `population`, then polish iterations.

    With `scouts`, CMA-ES starts at the best of so many draws from the prior. This is for a cheap
    model with flat regions, where a single random start may never find a parameter's effect.
    """

    generations: int = 15
    population: int = 14
    polish: int = 30
    scouts: int = 0


@dataclass(frozen=True, eq=False)
class Fit:
    """One seed's result: `z` (p,), `cost` (sum of squares, prior included), data `residuals` (r,),
    their `jacobian` (r, p) in z, and the `covariance` of z (p, p)."""

    seed: int
    z: Array
    cost: float
    residuals: Array
    jacobian: Array
    covariance: Array


def search(
    residuals: Residuals,
    space: tuple[Parameter, ...],
    seed: int,
    effort: Effort,
    checkpoint: Path | None = None,
    progress: Progress = lambda stage, share, best: None,
    cheap: Residuals | None = None,
) -> Fit:
    """CMA-ES, then polish, from one seed. With `cheap` residuals CMA-ES runs on these, from
    `STARTS` starts, and the best goes on: one alone may stop far from the others. It is polished on
    these, and then half as long on all. Resumes from `checkpoint` and the files beside it."""
    z = _best_start(residuals, cheap, space, seed, effort, checkpoint, progress)
    left = effort.polish
    if cheap is not None:
        z = _ahead(residuals, cheap, space, z, effort, checkpoint, progress)
        left = max(effort.polish // 2, 1)
    begun = [Polished(checkpoint, str(part)) for part in range(1 + RESCALINGS)]
    z, noise = polish(residuals, space, z, left, progress, begun=begun[0]), 1.0
    for part in begun[1:]:
        before, noise = noise, noise_level(residuals(z[None])[0], z.size)
        if noise == before:
            break  # nothing is scaled anew
        scaled = _divided(residuals, noise)
        z = polish(scaled, space, z, effort.polish // 2, progress, True, part)
    found, slope = sensitivity(residuals, z, step=WIDE_STEP, edges=bounds(space))
    return Fit(seed, z, float(cost(found, z)), found, slope, covariance(slope / noise))


def search_once(
    residuals: Residuals,
    space: tuple[Parameter, ...],
    seed: int,
    effort: Effort,
    scratch: Path,
    progress: Callable[[int, str, float, float], None],
    cheap: Residuals | None = None,
) -> Fit:
    """`search` with its result kept in the folder `scratch`: a finished seed is read, an
    interrupted one is resumed."""
    done = scratch / f"seed{seed}.fit"
    if done.is_file():
        kept: Fit = pickle.loads(done.read_bytes())
        return kept
    found = search(
        residuals,
        space,
        seed,
        effort,
        scratch / f"seed{seed}.search",
        lambda stage, share, best: progress(seed, stage, share, best),
        cheap,
    )
    with new_file(done, overwrite=True) as path:
        path.write_bytes(pickle.dumps(found))
    return found


def noise_level(found: Array, free: int) -> float:
    """Standard deviation of the residuals (r,) of a fit with `free` numbers, clipped to 0.3 to 1.

    The floor is about the error of a twin's integration and replay, for any camera.

    If the data are better than their assumed deviations, they count more against the prior, and
    intervals shrink. A larger misfit changes nothing.
    """
    freedom = max(found.size - free, 1)
    return float(np.clip(np.sqrt(np.square(found).sum() / freedom), NOISE_FLOOR, 1.0))


def _divided(residuals: Residuals, noise: float) -> Residuals:
    return lambda z: residuals(z) / noise


def _best_start(
    residuals: Residuals,
    cheap: Residuals | None,
    space: tuple[Parameter, ...],
    seed: int,
    effort: Effort,
    checkpoint: Path | None,
    progress: Progress,
) -> Array:
    """The best candidate of one start, or with `cheap` residuals of `STARTS`. What is good on the
    cheap ones may diverge on all; if every start does, one explores on all."""
    if cheap is None:
        return _explore(residuals, space, seed, effort, checkpoint, progress)
    found = []
    for k in range(STARTS):
        kept = checkpoint and checkpoint.with_name(f"{checkpoint.name}-start{k}")

        def tell(stage: str, share: float, best: float, k: int = k) -> None:
            progress(stage, (k + share) / STARTS, best)

        found.append(_explore(cheap, space, seed + APART * k, effort, kept, tell))
    costs = cost(residuals(np.array(found)), np.array(found))
    if costs.min() >= FAILED:
        return _explore(residuals, space, seed, effort, checkpoint, progress)
    return found[int(np.argmin(costs))]


def _ahead(
    residuals: Residuals,
    cheap: Residuals,
    space: tuple[Parameter, ...],
    z: Array,
    effort: Effort,
    checkpoint: Path | None,
    progress: Progress,
) -> Array:
    """`z` polished on the cheap residuals, unless it was better before on all."""

    def tell(stage: str, share: float, best: float) -> None:
        progress(f"first {stage}", share, best)

    begun = Polished(checkpoint, "ahead")
    both = np.array([z, polish(cheap, space, z, effort.polish, tell, begun=begun)])
    return np.asarray(both[int(np.argmin(cost(residuals(both), both)))])


def _explore(
    residuals: Residuals,
    space: tuple[Parameter, ...],
    seed: int,
    effort: Effort,
    checkpoint: Path | None,
    progress: Progress,
) -> Array:
    strategy = _restore(checkpoint) or _strategy(residuals, space, seed, effort)
    while strategy.countiter < effort.generations and not strategy.stop():
        candidates = strategy.ask()
        z = np.array(candidates)
        strategy.tell(candidates, cost(residuals(z), z).tolist())
        if checkpoint is not None:
            with new_file(checkpoint, overwrite=True) as path:
                path.write_bytes(pickle.dumps(strategy))
        progress("search", strategy.countiter / effort.generations, strategy.best.f)
    return np.array(strategy.best.x)


def _strategy(
    residuals: Residuals, space: tuple[Parameter, ...], seed: int, effort: Effort
) -> cma.CMAEvolutionStrategy:
    """A strategy that starts at a random draw near the prior, different for every seed."""
    low, high = bounds(space)
    rng = np.random.default_rng(seed)
    start = np.clip(rng.normal(0.0, 0.5, len(space)), low + 0.01, high - 0.01)
    if effort.scouts:
        draws = np.clip(rng.normal(0.0, 1.0, (effort.scouts, len(space))), low + 0.01, high - 0.01)
        start = draws[np.argmin(cost(residuals(draws), draws))]
    options = {
        "bounds": [low.tolist(), high.tolist()],
        "popsize": effort.population,
        "seed": seed + 1,  # 0 would mean a seed from the clock
        "verbose": -9,
    }
    return cma.CMAEvolutionStrategy(start, 0.4, options)


def _restore(checkpoint: Path | None) -> cma.CMAEvolutionStrategy | None:
    if checkpoint is None or not checkpoint.is_file():
        return None
    strategy: cma.CMAEvolutionStrategy = pickle.loads(checkpoint.read_bytes())
    return strategy
