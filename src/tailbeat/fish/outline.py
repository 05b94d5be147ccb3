"""The fish as a line from nose to tail, for pictures from above."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.fish.description import Fish

Array = NDArray[np.float64]
MOTOR = 3  # of the generalised coordinates: x, y, yaw, motor, hinges


def outline(fish: Fish, qpos: Array) -> Array:
    """Places (k, 2) [m] of nose, head, hinges and fin under generalised coordinates (nv,)."""
    links = fish.tail.links
    x, y, yaw = qpos[:3]
    angles = yaw - np.concatenate([[0.0], np.cumsum(qpos[MOTOR + 1 :])])
    head = [p.position[0] + p.size[0] / 2 for p in fish.head.parts]
    fin = min(p.position[0] - p.size[0] / 2 for p in links[-1].parts)
    ends = np.diff([0.0, *(link.hinge for link in links), fin])
    direction = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    behind = np.array([x, y]) + np.cumsum(ends[:, None] * direction, axis=0)
    nose = np.array([x, y]) + max(head) * direction[0]
    return np.concatenate([[nose], behind])


def guessed_shape(fish: Fish, pose: Any, motor: float) -> Array:
    """Generalised coordinates (nv,) for a picture, from the tag's `pose` x, y [m], yaw [rad] and
    the `motor` angle [rad]. The pull of the pulley bends all hinges alike. Not an estimate."""
    x, y, yaw = pose
    c, s, (ahead, left) = np.cos(yaw), np.sin(yaw), fish.tracked[:2]
    root = [x - ahead * c + left * s, y - ahead * s - left * c, yaw, motor]
    return np.array([*root, *[_bend(fish, motor)] * len(fish.tail.links)])


def _bend(fish: Fish, motor: float) -> float:
    """Angle of each hinge [rad]."""
    links = fish.tail.links
    arms = sum(np.mean([abs(guide[1]) for guide in one.guides] or [0.0]) for one in links)
    return float(fish.motor.radius * motor / arms) if arms else motor / len(links)
