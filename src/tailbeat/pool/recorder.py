"""The lab's recorder: counts, noise, latency, dropped frames, uneven sample times.

Every number is chosen, rounded up from data sheets and published measurements. Only recordings with
this noise leave the room.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tailbeat.env.sensors import SensorModel

Array = NDArray[np.float64]
COUNT = SensorModel().encoder_count  # rad


CELLS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)  # N m, ranges that are sold
CELL_NOISE, CELL_COUNT = 1e-3, 5e-4  # of the range, chosen


@dataclass(frozen=True)
class Sensors:
    """Standard deviations and rates of a bench and a pool."""

    torque_noise: float = 0.01  # N m, of a 10 N m cell; see `torque_cell_for`
    torque_count: float = 0.005  # N m
    bench_rate: float = 200.0  # Hz, angle and torque sampled together
    loop_rate: float = 100.0  # Hz, of a loop that writes the goal and reads the encoder
    jitter: float = 0.1  # of a period, uniform
    frame_rate: float = SensorModel().frame_rate  # Hz, of the camera
    position_noise: float = 0.0015  # m: tag corners at 3 m, 0.1-0.5 px, with some refraction left
    yaw_noise: float = 0.004  # rad: 0.2 degrees, for a tag with modules of 4 px
    stamp_noise: float = 0.001  # s, error of a frame's time without its latency
    dropped: float = 0.02  # fraction of frames without a tag


def clock(seconds: float, rate: float, jitter: float, rng: np.random.Generator) -> Array:
    """Uneven sample times from 0 [s]."""
    count = int(seconds * rate)
    time = (np.arange(count) + jitter * rng.uniform(-1, 1, count)) / rate
    return np.asarray(time - time[0])


def encoder(angle: Array) -> Array:
    """Round an angle to encoder counts [rad]."""
    return np.asarray(np.round(angle / COUNT) * COUNT)


def torque_cell_for(torque: float, sensors: Sensors) -> Sensors:
    """Sensors with the smallest common torque cell whose range is five times a `torque` [N m]."""
    suited = next((size for size in CELLS if size >= 5 * torque), CELLS[-1])
    return replace(sensors, torque_noise=CELL_NOISE * suited, torque_count=CELL_COUNT * suited)


def torque_cell(torque: Array, sensors: Sensors, rng: np.random.Generator) -> Array:
    """Add noise to a torque and round it to counts [N m]."""
    noisy = torque + sensors.torque_noise * rng.normal(size=torque.shape)
    return np.asarray(np.round(noisy / sensors.torque_count) * sensors.torque_count)


def frames(seconds: float, sensors: Sensors, rng: np.random.Generator) -> Array:
    """Times of the frames in which the tag was found [s]; always the first."""
    time = np.arange(0, seconds, 1 / sensors.frame_rate)
    seen = rng.uniform(size=time.size) >= sensors.dropped
    seen[0] = True
    return time[seen]


def camera(pose: Array, sensors: Sensors, rng: np.random.Generator) -> Array:
    """Add noise to poses (k, 3): x, y [m], yaw [rad]."""
    scale = np.array([sensors.position_noise, sensors.position_noise, sensors.yaw_noise])
    return np.asarray(pose + scale * rng.normal(size=pose.shape))
