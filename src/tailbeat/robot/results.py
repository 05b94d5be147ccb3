"""Summary of a drive, from its log and its loop."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tailbeat.control.actions import PERIOD
from tailbeat.link.reasons import Reason


@dataclass(frozen=True)
class SwimSummary:
    """Summary of a log.

    Its length `seconds`, time under the policy `swum` [s], rows per second `rate` [Hz]; median age
    of the newest pose [s] and smallest distance to the target [m], both None if the robot never
    swam.
    """

    seconds: float
    swum: float
    rate: float
    pose_age_median: float | None
    nearest: float | None


@dataclass(frozen=True)
class DriveResult:
    """How a drive ended.

    The `reason` and its text; datagrams `rejected` by cause; quantiles of the loop's `punctuality`
    [ms] by quantity (late, busy, compute, latency); periods done and skipped. `swim` is None for a
    drive that waits for orders, because its log may contain days.
    """

    reason: Reason
    ended: str
    rejected: Mapping[str, int]
    punctuality: Mapping[str, Mapping[str, float]]
    periods: int
    periods_skipped: int
    swim: SwimSummary | None = None

    @property
    def by_hand(self) -> bool:
        """Whether a person ended it, with an order or a signal, after it swam or while it waited
        for orders."""
        swum = self.swim is None or self.swim.swum > 0
        return swum and self.reason in (Reason.NOT_ARMED, Reason.STOP_ASKED)


def summarise(rows: Sequence[Mapping[str, Any]]) -> SwimSummary:
    """Summarise a log's rows."""
    swum = [row for row in rows if row["state"] == "run"]
    time = np.array([row["time_s"] for row in rows])
    away = [_away(row) for row in swum if row["decided_on"]]
    ages = [row["pose_age_s"] for row in swum if row["pose_age_s"] is not None]
    seconds = float(time[-1] - time[0])
    return SwimSummary(
        seconds=seconds,
        swum=PERIOD * len(swum),
        rate=(len(rows) - 1) / seconds,
        pose_age_median=float(np.median(ages)) if ages else None,
        nearest=min(away) if away else None,
    )


def _away(row: Mapping[str, Any]) -> float:
    """Distance to the target in the newest frame [m]."""
    x, y, _, tx, ty, _ = row["decided_on"][:6]
    return float(np.hypot(tx - x, ty - y))


def drive_json(result: DriveResult) -> dict[str, Any]:
    """The result that `drive --json` writes: flat, with units in the names."""
    swum = {} if result.swim is None else _swim_json(result.swim)
    paces = {
        f"{quantity}_{name}": value
        for quantity, row in result.punctuality.items()
        for name, value in row.items()
    }
    ended = {"rejected_datagrams": dict(result.rejected), "ended": result.ended}
    periods = {"periods": result.periods, "periods_skipped": result.periods_skipped}
    return {**swum, **ended, **paces, **periods}


def _swim_json(swim: SwimSummary) -> dict[str, Any]:
    age = swim.pose_age_median
    return {
        "seconds": swim.seconds,
        "swum_s": swim.swum,
        "rate_hz": swim.rate,
        "pose_age_ms_median": None if age is None else 1e3 * age,
        "nearest_m": swim.nearest,
    }
