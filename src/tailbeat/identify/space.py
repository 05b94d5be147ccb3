"""Free numbers, and costs of candidates: the ground on which a search stands.

Everything works on z, the distance of each parameter from its prior in prior spreads, and on a
batched residual function: candidates (n, p) in, residuals (n, r) out, in standard deviations. A
residual that is not finite means that the twin diverged.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Residuals = Callable[[Array], Array]
Progress = Callable[[str, float, float], None]  # stage, fraction done, best cost so far
Edges = tuple[Array, Array]  # lowest and highest z of each parameter, (p,) each

FAILED = 1e12  # cost of a candidate that diverged
STEP = 0.02  # finite difference in z
WIDE_STEP = 0.2  # the same for intervals: about their width, to smooth the law's small kinks


@dataclass(frozen=True)
class Parameter:
    """One free number: the dotted `path` of its field, its allowed range, and its prior.

    `spread` is the prior's standard deviation: of ln(value) if `log`, else in `unit`.
    """

    path: str
    unit: str
    low: float
    high: float
    prior: float
    spread: float
    log: bool = True

    def to_z(self, value: float) -> float:
        """Distance of a value [`unit`] from the prior, in spreads."""
        if self.log:
            return float(np.log(value / self.prior) / self.spread)
        return (value - self.prior) / self.spread

    def from_z(self, z: float) -> float:
        """The value [`unit`] at `z` spreads from the prior, clipped to the range."""
        raw = self.prior * np.exp(z * self.spread) if self.log else self.prior + z * self.spread
        return float(np.clip(raw, self.low, self.high))


def values(space: tuple[Parameter, ...], z: Array) -> dict[str, float]:
    """Field -> value of one candidate `z` (p,), in each parameter's unit."""
    return {p.path: p.from_z(float(c)) for p, c in zip(space, z, strict=True)}


def cost(residuals: Array, z: Array) -> Array:
    """Sum of squares of data and prior, (n,); `FAILED` where a residual is not finite."""
    total = np.square(residuals).sum(axis=-1) + np.square(z).sum(axis=-1)
    return np.where(np.isfinite(total), np.minimum(total, FAILED), FAILED)


def sensitivity(
    residuals: Residuals,
    z: Array,
    central: bool = True,
    step: float = STEP,
    edges: Edges | None = None,
) -> tuple[Array, Array]:
    """Residuals (r,) and their Jacobian (r, p) by finite differences, in one batched call. A number
    stands still beyond the lowest and highest z, the `edges`: there differences are one-sided, on
    the inner side."""
    low, high = edges or (np.full(z.size, -np.inf), np.full(z.size, np.inf))
    ahead = np.where(z + step <= high, step, -step)
    inside = (z - ahead >= low) & (z - ahead <= high)
    behind = np.where(inside & central, -ahead, 0.0)
    probes = [z[None], z + np.diag(ahead), z + np.diag(behind)]
    found = residuals(np.concatenate(probes if central else probes[:2]))
    other = found[z.size + 1 :] if central else found[0]
    with np.errstate(invalid="ignore"):  # where one diverged
        slope = (found[1 : z.size + 1] - other) / (ahead - behind)[:, None]
    return found[0], np.where(np.isfinite(slope), slope, 0.0).T


def bounds(space: tuple[Parameter, ...]) -> Edges:
    """Lowest and highest z of each parameter, (p,) each."""
    low = np.array([p.to_z(p.low) for p in space])
    high = np.array([p.to_z(p.high) for p in space])
    return low, high


def covariance(slope: Array) -> Array:
    """Covariance of z (p, p) from the data's Jacobian (r, p), in units of noise, and the prior."""
    return np.asarray(np.linalg.inv(slope.T @ slope + np.eye(slope.shape[1])))
