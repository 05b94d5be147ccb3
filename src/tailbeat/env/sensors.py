"""Model of the robot's sensors: counts, noise, latency, dropped frames, staleness.

Every number is in `SensorModel` with its source, or "chosen, rounded up". A fish's noise for a
whole episode is drawn at its start from its own random generator, so the readings are the same
alone or in a batch.
"""

from collections import namedtuple
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tailbeat.control import camera_yaw
from tailbeat.control.actions import PERIOD
from tailbeat.control.corrections import Corrections, corrected_frames
from tailbeat.control.motion import MotionFilter

Array = NDArray[np.float64]
KEPT = 16  # frames kept until they arrive: a quarter of a second at 60 fps
PER_STEP = 2  # frames that can fall into one control step of 20 ms
DRAWS = 4 + 6 * PER_STEP  # random numbers per control step


@dataclass(frozen=True)
class SensorModel:
    """Parameters of encoder, IMU and camera; SI units."""

    encoder_count: float = 2 * np.pi / 4096  # rad, X-series manual
    velocity_count: float = 0.02398  # rad/s, 0.229 rpm, X-series manual
    encoder_age: float = 0.004  # s, largest: a read is at any time of its bus cycle; chosen
    yaw_rate_noise: float = 0.02  # rad/s rms: BNO055, 0.3 deg/s in its band, rounded up; chosen
    yaw_rate_bias: float = 0.02  # rad/s rms per episode: BNO055 data sheet 1 deg/s
    yaw_rate_drift: float = 0.01  # rad/s over an episode, rms; chosen
    spike_share: float = 0.001  # fraction of samples; bit flips and bus errors, chosen
    spike_size: float = 5.0  # rad/s; chosen
    frame_rate: float = 60.0  # Hz
    latency: float = 0.030  # s: exposure, transfer, detection, link; chosen, rounded up
    latency_jitter: float = 0.015  # s, uniform on top; chosen
    dropped: float = 0.03  # fraction of frames without a tag; chosen, rounded up
    position_noise: float = 0.003  # m: refraction and corners at 3 m; rounded up
    yaw_noise: float = 0.01  # rad: 0.6 degrees; rounded up
    stamp_noise: float = 0.002  # s, error of the clock offset; chosen


# numba reads named tuples, but not dataclasses
Figures: Any = namedtuple("Figures", list(SensorModel.__annotations__))  # type: ignore[misc]


def quiet() -> SensorModel:
    """Sensors without noise, latency, drops or counts: the first stage of training."""
    names = [name for name in SensorModel.__annotations__ if name != "frame_rate"]
    return replace(SensorModel(), **dict.fromkeys(names, 0.0))


def motion_filter(model: SensorModel | None = None) -> MotionFilter:
    """The filter of velocities for a camera's noise, by default that of `SensorModel`."""
    return MotionFilter(noise=(model or SensorModel()).position_noise)


class SensorState(NamedTuple):
    """Sensor state of n fish: episode noise (n, steps, DRAWS), yaw-rate bias and drift (n,), camera
    phase (n,) [s], the frames not yet arrived (n, KEPT, 7): pose, target x, y, stamp, arrival
    [s]; what a lab got wrong: more latency (n,) [s], steps (n, steps) whose frames are lost."""

    noise: NDArray[np.float32]
    bias: Array
    drift: Array
    phase: Array
    frames: Array
    late: Array
    dark: NDArray[np.bool_]


class Motion(NamedTuple):
    """True motion of n fish in one control step.

    The tag's poses `before` and `after` it (n, 3), and the target's positions `was` and `target`
    (n, 2), between which a frame shows both; at its end motor angle [rad], its velocity and the yaw
    rate [rad/s] (n,).
    """

    before: Array
    after: Array
    was: Array
    target: Array
    angle: Array
    velocity: Array
    yaw_rate: Array


class Readings(NamedTuple):
    """What the loop reads: motor angle [rad] and velocity [rad/s], yaw rate [rad/s] (n,), and the
    three newest frames (n, 3, 6): fish x, y, yaw, target x, y, staleness."""

    motor_angle: Array
    motor_velocity: Array
    yaw_rate: Array
    frames: Array


def empty(count: int, steps: int) -> SensorState:
    """Empty sensor state of `count` fish, for episodes of `steps` control steps; call `begin`
    next."""
    return SensorState(
        np.zeros((count, steps, DRAWS), dtype=np.float32),
        np.zeros(count),
        np.zeros(count),
        np.zeros(count),
        np.zeros((count, KEPT, 7)),
        np.zeros(count),
        np.zeros((count, steps), dtype=np.bool_),
    )


def begin(
    model: SensorModel,
    state: SensorState,
    fish: int,
    pose: Array,
    target: Array,
    rng: np.random.Generator,
) -> None:
    """Draw one fish's episode noise, in place; frames before the start show the start."""
    steps = state.noise.shape[1]
    state.noise[fish] = rng.standard_normal((steps, DRAWS), dtype=np.float32)
    bias, drift, phase = rng.normal(), rng.normal(), rng.uniform()
    state.bias[fish] = model.yaw_rate_bias * bias
    state.drift[fish] = model.yaw_rate_drift * drift / steps
    state.phase[fish] = phase / model.frame_rate
    state.late[fish], state.dark[fish] = 0.0, False
    number = np.arange(-KEPT + 1, 1)
    stamp = state.phase[fish] + (number - 1) / model.frame_rate
    rows = np.column_stack([np.tile([*pose, *target], (KEPT, 1)), stamp, stamp])
    state.frames[fish, number % KEPT] = rows


