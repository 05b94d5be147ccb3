"""Do a servo's recordings agree? If not, a gain or load that was stated is wrong.

With the other numbers of the fit held, the gain alone is scanned for the recordings at each stated
gain, and the load alone for those with each pendulum, and for each recording. A wrong one makes the
fit a compromise: with gains or loads of their own, the recordings fit far better. A number at the
end of its range is another sign of it.
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
# Two recordings that state one gain and load differ by more than `UNLIKE`. The real logs have up to
# 1.2, those of four simulated servos 1.1; one recording of twice the load has 1.6 to 2.2.
UNLIKE = 1.3
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
    of one of them must be wrong, or for two recordings that state the same and are not of the same
    tail or pendulum; `z` (p,) is the fit."""
    by_gain = _differing(scan(space, z, benches), "gain")
    if by_gain or len(benches) < 2:
        return by_gain
    loaded = [(one, _by_load(space, z, one)) for one in benches if one.load.kind != "nothing"]
    return _differing(_of_loads(loaded), "load") or _two_loads(loaded)


def _differing(scans: Sequence[Scan], what: str) -> list[str]:
    if len(scans) < 2:
        return []
    low, high = (choose(scans, key=lambda one: one.best) for choose in (min, max))
    if not _apart(low, high, DIFFERENT):
        return []
    return [
        f"recordings at {high.name} ask for {high.best / low.best:.1f} times the {what} that those"
        f" at {low.name} ask for: a stated gain or load is wrong, or they are of two servos;"
        f" correct it, or leave some out"
    ]


def _apart(low: Scan, high: Scan, ratio: float) -> bool:
    left = (low.least + high.least) / (low.fitted + high.fitted)
    return high.best >= ratio * low.best and left <= LEFT


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


def _by_load(space: tuple[Parameter, ...], z: Array, bench: Bench) -> Array:
    """Mean square error [rad^2] of one recording at every factor on its whole load."""
    load, parts = bench.load, ("stiffness", "damping", "inertia", "weight")
    scaled = [replace(load, **{p: by * getattr(load, p) for p in parts}) for by in FACTORS]
    moved = [replace(bench, load=one) for one in scaled]
    angles = free_run(as_servos(space, z[None], moved), moved)
    return np.array([_error(a, bench)[0] for a in angles])


def _of_loads(loaded: Sequence[tuple[Bench, Array]]) -> list[Scan]:
    """The best factor of each pendulum on its load, by rising load."""
    loads = {one.load for one, _ in loaded if one.load.weight > 0}
    return [
        _scanned(
            f"a load of {load.weight:.3g} N m",
            np.mean([error for one, error in loaded if one.load == load], axis=0),
        )
        for load in sorted(loads, key=lambda one: one.weight)
    ]


def _two_loads(loaded: Sequence[tuple[Bench, Array]]) -> list[str]:
    """A sentence for the first two recordings that state one gain and load and ask for two."""
    for load, gain in dict.fromkeys((one.load, one.gain) for one, _ in loaded):
        alike = [_scanned(b.name, e) for b, e in loaded if (b.load, b.gain) == (load, gain)]
        low, high = (choose(alike, key=lambda one: one.best) for choose in (min, max))
        if _apart(low, high, UNLIKE):
            return [
                f"{high.name} asks for {high.best / low.best:.1f} times the load that {low.name}"
                f" asks for, and both state the same: they are of two tails, loads or servos; leave"
                f" one out"
            ]
    return []


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
