"""What a messy lab gets wrong, for the emulated devices: the same errors as in the trials.

A station sends poses with all errors of the camera. A picture shows only what is wrong in the pool,
where the tag is glued; scale, rotation and lens are errors of the calibration that reads it
(`lab.py`).
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tailbeat.control.actions import PERIOD
from tailbeat.control.measure import PATIENCE
from tailbeat.env import errors
from tailbeat.pool.mess import AS_DESCRIBED, Lab

Array = NDArray[np.float64]
LONG = 600.0  # s after which the bursts of lost frames repeat


@dataclass(eq=False)
class Mistakes:
    """A lab's errors over time [s] since the devices started; the bursts come from `seed`."""

    lab: Lab = AS_DESCRIBED
    seed: int = 0
    dark: NDArray[np.bool_] = field(init=False)
    row: NDArray[np.void] = field(init=False)
    glued: NDArray[np.void] = field(init=False)

    def __post_init__(self) -> None:
        wrong, steps = self.lab.errors, round(LONG / PERIOD)
        rng = np.random.default_rng([self.seed, 77])
        self.dark = errors.dark_steps(wrong.dark, steps, rng) if wrong.dark else np.zeros(1, bool)
        self.row = errors.rows([wrong])
        self.glued = errors.rows([errors.true_frame(wrong)])

    def filmed(self, pose: Array) -> Array:
        """The pose (3,) that a camera finds, from the true pose of the described tag."""
        return errors.filmed(self.row, pose[None])[0]

    def tag(self, pose: Array) -> Array:
        """The pose (3,) in the pool of the tag as it is glued, from that of the described tag."""
        return errors.filmed(self.glued, pose[None])[0]

    def seen(self, place: tuple[float, float]) -> tuple[float, float]:
        """The position that a camera finds, from the true one [m]."""
        x, y = errors.seen(self.row, np.array([place]))[0].tolist()
        return x, y

    def hidden(self, seconds: float) -> bool:
        """Whether the camera loses its frames."""
        return bool(self.dark[int(seconds / PERIOD) % len(self.dark)])

    def gyro(self, seconds: float) -> tuple[float, float]:
        """Errors of heading [rad] and yaw rate [rad/s]; the drift ends after one target's time."""
        wrong, warm = self.lab.errors, min(seconds, PATIENCE)
        grown = wrong.yaw_rate_drift / PATIENCE
        heading = wrong.yaw_rate_bias * seconds + grown * warm * (seconds - warm / 2)
        return heading, wrong.yaw_rate_bias + grown * warm
