"""Do a servo's recordings at several gains agree? If not, a stated gain or load is wrong.

With the other numbers of the fit held, the gain alone is scanned for the recordings at each stated
gain. A wrong gain makes the fit a compromise: at gains of their own, the recordings fit far better.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tailbeat.identify.servo import as_servos
from tailbeat.identify.shaft import Bench, free_run
from tailbeat.identify.space import Parameter

Array = NDArray[np.float64]
FACTORS = np.geomspace(1 / 3, 3, 41)  # of the fitted gain
# Two gains contradict each other if their own best factors differ by more than `DIFFERENT` and
# leave less than `LEFT` of the mean square error. Chosen: twelve logs of a real servo at three
# gains have 1.2 and 0.77; a gain wrong by two or a third has 1.2 to 3.2 and 0.17 to 0.45. A fit
# that did not end has 1.6 and 0.49 there.
DIFFERENT, LEFT = 1.2, 0.55


@dataclass(frozen=True)
class Scan:
    """The recordings at one stated `gain`: their best factor on the fitted gain, and their mean
    square error [rad^2] as fitted and at that factor."""

    gain: float
    best: float
    fitted: float
    least: float


def contradictions(space: tuple[Parameter, ...], z: Array, benches: Sequence[Bench]) -> list[str]:
    """A sentence for the two stated gains that differ most, if one of them must be wrong; `z` (p,)
    is the fit."""
    scans = scan(space, z, benches)
    if len(scans) < 2:
        return []
    low, high = (choose(scans, key=lambda one: one.best) for choose in (min, max))
    left = (low.least + high.least) / (low.fitted + high.fitted)
    if high.best < DIFFERENT * low.best or left > LEFT:
        return []
    return [
        f"recordings at gain {high.gain:g} ask for {high.best / low.best:.1f} times the gain that"
        f" those at gain {low.gain:g} ask for: a stated gain or load is wrong, or they are of two"
        f" servos; correct it, or leave some out"
    ]


def scan(space: tuple[Parameter, ...], z: Array, benches: Sequence[Bench]) -> list[Scan]:
    """The best factor of each stated gain, by rising gain; empty if none is stated."""
    paths = [p.path for p in space]
    if "gain_scale" not in paths:
        return []
    gain = paths.index("gain_scale")
    tried = np.repeat(z[None], FACTORS.size, axis=0)
    tried[:, gain] += np.log(FACTORS) / space[gain].spread
    angles = free_run(as_servos(space, tried, benches), benches)
    errors: dict[float, list[Array]] = {}
    for angle, bench in sorted(zip(angles, benches, strict=True), key=lambda one: _gain(one[1])):
        error = np.square((angle - bench.angle)[:, bench.good]).mean(axis=1)
        errors.setdefault(_gain(bench), []).append(np.where(np.isfinite(error), error, np.inf))
    return [_scanned(stated, np.mean(own, axis=0)) for stated, own in errors.items()]


def _gain(bench: Bench) -> float:
    assert bench.gain is not None
    return bench.gain


def _scanned(gain: float, error: Array) -> Scan:
    best = int(np.argmin(error))
    return Scan(gain, float(FACTORS[best]), float(error[FACTORS.size // 2]), float(error[best]))
