"""Do the robot's own signals agree with each other? Statistics of its last seconds.

Each is a pure function of a window, an array (k, 13) with one row for each control period and the
columns `COLUMNS`. `control.expected` has the models and the bounds, which come from a policy's own
simulated swims. Needs only numpy, for training and robot alike.
"""

import math
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.control.expected import Expected

Array = NDArray[np.float64]
# Time [s]; motor angle [rad], the angle that the shaft's model has for the same setpoints; yaw rate
# of the IMU [rad/s] and its integral [rad]; capture time [s] of the newest camera frame, its x, y
# [m] and yaw [rad], continued over a turn; target x, y [m]; the setpoint [rad]; the servo's current
# [A], NaN if it measures none.
COLUMNS = (
    "time", "angle", "modelled", "rate", "turned", "stamp", "x", "y", "yaw", "target_x", "target_y",
    "sent", "current",
)  # fmt: skip
TIME, ANGLE, MODELLED, RATE, TURNED, STAMP, X, Y, YAW, TARGET = range(10)
SENT, CURRENT = 11, 12
SPAN = 2.0  # s of most statistics
SHORT = 1.0  # s of the stroke, which varies little, and of the target's wandering
NEWEST, LONGEST = 2.5, 20.0  # s: the camera's drift in the newest, compared with all before
EARLIER = 5.0  # s that the earlier part must last
FOLLOWED = 0.1  # of the stroke; less before says nothing (chosen)
END = 0.2  # s over which a place is averaged at both ends of a window
FEWEST = 10  # frames for a slope
STRAIGHT = 1.0  # s over which a course is compared with the heading: several beats
LEAST_SPEED = 0.15  # m/s of the paper's fish, below which its sideslip is no small angle


@dataclass(frozen=True)
class Signs:
    """Statistics of a window; NaN where there is nothing to compare.

    `turning` [rad/s]: the camera's turning minus the IMU's. `drifting` [rad/s]: the same in the
    newest 2.5 s, minus its value before, without the camera's lag. `stroke`: motor angle over the
    modelled one; `weakening`: the same in the newest 2 s, over its value before. `recoil`: yaw rate
    over the one that the motor angle predicts. `progress` [m]: speed over the rms of the motor
    velocity. `same`: newest camera frames in a row with equal poses. `wander` [m]: the target's
    path within a second, without its displacement. `course` [rad]: the direction in which the tag
    moves, seen from its heading, positive to the left; NaN while the fish is slow.
    """

    turning: float = float("nan")
    drifting: float = float("nan")
    stroke: float = float("nan")
    weakening: float = float("nan")
    recoil: float = float("nan")
    progress: float = float("nan")
    same: float = float("nan")
    wander: float = float("nan")
    course: float = float("nan")


def signs(window: Array, expected: Expected) -> Signs:
    """All statistics of a window (k, 13) of the paper's fish or one of its measure, oldest row
    first; NaN where it is too short."""
    if len(window) < 2 or window[-1, TIME] - window[0, TIME] < SPAN:
        return Signs()
    return Signs(**{one.name: sign(one.name, window, expected) for one in fields(Signs)})


def sign(name: str, window: Array, expected: Expected, least_speed: float = LEAST_SPEED) -> float:
    """One statistic of a window, by its name in `Signs`. `least_speed` [m/s]: of a course."""
    if name == "drifting":
        return drifting(window)
    if name == "weakening":
        return weakening(window, expected)
    recent = since(window, SHORT if name in ("stroke", "wander") else SPAN)
    match name:
        case "turning":
            return turning(recent)
        case "stroke":
            return stroke(recent, expected)
        case "recoil":
            return recoil(recent, expected)
        case "progress":
            return progress(recent, distinct(recent), expected)
        case "course":
            return course(distinct(since(window, STRAIGHT)), least_speed)
        case "same":
            return float(same_poses(distinct(recent)))
    return wander(distinct(recent))


def turning(window: Array) -> float:
    """The camera's turning minus the IMU's [rad/s]: the slope of the yaw minus the integrated yaw
    rate. NaN with fewer than ten frames."""
    frames = distinct(window)
    if len(frames) < FEWEST:
        return float("nan")
    stamp, apart = _apart(frames, window)
    return slope(stamp, apart)


def drifting(window: Array) -> float:
    """`turning` in the newest 2.5 s, minus the same before, which leaves a steady bias of the IMU
    out. NaN until 5 s came before, or with fewer than ten frames in either part.

    A camera that is later than its stamps say differs from the IMU by its lag times the yaw rate.
    One lag of the whole window is fitted with the two lines, and left out.
    """
    begin = window[-1, TIME] - NEWEST
    if begin - window[0, TIME] < EARLIER:
        return float("nan")
    stamp, apart = _apart(distinct(window), window)
    new = stamp > begin
    if min(new.sum(), (~new).sum()) < FEWEST:
        return float("nan")
    at, rate = stamp - begin, np.interp(stamp, window[:, TIME], window[:, RATE])
    model = np.column_stack([new, ~new, new * at, ~new * at, rate])
    fitted = np.linalg.lstsq(model, apart, rcond=None)[0]
    return float(fitted[2] - fitted[3])


def _apart(frames: Array, window: Array) -> tuple[Array, Array]:
    """Capture times [s] of the frames that were taken within the window, and their yaw minus the
    integrated yaw rate then [rad]."""
    inside = frames[frames[:, STAMP] >= window[0, TIME]]
    turned = np.interp(inside[:, STAMP], window[:, TIME], window[:, TURNED])
    return inside[:, STAMP], inside[:, YAW] - turned


