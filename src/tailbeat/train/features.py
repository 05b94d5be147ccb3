"""Target features: inputs of the networks beside the observation, which resolve centimetres.

Distances are observed in units of two metres. In the last ten centimetres, a twentieth of a unit,
it matters whether a turn is tight enough, and a network learns to resolve them late. So the
target's position ahead and left in the newest frame is given once more, divided by distance plus
`RANGE`. Far away this is the bearing's cosine and sine; near the target, the position in units of
`RANGE`. The features follow from the observation, so the policy's contract does not change.

A policy that observes averages gets the position once more, seen from the fish's course instead of
its heading: turned by the direction of its own velocity, averaged over about a second. A tag glued
askew turns bearing and course alike, and a current moves the course as it moves the fish, so a
target that lies ahead on the course is reached whatever these are.
"""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.sac.policies import SACPolicy
from torch.nn import functional

from tailbeat.control.measure import Measure
from tailbeat.control.observation import REMEMBERING, TABLE, scales

Single = NDArray[np.float32]
RANGE = 0.1  # m, for the paper's fish: below it the features show position, not bearing (chosen)
NEWEST = "frame 0 (newest): target "
ADDED = 3  # ahead, left, and 1 - distance / (distance + RANGE)
COURSE = "own velocity {}, fast average"
SLOW = 0.1  # of an observed speed, added to it: a fish at rest has no course (chosen)


def _matrices(measure: Measure, observed: int) -> dict[str, Single]:
    """Matrices of the features (`above` o + `constant`) / (`below` o + RANGE) of an
    observation o (k,): `above` (3, k), `constant` (3,), `below` (1, k), `range` (1,)."""
    above, below = np.zeros((ADDED, observed)), np.zeros((1, observed))
    for row, name in enumerate(("ahead", "left")):
        above[row, _column(name)] = scales(measure)[_column(name)]
    below[0, _column("distance")] = scales(measure)[_column("distance")]
    near = RANGE * measure.size
    found = {"above": above, "constant": [0, 0, near], "below": below, "range": [near]}
    return {name: np.asarray(one, dtype=np.float32) for name, one in found.items()}


def _column(name: str) -> int:
    return [entry.name for entry in TABLE].index(NEWEST + name)


def _course(observed: int) -> dict[str, Single]:
    """Matrices for the target seen from the course. Products of `place` x (4, 3), of the features
    x, and `way` o (4, k) are summed by `turn` (2, 4); `speeds` o (2, k) is the velocity."""
    names = [one.name for one in REMEMBERING]
    speeds = np.zeros((2, observed))
    for row, name in enumerate(("ahead", "left")):
        speeds[row, names.index(COURSE.format(name))] = 1.0
    place = np.eye(ADDED)[[0, 1, 1, 0]]  # ahead, left, left, ahead
    found = {
        "place": place,
        "way": speeds[[0, 1, 0, 1]],
        "turn": np.array([[1, 1, 0, 0], [0, 0, 1, -1]]),
        "speeds": speeds,
        "both": np.ones((1, 2)),
        "slow": np.array([SLOW]),
    }
    return {name: np.asarray(one, dtype=np.float32) for name, one in found.items()}


class TargetFeatures(BaseFeaturesExtractor):
    """Observations (n, k) to (n, k + 3), or (n, k + 5) with averages, for SB3's
    `features_extractor_class`; no weights. The last `hidden` numbers of an observation are for
    critics: one that `shows` them appends them to the features, else they may also be absent."""

    above: torch.Tensor
    constant: torch.Tensor
    below: torch.Tensor
    range: torch.Tensor
    place: torch.Tensor
    way: torch.Tensor
    turn: torch.Tensor
    speeds: torch.Tensor
    both: torch.Tensor
    slow: torch.Tensor

    def __init__(
        self, observation_space: Any, measure: Measure, hidden: int = 0, shows: bool = False
    ) -> None:
        observed = observation_space.shape[0] - hidden
        self.observed, self.shows = observed, shows
        self.has_course = observed == len(REMEMBERING)
        wide = observed + ADDED + 2 * self.has_course + hidden * shows
        super().__init__(observation_space, wide)
        held = _matrices(measure, observed)
        if self.has_course:
            held |= _course(observed)
        for name, matrix in held.items():
            self.register_buffer(name, torch.as_tensor(matrix), persistent=False)

    def forward(self, seen: torch.Tensor) -> torch.Tensor:
        """The observation with the features appended."""
        seen, hidden = seen[:, : self.observed], seen[:, self.observed :]
        found = self._features(seen)
        return torch.cat([found, hidden], dim=1) if self.shows else found

    def _features(self, seen: torch.Tensor) -> torch.Tensor:
        above = functional.linear(seen, self.above, self.constant)
        close = above / functional.linear(seen, self.below, self.range)
        if not self.has_course:
            return torch.cat([seen, close], dim=1)
        velocity = functional.linear(seen, self.speeds)
        speed = torch.sqrt(functional.linear(velocity * velocity, self.both)) + self.slow
        turned = functional.linear(
            functional.linear(close, self.place) * functional.linear(seen, self.way), self.turn
        )
        return torch.cat([seen, close, turned / speed], dim=1)


class InformedPolicy(SACPolicy):
    """SB3's policy of SAC, whose critics see the hidden numbers of an observation; the actor does
    not. SB3 gives both the same arguments, so the critics' extractor is made here."""

    def make_critic(self, features_extractor: Any = None) -> Any:
        """A critic whose features have the hidden numbers."""
        kwargs = self.features_extractor_kwargs | {"shows": True}
        return super().make_critic(
            features_extractor or self.features_extractor_class(self.observation_space, **kwargs)
        )
