"""Poses of the fish frame and of its tracked point, one from the other."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tailbeat.fish.description import Fish

Array = NDArray[np.float64]


def tracked_pose(fish: Fish, root: Array) -> Array:
    """Pose (…, 3) x, y [m], yaw [rad] of the tracked point from that of the fish frame, `root`."""
    return _shift(fish, root, 1.0)


def root_pose(fish: Fish, tracked: Array) -> Array:
    """The inverse: pose (…, 3) of the fish frame from that of the tracked point."""
    return _shift(fish, tracked, -1.0)


def _shift(fish: Fish, pose: Array, sign: float) -> Array:
    x, y, _ = fish.tracked
    return np.asarray(_moved(pose.reshape(-1, 3), sign * x, sign * y)).reshape(pose.shape)


@njit(cache=True)
def _moved(poses, x, y):  # type: ignore[no-untyped-def]
    """Poses (n, 3) of a point at x, y of their frames."""
    moved = np.empty((len(poses), 3))
    for i in range(len(poses)):
        yaw = poses[i, 2]
        moved[i, 0] = poses[i, 0] + (x * np.cos(yaw) - y * np.sin(yaw))
        moved[i, 1] = poses[i, 1] + (x * np.sin(yaw) + y * np.cos(yaw))
        moved[i, 2] = yaw
    return moved
