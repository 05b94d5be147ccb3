"""What the robot's sensors make of the truth: counts, noise, latency, dropped frames, staleness.

Every figure stands in `SensorModel` with its source, or "chosen, rounded up". A fish's noise for a
whole episode is drawn at its start from its own generator, so a fish in a batch hears what it would
hear alone.
"""

from dataclasses import dataclass, replace

import numpy as np
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
    motor: Array,
    yaw_rate: Array,
) -> Readings:
    """Readings at the end of control step `step` (n,), counted from 0; moves `state.frames` on.

    `before`, `after` (n, 3) are the tag's poses at both ends of the step, `target` (n, 2), `motor`
    (n, 2) angle and velocity.
    """
    every = np.arange(len(step))
    draws = state.noise[every, step].astype(float)
    now = np.asarray((step + 1) * period, dtype=np.float64)
    _film(model, state, draws, now, period, before, after, target)
    age = model.encoder_age * _uniform(draws[:, 0])
    angle = _counted(motor[:, 0] - age * motor[:, 1], model.encoder_count)
    velocity = _counted(motor[:, 1], model.velocity_count)
    spike = _uniform(draws[:, 2]) < model.spike_share
    gyro = yaw_rate + state.bias + state.drift * step + model.yaw_rate_noise * draws[:, 1]
    gyro = np.where(spike, gyro + model.spike_size * np.sign(draws[:, 3]), gyro)
    return Readings(angle, velocity, gyro, newest(state, now))


def _film(
    model: SensorModel,
    state: SensorState,
    draws: Array,
    now: Array,
    period: float,
    before: Array,
    after: Array,
    target: Array,
) -> None:
    """Take the frames that fall into the step that ends `now`."""
    first = np.floor((now - period - state.phase) * model.frame_rate + 1e-9).astype(int) + 1
    for i in range(PER_STEP):
        number = first + i
        stamp = state.phase + number / model.frame_rate
        taken = stamp <= now + 1e-9
        own = draws[:, 4 + 6 * i : 10 + 6 * i]
        share = ((stamp - now) / period + 1)[:, None]
        noise = own[:, :3] * [model.position_noise, model.position_noise, model.yaw_noise]
        pose = before + share * (after - before) + noise
        late = model.latency + model.latency_jitter * _uniform(own[:, 4])
        lost = _uniform(own[:, 5]) < model.dropped
        arrival = np.where(lost, np.inf, stamp + late)
        seen = stamp + model.stamp_noise * own[:, 3]
        rows = np.column_stack([pose, target, seen, arrival])[taken]
        state.frames[np.flatnonzero(taken), number[taken] % KEPT] = rows


def newest(state: SensorState, now: Array) -> Array:
    """The three newest frames that have arrived, with their staleness (n, 3, 6)."""
    stamp = np.where(state.frames[:, :, 6] <= now[:, None] + 1e-9, state.frames[:, :, 5], -np.inf)
    order = np.argsort(-stamp, axis=1, kind="stable")[:, :3]
    frames = np.take_along_axis(state.frames, order[:, :, None], axis=1)[:, :, :6].copy()
    frames[:, :, 5] = now[:, None] - frames[:, :, 5]
    return frames


def _counted(values: Array, count: float) -> Array:
    return np.round(values / count) * count if count > 0 else values


def _uniform(normal: Array) -> Array:
    """Uniform numbers in (0, 1) from normal ones (logistic approximation, within 0.02)."""
    return np.asarray(1 / (1 + np.exp(-1.702 * normal)))
