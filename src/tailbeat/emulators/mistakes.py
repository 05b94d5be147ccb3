"""What a messy lab gets wrong, for the emulated devices: the same errors as in the trials.

A station sends poses with all errors of the camera. A picture shows only what is wrong in the pool,
where the tag is glued; scale, rotation and lens are errors of the calibration that reads it.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from tailbeat.control.actions import PERIOD
from tailbeat.control.measure import PATIENCE
from tailbeat.env import errors
from tailbeat.env.errors import Errors
from tailbeat.pool.mess import AS_DESCRIBED, Lab
from tailbeat.vision.calibration import Calibration

Array = NDArray[np.float64]
WIDE = 1.1  # tangent of the widest ray: more than to a corner of the pool from 3.2 m (0.96)
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
        self.glued = errors.rows([replace(wrong, scale=0.0, turn=0.0, lens=0.0)])

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


def miscalibrated(made: Calibration, wrong: Errors) -> Calibration:
    """A calibration by which true pictures are read with the errors `scale`, `turn` and `lens`.

    The camera's place and turn carry scale and rotation exactly, but for a tag's depth, which stays
    (1 mm at 3 cm). The lens's radial terms carry `lens`, about the camera's axis.
    """
    cos, sin = np.cos(wrong.turn), np.sin(wrong.turn)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    hung = replace(
        made.hung,
        rotation=made.hung.rotation @ turn.T,
        position=(1 + wrong.scale) * turn @ made.hung.position,
    )
    if not wrong.lens:
        return replace(made, hung=hung)
    distortion = _bent(made.lens.distortion, wrong.lens * made.hung.position[2] ** 2)
    return replace(made, lens=replace(made.lens, distortion=distortion), hung=hung)


def _bent(distortion: Array, more: float) -> Array:
    """Distortion (5,) by which a ray at `ray` from the axis is read at ray + `more` ray^3."""
    ray = np.linspace(0.05, WIDE, 50)
    powers = np.array([2, 4, 6])
    pixel = ray * (1 + (ray[:, None] ** powers) @ distortion[[0, 1, 4]])
    read = ray + more * ray**3
    terms = np.linalg.lstsq(read[:, None] ** (1 + powers), pixel - read, rcond=None)[0]
    return np.array([*terms[:2], *distortion[2:4], terms[2]])
