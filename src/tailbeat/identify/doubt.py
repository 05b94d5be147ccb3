"""How far can the free numbers of a fluid fit be from the best ones? Draws that say so.

Residuals of one swim are not independent: a twin that is a little too fast is so at every sample.
So a swim, not a sample, is the unit here. Each swim pulls the numbers its own way; if the pulls
differ by more than independent residuals would, the covariance grows in that direction (a sandwich
by swims: Liang and Zeger 1986). It is never smaller than independent residuals would make it; the
prior counts as one more observation. Searches from other seeds that end almost as well count too.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from tailbeat.identify.search import Fit, noise_level
from tailbeat.identify.space import Parameter, Residuals, bounds, cost

Array = NDArray[np.float64]
FEWEST = 3  # degrees of freedom at least, chosen: two swims say little about how swims differ
NO_DATA = 1e-9  # information below which the data say nothing about a direction
FAR = 0.99  # a draw whose cost is beyond this quantile of chi-square is moved back
RETREATS = 4  # times, each halfway to the best numbers


@dataclass(frozen=True, eq=False)
class Doubt:
    """A fit whose `covariance` counts swims, not samples. `excess`: by how much, on the mean over
    directions, the swims' pulls differ more than independent residuals would (1 or more).
    `freedom`: degrees of freedom of Student's t."""

    fit: Fit
    excess: float
    freedom: float


def by_swims(fit: Fit, owner: NDArray[np.int_]) -> Doubt:
    """The doubt of a fit; `owner` (r,) is the number of the swim of each residual. One swim cannot
    tell how swims differ, so its numbers have the prior's deviations."""
    swims = [owner == i for i in np.unique(owner)]
    if len(swims) < 2:
        return Doubt(replace(fit, covariance=np.eye(fit.z.size)), 1.0, FEWEST)
    noise = noise_level(fit.residuals, fit.z.size)
    found, slope = fit.residuals / noise, fit.jacobian / noise
    information = slope.T @ slope
    pulls = _pulls(found, slope, swims)
    scatter = pulls.T @ pulls * (len(swims) - 1) / len(swims)
    pulled, excess = _widened(information, scatter)
    bread = np.linalg.inv(information + np.eye(fit.z.size))
    covariance = bread @ (pulled + np.eye(fit.z.size)) @ bread
    freedom = max(len(swims) - 1, FEWEST)
    return Doubt(replace(fit, covariance=covariance), excess, freedom)


def _pulls(found: Array, slope: Array, swims: Sequence[NDArray[np.bool_]]) -> Array:
    """Gradient of each swim (n, p), as large as if the swim had not been fitted (the jackknife's
    correction, CR3: a swim hides a part of its pull by being fitted)."""
    free = slope.shape[1]
    bread = np.linalg.inv(slope.T @ slope + np.eye(free))
    rows = []
    for own in swims:
        part = slope[own]
        hidden = np.eye(free) - part.T @ part @ bread
        rows.append(np.linalg.solve(hidden, part.T @ found[own]))
    return np.array(rows)


def _widened(information: Array, scatter: Array) -> tuple[Array, float]:
    """The scatter (p, p) of the pulls, in no direction less than independent residuals would have
    (the information), and by how much more on the mean."""
    size, axes = np.linalg.eigh(information)
    known = size > NO_DATA
    root = axes[:, known] * np.sqrt(size[known])
    white = axes[:, known] / np.sqrt(size[known])
    ratio, turn = np.linalg.eigh(white.T @ scatter @ white)
    excess = np.maximum(ratio, 1.0)
    kept = root @ turn
    return np.asarray(kept * excess @ kept.T), float(excess.mean())


def plausible(doubts: Sequence[Doubt]) -> Array:
    """Weight (s,) of each seed's fit: a normal likelihood with the first one's noise and excess.
    The weights add up to 1."""
    best = doubts[0]
    noise = noise_level(best.fit.residuals, best.fit.z.size)
    costs = np.array([cost(one.fit.residuals / noise, one.fit.z) for one in doubts])
    weight = np.exp(-(costs - costs.min()) / (2 * best.excess))
    return np.asarray(weight / weight.sum())


def draw(
    space: tuple[Parameter, ...],
    doubts: Sequence[Doubt],
    parts: Sequence[Residuals],
    count: int,
    seed: int,
    told: Callable[[float], None] = lambda share: None,
) -> Array:
    """Draws (count, p) of z, the first of which is the best fit; `parts` are the residuals of some
    recordings each, together of all. `told` gets the fraction done.

    Each comes from a seed's fit by its `plausible` weight, in Student's t. Valleys of the cost are
    curved: a draw that misses the recordings clearly is moved halfway back, up to four times.
    """
    rng = np.random.default_rng(seed)
    low, high = bounds(space)
    own = rng.choice(len(doubts), size=count, p=plausible(doubts))
    own[0] = 0
    centre = np.array([doubts[i].fit.z for i in own])
    away = np.array([_away(doubts[i], rng) for i in own])
    away[0] = 0.0
    noise = noise_level(doubts[0].fit.residuals, len(space))
    limit = _limit(doubts[0], noise)
    left = np.arange(1, count)
    for turn in range(RETREATS):
        told(turn / RETREATS)
        if not left.size:
            break
        z = np.clip(centre[left] + away[left], low, high)
        left = left[_misses(parts, z, noise, limit)]
        away[left] /= 2
    told(1.0)
    return np.asarray(np.clip(centre + away, low, high))


def _misses(parts: Sequence[Residuals], z: Array, noise: float, limit: float) -> NDArray[np.bool_]:
    """Which z (n, p) cost more than the limit. What some recordings cost is enough to tell: the
    others are then not swum."""
    spent = np.square(z).sum(axis=1)
    for residuals in parts:
        near = spent <= limit
        if near.any():
            spent[near] += np.square(residuals(z[near]) / noise).sum(axis=1)
    return np.asarray(~(spent <= limit))  # NaN misses too


def _away(doubt: Doubt, rng: np.random.Generator) -> Array:
    """One draw's distance from its fit (p,)."""
    root = np.linalg.cholesky(doubt.fit.covariance)
    stretch = np.sqrt(doubt.freedom / rng.chisquare(doubt.freedom))
    return np.asarray(stretch * root @ rng.normal(size=len(root)))


def _limit(best: Doubt, noise: float) -> float:
    """Cost of a draw that still agrees with the recordings as well as these with each other."""
    own = float(cost(best.fit.residuals / noise, best.fit.z))
    return own + best.excess * float(stats.chi2.ppf(FAR, best.fit.z.size))
