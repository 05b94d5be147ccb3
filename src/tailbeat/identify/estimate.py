"""An identified number: its value, its 95 % interval, and whether the data determine it."""

from dataclasses import dataclass
from typing import Any

DECIDED = 0.1  # a 95 % interval of +-10 % of the value counts as decided by the data


@dataclass(frozen=True)
class Estimate:
    """A number in `unit` with its 95 % interval (low, high), and its prior's centre, if any."""

    value: float
    interval: tuple[float, float]
    unit: str = "1"
    prior: float | None = None

    @property
    def decided(self) -> bool:
        """Whether the interval is narrower than 20 % of the value, and the value is not at the end
        of what was searched: then its interval ends at the value."""
        low, high = self.interval
        return high - low < 2 * DECIDED * abs(self.value) and low < self.value < high

    @property
    def above_zero(self) -> bool:
        """Whether the data say that the number is above zero."""
        return self.value > 0 and self.interval[0] > 0


def as_row(estimate: Estimate) -> dict[str, Any]:
    """The JSON of an identified number."""
    row = {
        "value": estimate.value,
        "unit": estimate.unit,
        "interval": list(estimate.interval),
        "decided_by_data": estimate.decided,
    }
    return row if estimate.prior is None else {**row, "prior": estimate.prior}
