"""Fractions of the motor's velocity power below, inside and above the band.

For runs of identification, and of a policy in its twin and in the pool; forward and reversing gaits
separately.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.control.actions import PERIOD
from tailbeat.control.band import velocity_spectrum
from tailbeat.evaluate.runs import Runs, surge
from tailbeat.files import BadInput
from tailbeat.fish.description import Fish
from tailbeat.pool.protocols import record_fluid

Array = NDArray[np.float64]
Band = tuple[float, float]  # lower and upper edge [Hz]
WINDOW = 2.0  # s of one gait
SPEED = 0.02  # m/s: below this speed a piece is neither forward nor reversing
IDENTIFICATION = "identification"
BINS = np.arange(0.25, 12.01, 0.25)  # Hz, of the curves


@dataclass(frozen=True, kw_only=True)
class PowerShares:
    """Velocity power of the motor about a band, from `pieces` of swims.

    Fractions below its upper edge, below its lower edge, inside and above it: None if nothing
    moves, or if all pieces are too short. `cumulative` is the cumulative power at each of `BINS`.
    """

    pieces: int = 0
    share_below: float | None = None
    share_below_floor: float | None = None
    share_inside: float | None = None
    share_above: float | None = None
    cumulative: tuple[float, ...] = ()


@dataclass(frozen=True, kw_only=True)
class SpectrumRow(PowerShares):
    """Power fractions of some runs (a condition, or `IDENTIFICATION`) and of one gait."""

    runs: str
    gait: str


def numbers(by_condition: Mapping[str, Runs], band: Band) -> tuple[SpectrumRow, ...]:
    """A row per condition and gait."""
    return tuple(
        SpectrumRow(runs=name, gait=gait, **vars(power_shares(windows(runs, speed, wanted), band)))
        for name, runs, speed in ((name, runs, surge(runs)) for name, runs in by_condition.items())
        for gait, wanted in (("all", None), ("forward", 1), ("reversing", -1))
    )


def identification(fish: Fish, band: Band, seed: int) -> SpectrumRow:
    """The row of the swims on which a fish's fluid is identified, recorded in the pool."""
    recordings = record_fluid(fish, seed)
    pairs = ((one.time, one.columns["motor_angle_rad"]) for one in recordings)
    return SpectrumRow(runs=IDENTIFICATION, gait="all", **vars(power_shares(pairs, band)))


def windows(runs: Runs, speed: Any, wanted: int | None) -> Iterable[tuple[Array, Array]]:
    """Times and motor angles of pieces of `WINDOW` whose mean surge has the sign `wanted`; whole
    swims for None."""
    length = round(WINDOW / PERIOD)
    clock: Array = np.arange(runs.motor.shape[1], dtype=float) * PERIOD
    for fish in range(runs.count):
        steps = int(runs.steps[fish])
        angle: Array = runs.motor[fish, : steps + 1].astype(np.float64)
        time = clock[: angle.size]
        if wanted is None:
            if steps >= length:
                yield time, angle
            continue
        for first in range(0, steps - length + 1, length):
            mean = float(np.mean(speed[fish, first : first + length]))
            if mean * wanted > SPEED:
                yield time[: length + 1], angle[first : first + length + 1]


def power_shares(pairs: Iterable[tuple[Array, Array]], band: Band) -> PowerShares:
    """Power fractions of motor angles (time [s], angle [rad]). For pieces too short to resolve the
    lower edge, the split at it is taken from the longer ones."""
    parts, long, count, curve = np.zeros(3), np.zeros(3), 0, np.zeros(BINS.size)
    for time, angle in pairs:
        try:
            found = velocity_spectrum(time, angle)
        except BadInput:
            continue
        # density times resolution times duration: longer pieces have more weight
        parts += found.powers(band)
        long += found.powers(band) * found.resolves(band[0])
        curve += [found.power[found.frequency <= top].sum() for top in BINS]
        count += 1
    total = float(parts.sum())
    above = float(parts[2]) / total if total > 0 else None
    below = None if above is None else 1 - above
    slow = None if below is None or not long[:2].any() else below * float(long[0] / long[:2].sum())
    return PowerShares(
        pieces=count,
        share_below=below,
        share_below_floor=slow,
        share_inside=None if below is None or slow is None else below - slow,
        share_above=above,
        cumulative=tuple((curve / max(total, 1e-12)).tolist()),
    )
