"""How an IMU is mounted in the fish: any rotation, as the fish's file gives it.

The fish's axes are x ahead, y left, z up. A rotation is kept as two directions in the sensor's own
axes, ahead and up, which are all that a yaw rate needs.
"""

import math
from dataclasses import dataclass

from tailbeat.fish.description import Hardware

Vector = tuple[float, float, float]
AXES = "xyz"
AXIS_VECTORS: dict[str, Vector] = {
    sign + name: (value * (name == "x"), value * (name == "y"), value * (name == "z"))
    for sign, value in (("", 1.0), ("-", -1.0))
    for name in AXES
}
NEAR = 0.8  # cosine to an axis (37 degrees) within which a direction has its name (chosen)
TILTED, WRONG = math.radians(37), math.radians(60)  # of gravity from the file's up (chosen)


@dataclass(frozen=True)
class Mounting:
    """Unit vectors in the sensor's axes: `up` points up, `ahead` to the fish's nose. Without a
    rotation in the file, `ahead` is any direction at right angles to `up`."""

    up: Vector = AXIS_VECTORS["z"]
    ahead: Vector = AXIS_VECTORS["x"]

    def __str__(self) -> str:
        return named(self.up, 1 - 1e-9)

    def rate(self, rates: Vector) -> float:
        """The yaw rate in rates about the sensor's axes, counter-clockwise from above."""
        return _dot(self.up, rates)

    def heading(self, yaw: float, pitch: float, roll: float) -> float:
        """The fish's heading [rad], without a fixed zero, from the sensor's angles [rad], which
        turn it from the world's axes in this order. Any rotation of a level fish will do: where
        the sensor's yaw and roll are not defined by themselves, their sum or difference is."""
        x, y, z = self.ahead
        y, z = y * math.cos(roll) - z * math.sin(roll), y * math.sin(roll) + z * math.cos(roll)
        x = x * math.cos(pitch) + z * math.sin(pitch)
        return yaw + math.atan2(y, x)

    def off(self, gravity: Vector) -> float:
        """Angle [rad] between `up` and the direction that gravity shows to be up."""
        return math.acos(min(max(_dot(self.up, gravity), -1.0), 1.0))


def mounting_of(hardware: Hardware) -> Mounting:
    """The mounting that a fish's file gives."""
    if hardware.imu_rotation is None:
        up = AXIS_VECTORS[hardware.imu_up]
        return Mounting(up, AXIS_VECTORS["y" if up[0] else "x"])
    roll, pitch, yaw = hardware.imu_rotation
    (sr, cr), (sp, cp), (sy, cy) = ((math.sin(a), math.cos(a)) for a in (roll, pitch, yaw))
    ahead = (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr)  # first row of Rz Ry Rx
    return Mounting((-sp, cp * sr, cp * cr), ahead)


def direction(accelerations: Vector) -> Vector:
    """Unit vector that points up, of a sensor at rest; zero if it measures nothing."""
    size = math.hypot(*accelerations)
    x, y, z = (one / size if size else 0.0 for one in accelerations)
    return x, y, z


def named(up: Vector, least: float = NEAR) -> str:
    """A direction in words: an axis such as "-z" if the cosine to it is `least` or more, else three
    numbers."""
    for name, axis in AXIS_VECTORS.items():
        if _dot(axis, up) >= least:
            return name
    return " ".join(f"{round(one, 2) + 0.0:.2f}" for one in up)  # no -0.00


def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
