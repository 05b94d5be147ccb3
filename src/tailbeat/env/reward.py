"""The reward, defined once, for the steps of a world and for targets that the replay buffer
relabels."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
NEAR = 1.0  # of the fish's reach: `nearness` acts within it; larger than its turning circle


@dataclass(frozen=True)
class Reward:
    """r = -distance - effort ||a|| + bonus [distance < arrival] (paper).

    Distances are over the fish's reach, so in metres for the paper's fish. With a target that keeps
    moving, nearness * max(1 - distance, 0) replaces the bonus (ours: some seconds beside the target
    are worth as much as an arrival).
    """

    distance: float = 1.0
    effort: float = 0.1
    bonus: float = 1000.0
    nearness: float = 8.0


@dataclass(frozen=True, eq=False)
class Terms:
    """The three terms of the rewards of n steps, each (n,)."""

    distance: Array
    effort: Array
    bonus: Array

    def total(self) -> Array:
        """The rewards (n,)."""
        return np.asarray(self.distance + self.effort + self.bonus)


TERMS = ("distance", "effort", "bonus")


def of_action(weights: Reward, action: Array) -> Array:
    """The effort's term (n,) of actions (n, size), which are clipped to [-1, 1]."""
    return np.asarray(-weights.effort * np.sqrt((np.clip(action, -1.0, 1.0) ** 2).sum(axis=1)))


def of_target(weights: Reward, distance: Any, arrived: Any, goes_on: Any) -> tuple[Any, Any]:
    """The distance's and the bonus's term of steps that end at `distance` from the target, in units
    of the fish's reach.

    The arrays broadcast: `distance` (…,), whether the fish `arrived`, and whether the target
    `goes_on` moving. The terms have the dtype of `distance`; where it is NaN they are NaN.
    """
    nearness = weights.nearness * np.maximum(1 - distance / NEAR, 0.0) * goes_on
    bonus = (weights.bonus * arrived + nearness).astype(distance.dtype)
    return -weights.distance * distance, bonus
