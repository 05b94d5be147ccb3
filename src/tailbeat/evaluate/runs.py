"""Results of a trial: n swims as arrays, and numbers computed from them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tailbeat.control.actions import PERIOD
from tailbeat.control.measure import NEAR
from tailbeat.control.observation import bearing
from tailbeat.recording import Recording

Single = NDArray[np.float32]
Flags = NDArray[np.bool_]
SHOWN = 8  # fish per chunk whose shape is stored


@dataclass(frozen=True, eq=False)
class Runs:
    """n swims of up to k control steps; after a swim's end everything is NaN.

    `pose` (n, k + 1, 3) of the tag [m, m, rad]; `target` (n, k + 1, 2) [m]; `motor` (n, k + 1)
    angle and `setpoint` (n, k) [rad]; `steps` swum, `reached`, `lost` (diverged, or out of range)
    (n,); `energy` (n,) [J] from the actuator, NaN in a twin; `shape` (m, k + 1, nv) generalised
    coordinates of the first m fish; `water` (n,) index of the pool; the fish's `size` and `reach`
    (n,) over the paper's fish (`control.measure`).
    """

    pose: Single
    target: Single
    motor: Single
    setpoint: Single
    steps: NDArray[np.int64]
    reached: Flags
    lost: Flags
    energy: Single
    shape: Single
    water: NDArray[np.int64]
    size: Single
    reach: Single

    @property
    def count(self) -> int:
        """Number of swims."""
        return len(self.steps)

    @property
    def distance(self) -> Single:
        """Distance to the target at each time (n, k + 1) [m]."""
        apart = self.target - self.pose[..., :2]
        return np.asarray(np.hypot(apart[..., 0], apart[..., 1]))

    @property
    def nearest(self) -> Single:
        """Closest approach (n,) [m]."""
        return np.asarray(np.nanmin(self.distance, axis=1))

    @property
    def near(self) -> Flags:
        """Which swims came within the wider circle about their target (n,)."""
        return np.asarray(self.nearest < NEAR * self.size)

    @property
    def seconds(self) -> NDArray[np.float64]:
        """Duration of each swim (n,) [s]."""
        return np.asarray(PERIOD * self.steps, dtype=np.float64)

    @property
    def bearing(self) -> Single:
        """Bearing of the target at the start, from straight ahead (n,) [rad], in -pi to pi."""
        return np.asarray(bearing(self.pose[:, 0], self.target[:, 0]))

    def part(self, own: slice) -> "Runs":
        """Some of the swims, without their shapes."""
        values = {name: one[own] for name, one in vars(self).items() if name != "shape"}
        return Runs(**values, shape=self.shape[:0])


def surge(runs: Runs, seconds: float = 0.5) -> Single:
    """Speed along the heading (n, k) [m/s], averaged over so many seconds."""
    width = max(round(seconds / PERIOD), 1)
    step = np.diff(runs.pose[..., :2], axis=1) / PERIOD
    heading = runs.pose[:, :-1, 2]
    ahead = step[..., 0] * np.cos(heading) + step[..., 1] * np.sin(heading)
    kernel = np.ones(width) / width
    smooth = [np.convolve(row, kernel, mode="same") for row in ahead]
    return np.asarray(smooth, dtype=np.float32)


def as_recordings(runs: Runs, name: str, shortest: float = 1.0) -> list[Recording]:
    """The swims of `shortest` seconds or more as recordings: motor angle and pose of the tag."""
    return [
        _recording(runs, int(swim), f"{name} swim {swim + 1}")
        for swim in np.flatnonzero(runs.seconds >= shortest - 1e-9)
    ]


def _recording(runs: Runs, swim: int, name: str) -> Recording:
    numbers = np.column_stack([runs.motor[swim], runs.pose[swim]]).astype(np.float64)
    numbers = numbers[: runs.steps[swim] + 1]
    finite = np.isfinite(numbers).all(axis=1)  # a lost swim may end with NaN
    names = ("motor_angle_rad", "x_m", "y_m", "yaw_rad")
    columns = dict(zip(names, numbers[finite].T, strict=True))
    return Recording(name, np.flatnonzero(finite).astype(np.float64) * PERIOD, columns)
