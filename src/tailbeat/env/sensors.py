"""What the robot's sensors make of the truth: counts, noise, latency, dropped frames, staleness.

Every figure stands in `SensorModel` with its source, or "chosen, rounded up". A fish's noise for a
whole episode is drawn at its start from its own generator, so a fish in a batch hears what it would
hear alone.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
KEPT = 16  # frames held while they travel: a quarter of a second at 60 fps
PER_STEP = 2  # frames that can fall into one control step of 20 ms
DRAWS = 4 + 6 * PER_STEP  # random numbers per control step


@dataclass(frozen=True)
class SensorModel:
    """Figures of encoder, IMU and camera; SI."""

    encoder_count: float = 2 * np.pi / 4096  # rad, X-series manual
    velocity_count: float = 0.02398  # rad/s, 0.229 rpm, X-series manual
    encoder_age: float = 0.004  # s, largest: a read lies anywhere in its bus cycle; chosen
    yaw_rate_noise: float = 0.02  # rad/s rms: BNO055, 0.3 deg/s in its band, rounded up; chosen
    yaw_rate_bias: float = 0.02  # rad/s rms per episode: BNO055 data sheet 1 deg/s
    yaw_rate_drift: float = 0.01  # rad/s over an episode, rms; chosen
    spike_share: float = 0.001  # of samples; bit flips and bus errors, chosen
    spike_size: float = 5.0  # rad/s; chosen
    frame_rate: float = 60.0  # Hz
    latency: float = 0.030  # s: exposure, transfer, detection, link; chosen, rounded up
    latency_jitter: float = 0.015  # s, uniform on top; chosen
    dropped: float = 0.03  # share of frames without a tag; chosen, rounded up
    position_noise: float = 0.003  # m: refraction and corners at 3 m; rounded up
    yaw_noise: float = 0.01  # rad: 0.6 degrees; rounded up
    stamp_noise: float = 0.002  # s, of the clocks' offset; chosen


def quiet() -> SensorModel:
    """Sensors without noise, latency, drops or counts: the first stage of training."""
    names = [name for name in SensorModel.__annotations__ if name != "frame_rate"]
    return replace(SensorModel(), **dict.fromkeys(names, 0.0))


@dataclass(frozen=True, eq=False)
class SensorState:
    """n fish: episode noise (n, steps, DRAWS), yaw-rate bias and drift (n,), camera phase (n,) s,
    and the frames on their way (n, KEPT, 7): pose, target x, y, stamp, arrival [s]."""

    noise: NDArray[np.float32]
    bias: Array
    drift: Array
    phase: Array
    frames: Array


@dataclass(frozen=True)
class Readings:
    """What the loop has at hand: motor angle [rad] and velocity [rad/s], yaw rate [rad/s] (n,), and
    the three newest frames (n, 3, 6): fish x, y, yaw, target x, y, staleness."""

    motor_angle: Array
    motor_velocity: Array
    yaw_rate: Array
    frames: Array


def empty(count: int, steps: int) -> SensorState:
    """Sensors before their first `begin`."""
    return SensorState(
        np.zeros((count, steps, DRAWS), dtype=np.float32),
        np.zeros(count),
        np.zeros(count),
        np.zeros(count),
        np.zeros((count, KEPT, 7)),
    )


def begin(
    model: SensorModel,
    state: SensorState,
    fish: int,
    pose: Array,
    target: Array,
    rng: np.random.Generator,
) -> None:
    """Draw one fish's episode, in place; frames before the start show the start."""
    steps = state.noise.shape[1]
    state.noise[fish] = rng.standard_normal((steps, DRAWS), dtype=np.float32)
    bias, drift, phase = rng.normal(), rng.normal(), rng.uniform()
    state.bias[fish] = model.yaw_rate_bias * bias
    state.drift[fish] = model.yaw_rate_drift * drift / steps
    state.phase[fish] = phase / model.frame_rate
    number = np.arange(-KEPT + 1, 1)
    stamp = state.phase[fish] + (number - 1) / model.frame_rate
    rows = np.column_stack([np.tile([*pose, *target], (KEPT, 1)), stamp, stamp])
    state.frames[fish, number % KEPT] = rows


