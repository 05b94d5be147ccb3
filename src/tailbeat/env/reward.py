"""The reward, defined once, for the steps of a world and for targets that the replay buffer
relabels."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.control.actions import PERIOD
from tailbeat.control.measure import Measure

Array = NDArray[np.float64]
NEAR = 1.0  # of the fish's reach: `nearness` acts within it; larger than its turning circle
# Of the paper's fish: the time in which a fish should be at its target, its largest wanted speed,
# and how wrong a velocity may be at most [s, m/s, m/s] (chosen).
SECONDS, FASTEST, WRONG = 1.5, 0.35, 0.5


@dataclass(frozen=True)
class Reward:
    """r = -distance - effort ||a|| + bonus [distance < arrival] (paper).

    Distances are over the fish's reach, so in metres for the paper's fish. With a target that keeps
    moving, -nearness min(distance, 1) - pace min(missed, 0.5) replaces the bonus (ours; see
    `missed`). What a stroke does to the fish's velocity shows within a few control steps, what it
    does to the distance only after a second.
    """

    distance: float = 1.0
    effort: float = 0.1
    bonus: float = 1000.0
    nearness: float = 2.0
    pace: float = 12.0


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


def of_target(
    weights: Reward, distance: Any, arrived: Any, goes_on: Any, missed: Any
) -> tuple[Any, Any]:
    """The distance's and the bonus's term of steps that end at `distance` from the target, in units
    of the fish's reach, at a velocity that `missed` the wanted one.

    The arrays broadcast: `distance` and `missed` (…,), whether the fish `arrived`, and whether the
    target `goes_on` moving. The terms have the dtype of `distance`; where it is NaN they are NaN.
    A NaN of `missed` counts as the most.
    """
    nearness = weights.nearness * np.minimum(distance / NEAR, 1.0)
    lost = nearness + weights.pace * np.fmin(missed, WRONG)
    bonus = (weights.bonus * arrived - lost * goes_on).astype(distance.dtype)
    return -weights.distance * distance, bonus


def in_plane(place: Any) -> NDArray[np.complex128]:
    """Positions (…, 2) in the pool as complex numbers (…), x + iy."""
    return np.asarray(place[..., 0] + 1j * place[..., 1], dtype=np.complex128)


def missed(tag: Any, target: Any, apart: Any, measure: Measure) -> Any:
    """How far the velocity of the tag is from the wanted one, in m/s for the paper's fish (…,).

    In one control step `tag` and `target` moved so far (…,) [m]; after it the target is at `apart`
    (…,) [m], seen from the tag. All are complex numbers, see `in_plane`. Wanted is the target's
    velocity and what would bring the fish to it within `SECONDS`, but no more than `FASTEST`.
    """
    per_second = 1 / PERIOD / measure.speed
    wanted = target * per_second + apart / measure.reach / SECONDS
    wanted = wanted * np.minimum(FASTEST / np.maximum(np.abs(wanted), FASTEST), 1.0)
    return np.abs(tag * per_second - wanted)
