"""Two more test bench recordings of a tail: a slow pull, and a release.

A slow pull shows the hysteresis loop, and the stiffness of a static test. A released tail rings
down at the natural frequency.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.optimize import least_squares

from tailbeat.files import BadInput
from tailbeat.identify.estimate import Estimate
from tailbeat.identify.response import HALF_TURN, check_angle, check_clipping
from tailbeat.recording import Recording, check_continuous, require

Array = NDArray[np.float64]
HELD = 0.97  # fraction of the first deflection above which a tail counts as still held
FEWEST_RINGS = 2.0
QUIET = 3.0  # standard deviations of the noise; the ring-down ends when it falls below them


# ---- slow pull ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Loop:
    """Stiffness from a static test [N m/rad]: while loading, while unloading, and over the loop.

    `width` is the loop's mean height [N m], twice the friction of tail and tendons in a slow pull.
    `energy` is its area [J] per cycle.
    """

    loading: float
    unloading: float
    whole: float
    width: float
    energy: float


def static_loop(recording: Recording) -> Loop:
    """Stiffness from a slow pull: the slope of torque over angle about the middle of both.

    Needs `angle_rad` and `torque_nm`, the torque that turns the shaft. Friction adds to the torque
    while loading and subtracts while unloading; neither slope is the spring's stiffness. Raises
    BadInput if the angle moves in one direction only, looks like degrees, or the torque is clipped.
    """
    require(recording, ["angle_rad", "torque_nm"])
    check_angle(recording.name, "angle_rad", recording.columns["angle_rad"], HALF_TURN)
    check_clipping(recording.name, "torque_nm", recording.columns["torque_nm"])
    angle, torque = (_centred(recording.columns[n]) for n in ("angle_rad", "torque_nm"))
    speed = np.gradient(_smooth(angle), recording.time)
    outwards = angle * speed > 0
    moving = np.abs(speed) > 0.1 * np.abs(speed).max()
    loading, unloading = outwards & moving, ~outwards & moving
    there, back = moving & (speed > 0), moving & (speed < 0)
    if min(there.mean(), back.mean()) < 0.2:
        raise BadInput(
            f"{recording.name}: the angle moves in one direction only; pull the tail slowly to both"
            f" sides and back, at least once."
        )
    whole = _slope(angle, torque)
    width = float(
        np.mean((torque - whole * angle)[there]) - np.mean((torque - whole * angle)[back])
    )
    cycles = max(np.sum(np.diff(np.sign(speed[moving])) != 0) / 2, 0.5)
    energy = np.trapezoid(torque * np.gradient(angle, recording.time), recording.time)
    return Loop(
        _slope(angle[loading], torque[loading]),
        _slope(angle[unloading], torque[unloading]),
        whole,
        width,
        float(energy / cycles),
    )


def _centred(signal: Array) -> Array:
    return np.asarray(signal - (signal.max() + signal.min()) / 2)


def _smooth(signal: Array) -> Array:
    """Mean over a 50th of the recording, to smooth the steps of an encoder's counts."""
    width = max(signal.size // 50, 1)
    padded = np.pad(signal, (width, width), mode="edge")
    return np.convolve(padded, np.ones(width) / width, mode="same")[width:-width]


def _slope(angle: Array, torque: Array) -> float:
    return float(angle @ torque / (angle @ angle))


# ---- ring-down ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class RingDown:
    """Natural (undamped) frequency [Hz] and damping ratio, from `start` to `end` [s] of `column`.
    `time` [s], `measured` and `fitted` (k,) are for a figure."""

    recording: str
    column: str
    natural_frequency: Estimate
    damping_ratio: Estimate
    start: float
    end: float
    time: Array
    measured: Array
    fitted: Array


def ring_down(recording: Recording) -> RingDown:
    """Fit one decaying oscillation to a released tail.

    Reads `angle_rad`, or the only column. The position of the tip will do: neither result depends
    on the unit. The fit starts at the first pass through rest after the release. Intervals allow
    for correlated noise. Raises BadInput if the tail does not ring.
    """
    check_continuous(recording)
    column = _moving_column(recording)
    signal = recording.columns[column]
    first, last = _ringing(recording, signal)
    time, part = recording.time[first:last], signal[first:last]
    frequency = _first_guess(recording, time, part)
    start = np.array([2 * np.pi * frequency, 0.05 * 2 * np.pi * frequency])
    found = least_squares(lambda p: _misfit(p, time, part), start, x_scale=start)
    values, deviation = found.x, _deviation(found.jac, found.fun)
    natural, ratio = _from_rates(*values)
    slopes = np.stack([np.array(_from_rates(*(values + step))) for step in np.diag(1e-6 * start)])
    jacobian = (slopes - [natural, ratio]) / (1e-6 * start)[:, None]
    reach = stats.norm.ppf(0.975) * np.sqrt(np.diag(jacobian.T @ deviation @ jacobian))
    return RingDown(
        recording.name,
        column,
        Estimate(natural, (natural - reach[0], natural + reach[0]), "Hz"),
        Estimate(ratio, (ratio - reach[1], ratio + reach[1])),
        float(time[0]),
        float(time[-1]),
        time,
        part,
        part - _misfit(values, time, part),
    )


def _from_rates(damped: float, decay: float) -> tuple[float, float]:
    natural = float(np.hypot(damped, decay))
    return natural / (2 * np.pi), float(decay) / natural


def _moving_column(recording: Recording) -> str:
    if "angle_rad" in recording.columns:
        return "angle_rad"
    if len(recording.columns) != 1:
        raise BadInput(
            f"{recording.name}: a ring-down needs angle_rad, or only one column; the recording has"
            f" {', '.join(recording.columns)}."
        )
    return next(iter(recording.columns))


def _ringing(recording: Recording, signal: Array) -> tuple[int, int]:
    """Rows from the first pass through rest after the release to the last one above the noise."""
    tail = signal[-max(signal.size // 5, 5) :]
    away = signal - np.median(tail)
    side = np.sign(np.median(away[: max(signal.size // 50, 3)]))
    held = np.flatnonzero(side * away > HELD * np.abs(away).max())
    after = np.flatnonzero(side * away <= 0)
    passed = after[after > (held[-1] if held.size else 0)]
    noise = 1.4826 * np.median(np.abs(tail - np.median(tail)))
    loud = np.flatnonzero(np.abs(away) > QUIET * noise)
    if side == 0 or not (passed.size and loud.size) or loud[-1] - passed[0] < 10:
        raise BadInput(
            f"{recording.name}: no ring-down found: the tail must be held aside, released, and seen"
            f" to swing past rest; record from before the release until it is still."
        )
    return int(passed[0]), int(loud[-1]) + 1


def _first_guess(recording: Recording, time: Array, part: Array) -> float:
    """Frequency [Hz] by counting passes through rest."""
    away = part - np.median(part)
    passes = np.flatnonzero(np.diff(np.sign(away)) != 0)
    rings = (passes.size - 1) / 2
    if rings < FEWEST_RINGS:
        raise BadInput(
            f"{recording.name}: {max(rings, 0):.1f} swings after the release; at least"
            f" {FEWEST_RINGS:.0f} are needed for a damping ratio."
        )
    return float(rings / (time[passes[-1]] - time[passes[0]]))


def _misfit(rates: Array, time: Array, part: Array) -> Array:
    """Residuals (k,) of the best decaying oscillation with these rates. The rest position may drift
    linearly."""
    since = time - time[0]
    wave = np.exp((-rates[1] + 1j * rates[0]) * since)
    basis = np.stack([wave.real, wave.imag, np.ones_like(since), since], axis=1)
    fit, *_ = np.linalg.lstsq(basis, part, rcond=None)
    return np.asarray(part - basis @ fit)


def _deviation(jacobian: Array, rest: Array) -> Array:
    """Covariance (2, 2) of the rates, increased for correlated residuals."""
    lagged = np.correlate(rest, rest, mode="full")[rest.size - 1 :] / (rest @ rest)
    ends = np.flatnonzero(lagged < 0.05)
    together = 1 + 2 * lagged[1 : ends[0] if ends.size else rest.size].sum()
    variance = rest @ rest / max(rest.size - 6, 1) * max(together, 1.0)
    return np.asarray(variance * np.linalg.inv(jacobian.T @ jacobian))
