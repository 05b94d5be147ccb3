"""95 % intervals and trade-offs of fitted parameters."""

from collections.abc import Sequence

import numpy as np
from scipy import stats

from tailbeat.identify.estimate import Estimate
from tailbeat.identify.search import Fit
from tailbeat.identify.space import Parameter, bounds, values


def intervals(
    space: tuple[Parameter, ...], fits: Sequence[Fit], excess: float = 1.0, freedom: float = np.inf
) -> list[tuple[float, float]]:
    """95 % interval of every parameter, inside its range, from fits sorted best first.

    From the best fit's covariance and Student's t with `freedom` degrees of freedom, widened to
    include every seed that fits as well (a cost within `excess` times the 95 % point of
    chi-square): the covariance is local, and the cost's valleys are curved.
    """
    reach = stats.t.ppf(0.975, freedom) * np.sqrt(np.diag(fits[0].covariance))
    limit = fits[0].cost + excess * stats.chi2.ppf(0.95, 1)
    equals = np.array([f.z for f in fits if f.cost < limit or f is fits[0]])
    least, most = bounds(space)
    low = np.maximum(np.minimum(fits[0].z - reach, equals.min(axis=0)), least)
    high = np.minimum(np.maximum(fits[0].z + reach, equals.max(axis=0)), most)
    return [(p.from_z(a), p.from_z(b)) for p, a, b in zip(space, low, high, strict=True)]


def estimates(
    space: tuple[Parameter, ...], fits: Sequence[Fit], excess: float = 1.0, freedom: float = np.inf
) -> dict[str, Estimate]:
    """Field -> the best fit's value with its interval, from fits sorted best first; `excess` and
    `freedom` as in `intervals`."""
    spans = intervals(space, fits, excess, freedom)
    found = zip(space, values(space, fits[0].z).values(), spans, strict=True)
    return {p.path: Estimate(value, span, p.unit, p.prior) for p, value, span in found}


def trade_offs(space: tuple[Parameter, ...], fit: Fit, least: float = 0.9) -> list[tuple]:
    """Pairs of parameters whose estimates are correlated beyond `least`: (path, path, r)."""
    spread = np.sqrt(np.diag(fit.covariance))
    correlation = fit.covariance / np.outer(spread, spread)
    rows, columns = np.where(np.triu(np.abs(correlation), 1) > least)
    return [
        (space[i].path, space[j].path, float(correlation[i, j]))
        for i, j in zip(rows, columns, strict=True)
    ]
