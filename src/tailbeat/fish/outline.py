"""The fish as a line from nose to tail, for pictures from above."""

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
