"""An identified number: its value, its 95 % interval, and whether the data decide it."""

from dataclasses import dataclass
from typing import Any

DECIDED = 0.1  # a 95 % interval within 10 % of the value counts as decided by the data


@dataclass(frozen=True)
class Estimate:
    """A number in `unit` with its 95 % interval, and the centre of its prior if it had one."""

    value: float
    interval: tuple[float, float]
    unit: str = "1"
    prior: float | None = None

    @property
    def decided(self) -> bool:
        """Whether the interval lies within 10 % of the value."""
        return (self.interval[1] - self.interval[0]) < 2 * DECIDED * abs(self.value)


def as_row(estimate: Estimate) -> dict[str, Any]:
    """The JSON of an identified number."""
    row = {
        "value": estimate.value,
        "unit": estimate.unit,
        "interval": list(estimate.interval),
        "decided_by_data": estimate.decided,
    }
    return row if estimate.prior is None else {**row, "prior": estimate.prior}
