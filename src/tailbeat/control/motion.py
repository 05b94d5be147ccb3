"""How target and fish move in the pool: two constant-velocity Kalman filters of camera frames.

Three frames span 33 ms, in which a target at 0.1 m/s moves as far as the camera errs. So a policy
that follows also observes filtered velocities. The filters take the newest frame of every control
step with its own time, so they allow for latency, dropped frames and late steps. They are linear:
a target path that is turned and moved gives velocities that are turned.

Model (Bar-Shalom et al., Estimation with Applications to Tracking and Navigation, 2001, section
6.2.2): a velocity that wanders as white noise of acceleration. Both axes have the same variances.
Needs only numpy; training and robot run this code.
"""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tailbeat.control.measure import Measure

Array = NDArray[np.float64]
SAME = 1e-3  # s: a frame that is no newer than this is the one before
FISH, TARGET = 0, 1  # rows of `MotionState`
OBSERVED = 4


@dataclass(frozen=True)
class MotionFilter:
    """Constants of the filters. They are in the policy's contract."""

    noise: float
    """Error of a position in a frame, per axis [m rms]: the camera's (`env.sensors`)."""
    fish: float = 0.1
    """Spectral density of the fish's acceleration [m2/s3] (chosen): it smooths over 0.1 s."""
    target: float = 0.01
    """Spectral density of the target's acceleration [m2/s3] (chosen): it smooths over 0.2 s."""
    speed: float = 0.3
    """Speed that a target or fish may have when it is first seen [m/s rms] (chosen)."""
    jump: float = 0.3
    """A target that is farther than this from where it was expected is a new one [m] (chosen)."""


def sized(paper: MotionFilter, measure: Measure) -> MotionFilter:
    """Constants of the paper's fish in another fish's measure. The camera's error stays."""
    wander = measure.speed**2 / measure.time
    return replace(
        paper,
        fish=paper.fish * wander,
        target=paper.target * wander,
        speed=paper.speed * measure.speed,
        jump=paper.jump * measure.reach,
    )


class MotionState(NamedTuple):
    """What the filters know about n fish and targets, rows `FISH` and `TARGET`: `place` and
    `velocity` (n, 2, 2) in the pool [m, m/s]; `doubt` (n, 2, 3): variances of place, of both, and
    of velocity; `age` (n,) [s] of the last used frame."""

    place: Array
    velocity: Array
    doubt: Array
    age: Array


def begin(constants: MotionFilter, frames: Array) -> MotionState:
    """The state after first frames (n, 3, 6), see `observation.Samples`: nothing moves."""
    place = frames[:, 0, [0, 1, 3, 4]].reshape(-1, 2, 2)
    doubt = np.tile([constants.noise**2, 0.0, constants.speed**2], (len(frames), 2, 1))
    return MotionState(place, np.zeros_like(place), doubt, frames[:, 0, 5].copy())


def update(
    constants: MotionFilter, state: MotionState, frames: Array, elapsed: float
) -> MotionState:
    """The state after the frames (n, 3, 6) of the next decision, `elapsed` [s] after the last."""
    age = state.age + elapsed
    passed = age - frames[:, 0, 5]
    fresh = passed > SAME
    after = _corrected(
        constants, _predicted(constants, state, np.where(fresh, passed, 0.0)), frames
    )
    new = fresh[:, None, None]
    return MotionState(
        np.where(new, after.place, state.place),
        np.where(new, after.velocity, state.velocity),
        np.where(new, after.doubt, state.doubt),
        np.where(fresh, after.age, age),
    )


def _predicted(constants: MotionFilter, state: MotionState, passed: Array) -> MotionState:
    """The state `passed` (n,) [s] later."""
    step = passed[:, None]
    place, both, speed = np.moveaxis(state.doubt, -1, 0)
    wander = np.array([constants.fish, constants.target])
    doubt = np.stack(
        [
            place + step * (2 * both + step * speed) + wander * step**3 / 3,
            both + step * speed + wander * step**2 / 2,
            speed + wander * step,
        ],
        axis=-1,
    )
    return state._replace(place=state.place + step[..., None] * state.velocity, doubt=doubt)


def _corrected(constants: MotionFilter, state: MotionState, frames: Array) -> MotionState:
    """The state after the newest frames. A target that jumped begins anew."""
    first, doubt = begin(constants, frames), state.doubt
    missed = first.place - state.place
    gain = doubt[..., :2] / (doubt[..., :1] + constants.noise**2)  # of place and velocity
    place, both = np.moveaxis((1 - gain[..., :1]) * doubt[..., :2], -1, 0)
    left = np.stack([place, both, doubt[..., 2] - gain[..., 1] * doubt[..., 1]], axis=-1)
    new = np.zeros((len(frames), 2, 1), bool)
    new[:, TARGET, 0] = np.hypot(*missed[:, TARGET].T) > constants.jump
    return MotionState(
        np.where(new, first.place, state.place + gain[..., :1] * missed),
        np.where(new, 0.0, state.velocity + gain[..., 1:] * missed),
        np.where(new, first.doubt, left),
        first.age,
    )


def observed(state: MotionState, yaw: Array) -> Array:
    """Velocities (n, 4) [m/s] seen from fish of heading `yaw` (n,) [rad]: the target's ahead and to
    the left, the fish's own ahead and to the left."""
    seen = ahead_and_left(state.velocity, yaw[:, None])
    return np.asarray(seen[:, [TARGET, FISH]].reshape(-1, OBSERVED))


def ahead_and_left(vectors: NDArray[Any], yaw: NDArray[Any]) -> NDArray[Any]:
    """Vectors (…, 2) of the pool, seen from fish of heading `yaw` (…,) [rad]."""
    x, y, cos, sin = vectors[..., 0], vectors[..., 1], np.cos(yaw), np.sin(yaw)
    return np.stack([cos * x + sin * y, cos * y - sin * x], axis=-1)
