"""What the networks are given beside the observation: the target's bearing where centimetres count.

Distances are observed in units of two metres, so the last ten centimetres, where it is decided
whether a turn is tight enough, are a twentieth of a unit: a network resolves them late. The newest
frame's way ahead and to the left are therefore given once more, divided by distance plus `RANGE`:
far away that is the bearing's cosine and sine, near the target the way in units of `RANGE`.
It follows from the observation alone, so the policy's contract stays what it is.
"""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch.nn import functional

from tailbeat.control.observation import SCALES, TABLE

Single = NDArray[np.float32]
RANGE = 0.1  # m within which a way counts by its length and not by its bearing (chosen)
NEWEST = "frame 0 (newest): target "
ADDED = 3  # ahead, left, and 1 - distance / (distance + RANGE)


def _matrices() -> dict[str, Single]:
    """What is added is (`above` o + `constant`) / (`below` o + RANGE) of an observation o (24,):
    `above` (3, 24), `constant` (3,), `below` (1, 24), `range` (1,)."""
    above, below = np.zeros((ADDED, len(TABLE))), np.zeros((1, len(TABLE)))
    for row, name in enumerate(("ahead", "left")):
        above[row, _column(name)] = SCALES[_column(name)]
    below[0, _column("distance")] = SCALES[_column("distance")]
    found = {"above": above, "constant": [0, 0, RANGE], "below": below, "range": [RANGE]}
    return {name: np.asarray(one, dtype=np.float32) for name, one in found.items()}


def _column(name: str) -> int:
    return [entry.name for entry in TABLE].index(NEWEST + name)


class TargetFeatures(BaseFeaturesExtractor):
    """Observations (n, 24) to (n, 27), for SB3's `features_extractor_class`; nothing is learnt."""

    above: torch.Tensor
    constant: torch.Tensor
    below: torch.Tensor
    range: torch.Tensor

    def __init__(self, observation_space: Any) -> None:
        super().__init__(observation_space, len(TABLE) + ADDED)
        for name, matrix in _matrices().items():
            self.register_buffer(name, torch.as_tensor(matrix), persistent=False)

    def forward(self, seen: torch.Tensor) -> torch.Tensor:
        """The observation and what is added to it."""
        above = functional.linear(seen, self.above, self.constant)
        return torch.cat([seen, above / functional.linear(seen, self.below, self.range)], dim=1)