def stroke(window: Array, expected: Expected) -> float:
    """Gain of the motor angle over the modelled one; NaN while the tail does not beat."""
    return gain(window[:, ANGLE], window[:, MODELLED], expected.least_angle)


def weakening(window: Array, expected: Expected) -> float:
    """`stroke` in the newest 2 s, over the same before, which leaves a weak servo out. NaN until
    2 s came before, while the tail does not beat, or if the shaft did not follow before."""
    begin = window[-1, TIME] - SPAN
    if begin - window[0, TIME] < SPAN:
        return float("nan")
    new = window[:, TIME] > begin
    before = stroke(window[~new], expected)
    return stroke(window[new], expected) / before if before > FOLLOWED else float("nan")


def recoil(window: Array, expected: Expected) -> float:
    """Gain of the yaw rate over the one that the motor angle predicts: a body that does not answer
    its tail has a small one. NaN while the tail does not beat."""
    taps = len(expected.recoil)
    if len(window) <= taps:
        return float("nan")
    wanted = predicted(window[:, ANGLE], expected)
    return gain(window[taps - 1 :, RATE], wanted, expected.least_rate)


def predicted(angle: Array, expected: Expected) -> Array:
    """The yaw rate [rad/s] that motor angles (k,) [rad] predict, from the last tap on."""
    return np.convolve(angle, np.array(expected.recoil), mode="valid")


def progress(window: Array, frames: Array, expected: Expected) -> float:
    """Speed [m/s] of the tag between both ends of a window, over the rms of the motor velocity
    [rad/s]; NaN while the tail does not beat, or without frames at both ends."""
    steps = np.diff(window[:, TIME])
    beat = float(np.std(np.diff(window[:, ANGLE]) / steps))
    if np.std(window[:, ANGLE]) < expected.least_angle or len(frames) < FEWEST:
        return float("nan")
    seconds, (x, y) = moved(frames)
    return math.hypot(x, y) / seconds / beat if seconds > SPAN / 2 else float("nan")


def course(frames: Array, least_speed: float) -> float:
    """Direction [rad] in which the tag moves, minus its mean heading. A beating fish slips to the
    side by less than a right angle, and in a picture mirrored at the x axis course and heading
    differ by twice the heading. NaN below `least_speed` [m/s]."""
    if len(frames) < FEWEST:
        return float("nan")
    seconds, (x, y) = moved(frames)
    if seconds < STRAIGHT / 2 or math.hypot(x, y) < least_speed * seconds:
        return float("nan")
    return math.remainder(math.atan2(y, x) - float(frames[:, YAW].mean()), math.tau)


def moved(frames: Array) -> tuple[float, tuple[float, float]]:
    """Time [s] between the mean frames of both ends, and how far the tag moved between them [m]."""
    stamp = frames[:, STAMP]
    first, last = frames[stamp <= stamp[0] + END], frames[stamp >= stamp[-1] - END]
    seconds, x, y = last[:, STAMP : Y + 1].mean(axis=0) - first[:, STAMP : Y + 1].mean(axis=0)
    return float(seconds), (float(x), float(y))


def same_poses(frames: Array) -> int:
    """How many of the newest frames have the same pose, to the last bit; 0 without frames."""
    if not len(frames):
        return 0
    differs = np.flatnonzero((frames[:, X : YAW + 1] != frames[-1, X : YAW + 1]).any(axis=1))
    return len(frames) - 1 - int(differs[-1]) if differs.size else len(frames)


def wander(frames: Array) -> float:
    """Path of the target [m] without its displacement: near 0 for a target that rests, is dragged
    or swims."""
    places = frames[:, TARGET : TARGET + 2]
    if len(places) < 2:
        return 0.0
    path = np.hypot(*np.diff(places, axis=0).T).sum()
    return float(path - np.hypot(*(places[-1] - places[0])))


# ---- parts --------------------------------------------------------------------------------------


def gain(seen: Array, wanted: Array, least: float) -> float:
    """Least-squares factor of a prediction (k,) that gives what was seen, both without their
    lines; NaN where the prediction's rms is below `least`."""
    a, b = straightened(seen), straightened(wanted)
    power = float((b * b).sum())
    return float((a * b).sum()) / power if power > len(b) * least * least else float("nan")


def straightened(values: Array) -> Array:
    """Values (k,) without their least-squares line."""
    at = np.arange(len(values)) - (len(values) - 1) / 2
    flat = values - values.mean()
    return np.asarray(flat - at * ((at * flat).sum() / np.square(at).sum()))


def since(window: Array, span: float) -> Array:
    """The rows of the last `span` [s]."""
    return window[window[:, TIME] > window[-1, TIME] - span] if len(window) else window


def distinct(window: Array) -> Array:
    """One row for each camera frame, oldest first."""
    known = window[np.isfinite(window[:, STAMP])]
    fresh = np.ones(len(known), bool)
    fresh[1:] = np.diff(known[:, STAMP]) > 0
    return known[fresh]


def slope(x: Any, y: Any) -> float:
    """Slope of the least-squares line; NaN without two points."""
    if len(x) < 2:
        return float("nan")
    centred = x - x.mean()
    return float((centred * (y - y.mean())).sum() / np.square(centred).sum())
