"""What a logged swim tells in columns: the linear fits from which `offsets` reads a robot's errors.

Each function gives the columns and the sum that they add up to, on the grid of `STEP`, without the
first and last `edge` samples. `slow`, `noise` and `beat` are widths of averages in samples.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
STEP = 0.02  # s, of the grid that swims are put on
FOLLOWED = 0.1  # rad that a servo which follows may differ from its linear law, chosen
ROUNDS = 6  # in which samples at the servo's limit are left out


@dataclass(frozen=True, eq=False)
class Logged:
    """A swim of k samples as a robot logged it.

    `time` [s] of the samples and `pose_time` of the newest pose at each; `pose` (k, 3): x, y [m]
    and heading [rad] in the pool; `yaw_rate` [rad/s] of the gyro; `angle` [rad] and `speed` [rad/s]
    of the shaft, as it counts them, and its `command` [rad].
    """

    time: Array
    pose_time: Array
    pose: Array
    yaw_rate: Array
    angle: Array
    speed: Array
    command: Array


def smooth(values: Array, width: int) -> Array:
    """Mean over a Hann window of so many samples."""
    window = np.hanning(width + 2)[1:-1]
    return np.convolve(values, window / window.sum(), mode="same")


def _motion(piece: Logged, width: int) -> tuple[Array, Array, Array]:
    """Speeds forward and left in the tag's own frame, and turning, after noise is averaged over
    `width` samples."""
    x, y, yaw = (smooth(c, width) for c in piece.pose.T)
    vx, vy, turning = (np.gradient(c, STEP) for c in (x, y, yaw))
    cos, sin = np.cos(yaw), np.sin(yaw)
    return cos * vx + sin * vy, cos * vy - sin * vx, turning


Columns = tuple[list[Array], Array]


def _lateral(one: Logged, slow: int, noise: int, beat: int, edge: int) -> Columns:
    """Sideways speed over a beat: of the tag's angle, of turning, of the current."""
    ahead, left, turning = averaged(one, slow)
    cos, sin = (smooth(f(one.pose[:, 2]), slow) for f in (np.cos, np.sin))
    columns = [ahead, turning, turning * np.abs(turning), turning * ahead, -sin, cos]
    return [c[edge:-edge] for c in columns], left[edge:-edge]


def _ahead(one: Logged, slow: int, noise: int, beat: int, edge: int) -> Columns:
    """Forward speed over a beat: of how fast the shaft beats, and of the current."""
    cos, sin = (smooth(f(one.pose[:, 2]), slow) for f in (np.cos, np.sin))
    columns = [beating(one, slow), cos, sin]
    return [c[edge:-edge] for c in columns], averaged(one, slow)[0][edge:-edge]


def averaged(one: Logged, slow: int) -> tuple[Array, Array, Array]:
    """Speeds in the tag's own frame and turning, over a beat."""
    yaw = one.pose[:, 2]
    vx, vy = (np.gradient(c, STEP) for c in one.pose[:, :2].T)
    ahead, left = np.cos(yaw) * vx + np.sin(yaw) * vy, np.cos(yaw) * vy - np.sin(yaw) * vx
    return smooth(ahead, slow), smooth(left, slow), np.gradient(smooth(yaw, slow), STEP)


def _within(one: Logged, slow: int, noise: int, beat: int, edge: int) -> Columns:
    """Speeds forward and sideways within a beat, two right sides: of a tag beside the midline, of a
    turn. Of the sideways speed, a turned tag shows a part ahead."""
    ahead, left, turning = _motion(one, noise)
    over = [smooth(c, beat) for c in (ahead, left, turning)]
    ahead, left, turning = ahead - over[0], left - over[1], turning - over[2]
    columns = [turning, turning * over[2], left * over[2]]
    return [c[edge:-edge] for c in columns], np.column_stack([ahead, left])[edge:-edge]


def beating(one: Logged, slow: int) -> Array:
    """Rms speed of the shaft over a beat."""
    return np.sqrt(np.maximum(smooth(one.speed**2, slow), 0.0))


def _shaft(one: Logged, slow: int, noise: int, beat: int, edge: int) -> Columns:
    """Turning over a beat: of the shaft's mean angle, less than in proportion where it is large,
    and the more the faster the shaft beats."""
    mean, fast = smooth(one.angle, slow), beating(one, slow)
    turning = np.gradient(smooth(one.pose[:, 2], slow), STEP)
    far = mean * np.abs(mean)
    columns = [mean, mean * fast, np.ones_like(mean), fast, far, far * fast]
    return [c[edge:-edge] for c in columns], turning[edge:-edge]


def _setpoint(one: Logged, slow: int, noise: int, beat: int, edge: int) -> Columns:
    """Command within a beat: of the shaft's angle, speed and acceleration, where the servo follows.
    The command's mean over a beat would not do: a servo at its limit cuts the two halves of a beat
    unequally, and a policy need not beat evenly."""
    pull = np.gradient(smooth(one.speed, 3), STEP)
    columns = np.column_stack([np.ones_like(pull), one.angle, one.speed, pull])[edge:-edge]
    command = one.command[edge:-edge]
    near = np.ones(len(command), bool)
    for _ in range(ROUNDS):
        fit = np.linalg.lstsq(columns[near], command[near], rcond=None)[0]
        near = np.abs(command - columns @ fit) < FOLLOWED
    return list((columns * near[:, None]).T), command * near


def _gyro(one: Logged, slow: int, noise: int, beat: int, edge: int) -> Columns:
    """Gyro minus the camera's turning, over time from 30 s on: so the first is its mean."""
    turning = np.gradient(smooth(one.pose[:, 2], slow), STEP)
    off = smooth(one.yaw_rate, slow) - turning
    columns = [np.ones_like(off), one.time - 30.0]
    return [c[edge:-edge] for c in columns], off[edge:-edge]


MADE = (_lateral, _ahead, _within, _shaft, _setpoint, _gyro)
