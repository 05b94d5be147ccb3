"""Tags that are fixed to the pool: has the camera moved since the survey?

The tags of the calibration's survey may stay in the pool. Each search of the whole picture compares
their places with the surveyed ones.
"""

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tailbeat.vision.calibration import Calibration
from tailbeat.vision.detector import Seen

Array = NDArray[np.float64]
SEARCHES = 3  # of which the median counts: one reflection moves nothing


@dataclass(eq=False)
class FixedTags:
    """How far the fixed tags are from their surveyed places; `offsets` (x, y) [m] of the last
    searches, by id."""

    calibration: Calibration
    offsets: dict[int, deque[Array]] = field(default_factory=dict)

    @property
    def known(self) -> Mapping[int, tuple[float, float, float]]:
        """Surveyed x, y, z [m] by id."""
        return self.calibration.fixed

    def see(self, found: Iterable[Seen]) -> None:
        """Compare the tags that were found in a whole picture."""
        for one in found:
            if one.ident not in self.known:
                continue
            x, y, z = self.known[one.ident]
            middle = self.calibration.places(one.corners, z).mean(axis=0)
            kept = self.offsets.setdefault(one.ident, deque(maxlen=SEARCHES))
            kept.append(middle - [x, y])

    def moved(self) -> float:
        """Largest distance [m] of a fixed tag from its place, each a median of three searches; 0
        where none was seen so often."""
        whole = [kept for kept in self.offsets.values() if len(kept) == SEARCHES]
        return max((float(np.hypot(*np.median(kept, axis=0))) for kept in whole), default=0.0)
