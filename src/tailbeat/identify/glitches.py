"""Find impossible samples (glitches) by limits of speed and acceleration.

In a chain, each sample is reachable from the two samples before it within the limits. Of every
column the chain with the largest weight is kept (dynamic programming over a window). So a burst of
several wrong samples is found by the good ones around it. The residuals of a fit are not used: a
misfit of the model is not a glitch. Glitches are left out, never replaced.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tailbeat.files import BadInput
from tailbeat.recording import Recording

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
WINDOW = 48  # samples that a chain may skip; after more, a new chain starts
STUCK, LIGHT = 3, 0.6  # equal samples in a row that may be stuck, and the weight of each
BROKEN = 0.1  # fraction of a run of equal values; if a chain drops more, the whole run is dropped
MISSING = 1.75  # times the median interval: above it a frame is missing
MOST = 0.5  # largest fraction of a column's samples that may be glitches
ISLAND = 3  # fewest samples in a row between glitches that are kept
FEWEST = 8  # fewest samples that are searched
TURN = 2 * np.pi
COUNTS = 2.0**31  # at most, of an encoder: more are no 16 bits in another order


@dataclass(frozen=True)
class SignalLimits:
    """Limits of a signal: largest speed [unit/s] and acceleration [unit/s^2], and a sample's
    largest noise [unit]. `circular`: an angle that is known only up to whole turns."""

    speed: float
    acceleration: float
    noise: float
    circular: bool = False


# All chosen, with a margin. A fast position servo reaches 15 rad/s without load, and 300 rad/s^2. A
# tail is driven at 5 Hz and 0.4 rad at most; a slow pull is slower. No fish here swims at 1 m/s; a
# tail's tip at 5 Hz and 0.1 m has 3 m/s and 100 m/s^2. Noise: three to seven counts of an encoder,
# a camera's pixels.
SHAFT = SignalLimits(speed=25.0, acceleration=500.0, noise=0.005)
TAIL = SignalLimits(speed=15.0, acceleration=500.0, noise=0.01)
SLOW_PULL = SignalLimits(speed=2.0, acceleration=20.0, noise=0.01)
PLACE = SignalLimits(speed=3.0, acceleration=30.0, noise=0.01)
HEADING = SignalLimits(speed=20.0, acceleration=500.0, noise=0.05, circular=True)
MARKER = SignalLimits(speed=6.0, acceleration=300.0, noise=0.01)


@dataclass(frozen=True)
class Glitch:
    """Samples of one column and kind: jump, swapped bytes, frozen, stuck, or gap.

    `times` [s] are of the samples; for a gap, of the last sample before it.
    """

    recording: str
    column: str
    kind: str
    times: tuple[float, ...]


def find(
    recording: Recording, limits: Mapping[str, SignalLimits]
) -> tuple[dict[str, Mask], list[Glitch]]:
    """Which samples of each named column are good (n,), and the glitches and gaps.

    Each part in which time rises and the condition stays is searched alone. Raises BadInput if more
    than half of a column's samples are glitches.
    """
    parts = stretches(recording)
    good: dict[str, Mask] = {}
    found = _named(recording, "time_s", np.concatenate([gaps(recording.time[p]) for p in parts]))
    for name, limit in limits.items():
        values = recording.columns[name]
        kinds = np.concatenate([judge(recording.time[p], values[p], limit) for p in parts])
        good[name] = kinds == ""
        _refuse_nothing_left(recording.name, name, good[name])
        found += _named(recording, name, kinds)
    return good, found


def _named(recording: Recording, column: str, kinds: NDArray[np.str_]) -> list[Glitch]:
    return [
        Glitch(recording.name, column, str(kind), tuple(recording.time[kinds == kind].tolist()))
        for kind in np.unique(kinds[kinds != ""])
    ]


def _refuse_nothing_left(recording: str, column: str, good: Mask) -> None:
    if good.mean() < 1 - MOST:
        raise BadInput(
            f"{recording}: column {column}: {100 * (1 - good.mean()):.0f} % of the samples move"
            f" faster than any shaft or fish can; allowed is {100 * MOST:.0f} %. Check its unit,"
            f" the unit of time and the sensor, and record again."
        )


def stretches(recording: Recording) -> list[slice]:
    """The parts of a recording in which time rises and the condition stays."""
    anew = np.diff(recording.time) <= 0
    if (labels := recording.labels.get("condition")) is not None:
        anew |= labels[1:] != labels[:-1]
    edges = [0, *(np.flatnonzero(anew) + 1).tolist(), recording.time.size]
    return [slice(first, last) for first, last in pairwise(edges)]


def gaps(time: Array) -> NDArray[np.str_]:
    """`gap` (n,) at the last sample before missing frames, else empty. A gap removes no sample."""
    kinds = np.full(time.size, "", dtype="<U13")
    if time.size >= FEWEST:
        step = np.diff(time)
        kinds[:-1][step > MISSING * np.median(step)] = "gap"
    return kinds


def judge(time: Array, values: Array, limits: SignalLimits) -> NDArray[np.str_]:
    """The kind of each sample (n,) of rising times (not checked): empty if it is good or was not
    seen (NaN)."""
    kinds = np.full(values.size, "", dtype="<U13")
    seen = np.flatnonzero(np.isfinite(values))
    if seen.size < FEWEST:
        return kinds
    time, values = time[seen], values[seen]
    runs = _runs(values)
    kept = _chain(
        time,
        values,
        _weights(time, values, runs, limits),
        np.array(_numbers(limits)),
        limits.circular,
    )
    kept = _without_islands(_whole_runs(kept, runs))
    kinds[seen] = _kinds(time, values, kept, runs, limits)
    return kinds


def _numbers(limits: SignalLimits) -> tuple[float, float, float]:
    return limits.speed, limits.acceleration, limits.noise


def _runs(values: Array) -> NDArray[np.int_]:
    """The number of the run of equal values that each sample belongs to."""
    return np.cumsum(np.concatenate([[0], np.diff(values) != 0]).astype(int))


def _weights(time: Array, values: Array, runs: NDArray[np.int_], limits: SignalLimits) -> Array:
    """Weight of each sample in a chain: less in a run that may be stuck, so that its samples are
    dropped first.

    A run may be stuck if the steps into it and out of it are both faster than the limits.
    """
    step = np.diff(values)
    if limits.circular:
        step -= TURN * np.round(step / TURN)
    leaps = np.abs(step) > limits.speed * np.diff(time) + limits.noise
    first = np.searchsorted(runs, runs)
    last = np.searchsorted(runs, runs, side="right") - 1
    entered, left = np.append(True, leaps)[first], np.append(leaps, True)[last]
    return np.where((last - first + 1 >= STUCK) & entered & left, LIGHT, 1.0)


def _whole_runs(kept: Mask, runs: NDArray[np.int_]) -> Mask:
    """If a chain drops a part of a run of equal values, drop the run from its second sample on.

    The value froze while the shaft moved; a chain drops only the samples out of its reach.
    """
    broken = np.bincount(runs, weights=~kept) > BROKEN * np.bincount(runs)
    first = np.searchsorted(runs, runs) == np.arange(runs.size)
    return np.asarray(kept & (~broken[runs] | first))


def _without_islands(kept: Mask) -> Mask:
    """Drop short runs of samples between glitches: after a long gap most values are possible."""
    if kept.all():
        return kept
    own = _runs(kept.astype(float))
    return np.asarray(kept & (np.bincount(own)[own] >= ISLAND))


# ---- the chain ----------------------------------------------------------------------------------


@njit(cache=True)
def _chain(time, values, weight, limits, circular):  # type: ignore[no-untyped-def]
    """Which samples are in the chain of largest weight. After a skipped window a new one starts."""
    speed, acceleration, noise = limits
    n = time.size
    if _unbroken(time, values, limits, circular):  # no chain weighs more than all samples
        return np.ones(n, dtype=np.bool_)
    score = np.zeros((n, WINDOW + 1))  # of the chain that ends i, j with i = j - column; 0: at j
    back = np.full((n, WINDOW + 1), -1)  # columns to go back from i to the sample before it
    before = np.full(n, -1)  # of a chain that starts at j: the last sample of the chain before
    column = np.zeros(n, dtype=np.int64)  # of the best chain that ends at j
    best, best_at, ahead, ahead_at = 0.0, 0, 0.0, -1
    for j in range(n):
        if j > WINDOW:
            own = score[j - WINDOW - 1, column[j - WINDOW - 1]]
            if own > ahead:
                ahead, ahead_at = own, j - WINDOW - 1
        score[j, 0], before[j] = weight[j] + ahead, ahead_at
        for c in range(1, min(j, WINDOW) + 1):
            i = j - c
            slope, off = _slope(time, values, i, j, noise, circular)
            if abs(slope) > speed + off:
                continue
            total, chosen = score[i, 0], 0
            for d in range(1, min(i, WINDOW) + 1):
                if score[i, d] <= total:
                    continue
                other, more = _slope(time, values, i - d, i, noise, circular)
                reach = acceleration * (time[j] - time[i - d]) / 2
                if abs(slope - other) <= reach + off + more:
                    total, chosen = score[i, d], d
            score[j, c], back[j, c] = total + weight[j], chosen
            if score[j, c] > score[j, column[j]]:
                column[j] = c
        if score[j, column[j]] > best:
            best, best_at = score[j, column[j]], j
    return _traced(n, best_at, column, back, before)


@njit(cache=True)
def _unbroken(time, values, limits, circular):  # type: ignore[no-untyped-def]
    """Whether all samples, one after the other, are one chain."""
    speed, acceleration, noise = limits
    before, soft = 0.0, np.inf
    for j in range(1, time.size):
        slope, off = _slope(time, values, j - 1, j, noise, circular)
        if abs(slope) > speed + off:
            return False
        reach = acceleration * (time[j] - time[max(j - 2, 0)]) / 2
        if abs(slope - before) > reach + off + soft:
            return False
        before, soft = slope, off
    return True


@njit(cache=True)
def _slope(time, values, i, j, noise, circular):  # type: ignore[no-untyped-def]
    """Mean speed from sample i to j, and the part of it that may be noise."""
    step = values[j] - values[i]
    if circular:
        step -= TURN * np.round(step / TURN)
    span = time[j] - time[i]
    return step / span, noise / span


@njit(cache=True)
def _traced(n, end, column, back, before):  # type: ignore[no-untyped-def]
    kept = np.zeros(n, dtype=np.bool_)
    j, c = end, column[end]
    while j >= 0:
        kept[j] = True
        if c == 0:
            j = before[j]
            c = column[j] if j >= 0 else 0
        else:
            j, c = j - c, back[j, c]
    return kept


# ---- kinds --------------------------------------------------------------------------------------


def _kinds(
    time: Array, values: Array, kept: Mask, runs: NDArray[np.int_], limits: SignalLimits
) -> NDArray[np.str_]:
    """The kind of each sample that is not kept; empty for the others."""
    kinds = np.full(values.size, "", dtype="<U13")
    if kept.all():
        return kinds
    length = np.bincount(runs)[runs]
    first = np.searchsorted(runs, runs)
    lost = ~kept
    kinds[lost] = "jump"
    kinds[lost & _swapped(time, values, kept, limits)] = "swapped bytes"
    kinds[lost & (length > 2)] = "stuck"
    kinds[lost & (length > 1) & kept[first]] = "frozen"
    return kinds


def _swapped(time: Array, values: Array, kept: Mask, limits: SignalLimits) -> Mask:
    """Whether a sample fits between its neighbours once the bytes of its 16-bit count are swapped.

    Counts are 4096 per turn, from 0, from half a turn, or signed, as common encoders have them.
    """
    if not kept.any():
        return np.zeros(values.size, dtype=bool)
    expected = np.interp(time, time[kept], values[kept])
    near = limits.noise + limits.speed * np.median(np.diff(time))
    fits = np.zeros(values.size, dtype=bool)
    for zero in (0, 2048):
        counted = np.clip(values / TURN * 4096, -COUNTS, COUNTS)
        count = np.round(counted).astype(np.int64) + zero
        count16 = count & 0xFFFF
        turned = (count16 & 0xFF) << 8 | count16 >> 8
        for other in (turned, np.where(turned > 32767, turned - 65536, turned)):
            fits |= np.abs((other - zero) * TURN / 4096 - expected) < near
    return np.asarray(fits & (np.abs(values - expected) > near))
