"""Target features: inputs of the networks beside the observation, which resolve centimetres.

Distances are observed in units of two metres. In the last ten centimetres, a twentieth of a unit,
it matters whether a turn is tight enough, and a network learns to resolve them late. So the
target's position ahead and left in the newest frame is given once more, divided by distance plus
`RANGE`. Far away this is the bearing's cosine and sine; near the target, the position in units of
`RANGE`. The features follow from the observation, so the policy's contract does not change.
"""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from torch.nn import functional

from tailbeat.control.measure import Measure
from tailbeat.control.observation import TABLE, scales

Single = NDArray[np.float32]
RANGE = 0.1  # m, for the paper's fish: below it the features show position, not bearing (chosen)
NEWEST = "frame 0 (newest): target "
ADDED = 3  # ahead, left, and 1 - distance / (distance + RANGE)


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


class TargetFeatures(BaseFeaturesExtractor):
    """Observations (n, k) to (n, k + 3), for SB3's `features_extractor_class`; no weights."""

    above: torch.Tensor
    constant: torch.Tensor
    below: torch.Tensor
    range: torch.Tensor

    def __init__(self, observation_space: Any, measure: Measure) -> None:
        observed = observation_space.shape[0]
        super().__init__(observation_space, observed + ADDED)
        for name, matrix in _matrices(measure, observed).items():
            self.register_buffer(name, torch.as_tensor(matrix), persistent=False)

    def forward(self, seen: torch.Tensor) -> torch.Tensor:
        """The observation with the features appended."""
        above = functional.linear(seen, self.above, self.constant)
        return torch.cat([seen, above / functional.linear(seen, self.below, self.range)], dim=1)
