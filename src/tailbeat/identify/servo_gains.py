"""Do a servo's recordings at several gains and loads agree? If not, one that was stated is wrong.

With the other numbers of the fit held, the gain alone is scanned for the recordings at each stated
gain, and the load alone for those with each pendulum. A wrong one makes the fit a compromise: with
gains or loads of their own, the recordings fit far better. A number at the end of its range is
another sign of it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tailbeat.identify.servo import as_servos
from tailbeat.identify.shaft import Bench, free_run
from tailbeat.identify.space import Parameter, values

Array = NDArray[np.float64]
FACTORS = np.geomspace(1 / 3, 3, 41)  # of the fitted gain
# Two groups contradict each other if their own best factors differ by more than `DIFFERENT` and
# leave less than `LEFT` of the mean square error. Chosen: twelve logs of a real servo at three
# gains have 1.2 and 0.77; a gain wrong by two or a third has 1.2 to 3.2 and 0.17 to 0.45. A fit
# that did not end has 1.6 and 0.49 there. Right loads of four simulated servos have 1.0 and 1.0; of
# fifteen wrong ones ten are told, and three more by a number at the end of its range.
DIFFERENT, LEFT = 1.2, 0.55
NEAR = 0.01  # of the end of a range
# At its lower end a gain is none at all; other numbers may be next to nothing. A torque that no
# recording reaches has no upper end.
BOTH_ENDS, OPEN = ("gain_scale", "kp", "force_limit"), ("force_limit",)


@dataclass(frozen=True)
class Scan:
    """The recordings at one stated gain or load, by `name`: their best factor on the fitted gain or
    the stated load, and their mean square error [rad^2] as fitted and at that factor."""

    name: str
    best: float
    fitted: float
    least: float


def at_edges(space: tuple[Parameter, ...], z: Array) -> list[str]:
    """A sentence if numbers of the fit `z` (p,) stopped at an end of their range that no servo
    has."""
    stopped = [
        f"{p.path} {value:.3g} {p.unit}"
        for p, value in zip(space, values(space, z).values(), strict=True)
        if (p.path in BOTH_ENDS and value < p.low * (1 + NEAR))
        or (p.path not in OPEN and value > p.high * (1 - NEAR))
    ]
    if not stopped:
        return []
    return [
        f"{', '.join(stopped)} stopped at the end of its range: signs, units or the load of the"
        f" recordings are wrong; correct them"
    ]


def contradictions(space: tuple[Parameter, ...], z: Array, benches: Sequence[Bench]) -> list[str]:
    """A sentence for the two gains, and one for the two loads, that differ most, if what is stated
    of one of them must be wrong; `z` (p,) is the fit."""
    by_gain = _differing(scan(space, z, benches), "gain")
    return by_gain or _differing(scan_loads(space, z, benches), "load")


def _differing(scans: Sequence[Scan], what: str) -> list[str]:
    if len(scans) < 2:
        return []
    low, high = (choose(scans, key=lambda one: one.best) for choose in (min, max))
    left = (low.least + high.least) / (low.fitted + high.fitted)
    if high.best < DIFFERENT * low.best or left > LEFT:
        return []
    return [
        f"recordings at {high.name} ask for {high.best / low.best:.1f} times the {what} that those"
        f" at {low.name} ask for: a stated gain or load is wrong, or they are of two servos;"
        f" correct it, or leave some out"
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
        errors.setdefault(_gain(bench), []).append(_error(angle, bench))
    return [_scanned(f"gain {stated:g}", np.mean(own, axis=0)) for stated, own in errors.items()]


def scan_loads(space: tuple[Parameter, ...], z: Array, benches: Sequence[Bench]) -> list[Scan]:
    """The best factor of each pendulum on its load, by rising load; empty if there is one."""
    loads = {one.load for one in benches if one.load.weight > 0}
    if len(loads) < 2:
        return []
    found = []
    for load in sorted(loads, key=lambda one: one.weight):
        own, errors = [one for one in benches if one.load == load], []
        for factor in FACTORS:
            scaled = replace(load, inertia=factor * load.inertia, weight=factor * load.weight)
            moved = [replace(one, load=scaled) for one in own]
            angles = free_run(as_servos(space, z[None], moved), moved)
            errors.append(np.mean([_error(a, b) for a, b in zip(angles, moved, strict=True)]))
        found.append(_scanned(f"a load of {load.weight:.3g} N m", np.array(errors)))
    return found


def _gain(bench: Bench) -> float:
    assert bench.gain is not None
    return bench.gain


def _error(angle: Array, bench: Bench) -> Array:
    """Mean square error (n,) of n simulated angles [rad^2]; infinite if one became unstable."""
    error = np.square((angle - bench.angle)[:, bench.good]).mean(axis=1)
    return np.where(np.isfinite(error), error, np.inf)


def _scanned(name: str, error: Array) -> Scan:
    best = int(np.argmin(error))
    return Scan(name, float(FACTORS[best]), float(error[FACTORS.size // 2]), float(error[best]))