def sense(
    model: SensorModel, state: SensorState, step: NDArray[np.int64], motion: Motion
) -> Readings:
    """Readings at the end of control step `step` (n,), counted from 0; adds to `state.frames`."""
    return Readings(*_sense(figures(model), state, step, motion, PERIOD))


@cache
def figures(model: SensorModel) -> Any:
    """A model's numbers as a named tuple, for compiled code."""
    return Figures(**vars(model))


@njit(cache=True)
def _sense(figures, state, step, motion, period):  # type: ignore[no-untyped-def]
    """For each fish: take the frames of the step, then read encoder and IMU."""
    count = len(step)
    angle, velocity, yaw_rate = np.empty(count), np.empty(count), np.empty(count)
    found = np.empty((count, 3, 6))
    for i in range(count):
        draws = state.noise[i, step[i]]
        _film(figures, state, motion, i, step[i], period)
        age = figures.encoder_age * _uniform(draws[0])
        exact = motion.angle[i] - age * motion.velocity[i]
        angle[i] = _counted(exact, figures.encoder_count)
        velocity[i] = _counted(motion.velocity[i], figures.velocity_count)
        wander = motion.yaw_rate[i] + state.bias[i] + state.drift[i] * step[i]
        yaw_rate[i] = wander + figures.yaw_rate_noise * draws[1]
        if _uniform(draws[2]) < figures.spike_share:
            yaw_rate[i] += figures.spike_size * np.sign(draws[3])
        _newest(state.frames[i], (step[i] + 1) * period, found[i])
    return angle, velocity, yaw_rate, found


@njit(cache=True)
def _film(figures, state, motion, i, step, period):  # type: ignore[no-untyped-def]
    """Take the frames of fish `i` in this step."""
    draws, frames, phase = state.noise[i, step], state.frames[i], state.phase[i]
    before, after, now = motion.before[i], motion.after[i], (step + 1) * period
    was, target = motion.was[i], motion.target[i]
    first = int(np.floor((now - period - phase) * figures.frame_rate + 1e-9)) + 1
    for k in range(PER_STEP):
        number = first + k
        stamp = phase + number / figures.frame_rate
        if stamp > now + 1e-9:
            return
        if state.dark[i, step]:
            continue  # the last frames that arrived are kept, however long it lasts
        own, row = draws[4 + 6 * k :], frames[number % KEPT]
        share = (stamp - now) / period + 1
        for j in range(3):
            spread = figures.position_noise if j < 2 else figures.yaw_noise
            row[j] = before[j] + share * (after[j] - before[j]) + spread * own[j]
        for j in range(2):
            row[3 + j] = was[j] + share * (target[j] - was[j])
        row[5] = stamp + figures.stamp_noise * own[3]
        arrival = stamp + figures.latency + figures.latency_jitter * _uniform(own[4])
        lost = _uniform(own[5]) < figures.dropped
        row[6] = np.inf if lost else arrival + state.late[i]


def newest(state: SensorState, now: Array) -> Array:
    """The three newest frames that have arrived, with their staleness (n, 3, 6)."""
    found = np.empty((len(now), 3, 6))
    _gather(state.frames, now, found)
    return found


def corrected(known: Corrections | None, readings: Readings) -> Readings:
    """Readings as a corrected policy gets them (None: as they are), as in `runner.steer`."""
    if known is None:
        return readings
    return readings._replace(
        motor_angle=readings.motor_angle - known.shaft,
        yaw_rate=readings.yaw_rate - known.yaw_rate,
        frames=corrected_frames(known, readings.frames),
    )


def camera_yaw_rate(state: SensorState, now: Array) -> Array:
    """Yaw rates (n,) [rad/s] from the frames that have arrived at `now` (n,) [s]."""
    found = np.empty((len(now), camera_yaw.FRAMES, 6))
    _gather(state.frames, now, found)
    return camera_yaw.yaw_rate(found[..., 2], found[..., 5])


@njit(cache=True)
def _gather(frames, now, found):  # type: ignore[no-untyped-def]
    for fish in range(len(now)):
        _newest(frames[fish], now[fish], found[fish])


@njit(cache=True)
def _newest(frames, now, found):  # type: ignore[no-untyped-def]
    """Fill `found` (k, 6) with the newest frames; the oldest one is repeated if there are fewer."""
    last = np.inf
    for k in range(len(found)):
        best = -1
        for j in range(KEPT):
            late = frames[j, 6] > now + 1e-9 or frames[j, 5] >= last
            if not late and (best < 0 or frames[j, 5] > frames[best, 5]):
                best = j
        if best < 0 < k:
            found[k] = found[k - 1]
            continue
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
