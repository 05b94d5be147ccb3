"""The yaw rate from the camera's headings, for a robot without an IMU.

The rate is the slope of a straight line through the headings of the last frames. Training and robot
use the same function. Needs only numpy.
"""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tailbeat.control.observation import wrapped

Array = NDArray[np.float64]
Source = Literal["imu", "camera"]  # where a policy's yaw rate comes from
SOURCES: tuple[Source, ...] = ("imu", "camera")
SPAN = 0.09  # s of frames before the newest one that count (chosen: a third of a beat)
FRAMES = 6  # frames at most: those of `SPAN` at 60 frames a second
LEAST = 1e-4  # s^2, spread of the times below which there is no slope


def yaw_rate(yaw: Array, staleness: Array) -> Array:
    """Yaw rates (n,) [rad/s] from the headings `yaw` (n, k) [rad] of the newest frames and their
    `staleness` (n, k) [s], newest first; 0 where the frames are too few for a slope.

    With six frames, 60 a second, noise of 0.01 rad in each heading gives 0.14 rad/s rms. The rate
    is that of the middle of the frames: 42 ms before the newest frame was taken, which itself is
    30 to 60 ms old. The delay is a third of a beat of 4 Hz, so within a beat it is no
    measurement of the present rate.
    """
    time = staleness[:, :1] - staleness  # s after the newest frame: 0 or below
    counts = time >= -SPAN
    turned = np.where(counts, wrapped(yaw - yaw[:, :1]), 0.0)
    time = np.where(counts, time, 0.0)
    number = counts.sum(axis=1)
    middle, mean = time.sum(axis=1) / number, turned.sum(axis=1) / number
    apart = np.where(counts, time - middle[:, None], 0.0)
    spread = (apart * apart).sum(axis=1)
    slope = (apart * (turned - mean[:, None])).sum(axis=1)
    known = spread > LEAST
    return np.asarray(np.where(known, slope / np.where(known, spread, 1.0), 0.0))