def sense(
    model: SensorModel,
    state: SensorState,
    step: NDArray[np.int64],
    period: float,
    before: Array,
    after: Array,
    target: Array,
    angle: Array,
    velocity: Array,
    yaw_rate: Array,
) -> Readings:
    """Readings at the end of control step `step` (n,), counted from 0; moves `state.frames` on.

    `before`, `after` (n, 3) are the tag's poses at both ends of the step, `target` (n, 2); `angle`,
    `velocity` and `yaw_rate` (n,) are true at its end.
    """
    readings, frames = np.empty((3, len(step))), np.empty((len(step), 3, 6))
    _sense(
        figures(model), state.noise, state.bias, state.drift, state.phase, state.frames, step,
        period, before, after, target, angle, velocity, yaw_rate, readings, frames,
    )  # fmt: skip
    return Readings(readings[0], readings[1], readings[2], frames)


@cache
def figures(model: SensorModel) -> Array:
    """A model's figures in their order, for the kernels."""
    return np.array(list(vars(model).values()), dtype=np.float64)


@njit(cache=True)
def _sense(  # type: ignore[no-untyped-def]
    figures, noise, bias, drift, phase, frames, step, period, before, after, target, angle,
    velocity, yaw_rate, readings, found,
):  # fmt: skip
    """One fish after the other: film what falls into the step, then read encoder and IMU."""
    for i in range(len(step)):
        draws, now = noise[i, step[i]], (step[i] + 1) * period
        _film(figures, draws, now, period, phase[i], before[i], after[i], target[i], frames[i])
        age = figures[2] * _uniform(draws[0])
        readings[0, i] = _counted(angle[i] - age * velocity[i], figures[0])
        readings[1, i] = _counted(velocity[i], figures[1])
        readings[2, i] = yaw_rate[i] + bias[i] + drift[i] * step[i] + figures[3] * draws[1]
        if _uniform(draws[2]) < figures[6]:
            readings[2, i] += figures[7] * np.sign(draws[3])
        _newest(frames[i], now, found[i])


@njit(cache=True)
def _film(figures, draws, now, period, phase, before, after, target, frames):  # type: ignore[no-untyped-def]
    """Take the frames that fall into the step that ends `now`."""
    rate, latency, jitter, dropped = figures[8], figures[9], figures[10], figures[11]
    place, yaw, clock = figures[12], figures[13], figures[14]
    first = int(np.floor((now - period - phase) * rate + 1e-9)) + 1
    for k in range(PER_STEP):
        number = first + k
        stamp = phase + number / rate
        if stamp > now + 1e-9:
            return
        own, row = draws[4 + 6 * k :], frames[number % KEPT]
        share = (stamp - now) / period + 1
        for j in range(3):
            spread = place if j < 2 else yaw
            row[j] = before[j] + share * (after[j] - before[j]) + spread * own[j]
        row[3], row[4] = target[0], target[1]
        row[5] = stamp + clock * own[3]
        lost = _uniform(own[5]) < dropped
        row[6] = np.inf if lost else stamp + latency + jitter * _uniform(own[4])


def newest(state: SensorState, now: Array) -> Array:
    """The three newest frames that have arrived, with their staleness (n, 3, 6)."""
    found = np.empty((len(now), 3, 6))
    for fish, time in enumerate(now):
        _newest(state.frames[fish], time, found[fish])
    return found


@njit(cache=True)
def _newest(frames, now, found):  # type: ignore[no-untyped-def]
    last = np.inf
    for k in range(3):
        best = -1
        for j in range(KEPT):
            late = frames[j, 6] > now + 1e-9 or frames[j, 5] >= last
            if not late and (best < 0 or frames[j, 5] > frames[best, 5]):
                best = j
        last = frames[best, 5]
        for j in range(5):
            found[k, j] = frames[best, j]
        found[k, 5] = now - last


@njit(cache=True)
def _counted(value, count):  # type: ignore[no-untyped-def]
    return np.round(value / count) * count if count > 0 else value


@njit(cache=True)
def _uniform(normal):  # type: ignore[no-untyped-def]
    """Uniform number in (0, 1) from a normal one (logistic approximation, within 0.02)."""
    return 1 / (1 + np.exp(-1.702 * normal))
