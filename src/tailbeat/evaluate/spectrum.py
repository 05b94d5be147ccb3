"""How much of the motor's motion lies below, inside and above the band: in runs of identification
and of a policy in its twin and in the pool; forward and reversing gaits apart."""

from collections.abc import Iterable
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
SPEED = 0.02  # m/s: slower than this either way is neither forward nor reversing
SHARES = ("share_below", "share_below_floor", "share_inside", "share_above")
BINS = np.arange(0.25, 12.01, 0.25)  # Hz, of the curves


def numbers(by_arm: dict[str, Runs], band: Band) -> list[dict[str, Any]]:
    """Per arm and gait: shares of the motor's velocity power on either side of a band's edges and
    between them, and the cumulative curve over `BINS`."""
    rows = []
    for name, runs in by_arm.items():
        speed = surge(runs)
        for gait, wanted in (("all", None), ("forward", 1), ("reversing", -1)):
            row = power_shares(windows(runs, speed, wanted), band)
            rows.append({"runs": name, "gait": gait, **row})
    return rows


def identification(fish: Fish, band: Band, seed: int) -> dict[str, Any]:
    """The same of the swims that a fish's fluid is identified on, recorded in the pool."""
    recordings = record_fluid(fish, seed)
    pairs = ((one.time, one.columns["motor_angle_rad"]) for one in recordings)
    return {"runs": "identification", "gait": "all", **power_shares(pairs, band)}


def complete(row: dict[str, Any]) -> dict[str, Any]:
    """A row with every column in order; files of earlier versions hold `share_below` alone."""
    names = ("runs", "gait", "pieces", *SHARES, "cumulative")
    return {name: row.get(name) for name in names}


def windows(runs: Runs, speed: Any, wanted: int | None) -> Iterable[tuple[Array, Array]]:
    """Motor angles of pieces of `WINDOW` whose mean surge goes the wanted way; whole swims for
    None."""
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


def power_shares(pairs: Iterable[tuple[Array, Array]], band: Band) -> dict[str, Any]:
    """Velocity power of some motor angles (time, angle): shares, None where nothing moves, and the
    cumulative curve over `BINS`. `share_below` is of all that lies below the upper edge,
    `share_below_floor` of what lies below the lower one. Pieces too short to tell what lies below
    the lower edge are split as the longer ones are; None if all are too short."""
    parts, long, count, curve = np.zeros(3), np.zeros(3), 0, np.zeros(BINS.size)
    for time, angle in pairs:
        try:
            found = velocity_spectrum(time, angle)
        except BadInput:
            continue
        # density times resolution times duration: longer pieces count for more
        parts += found.powers(band)
        long += found.powers(band) * found.resolves(band[0])
        curve += [found.power[found.frequency <= top].sum() for top in BINS]
        count += 1
    total = float(parts.sum())
    above = float(parts[2]) / total if total > 0 else None
    below = None if above is None else 1 - above
    slow = None if below is None or not long[:2].any() else below * float(long[0] / long[:2].sum())
    return {
        "pieces": count,
        "share_below": below,
        "share_below_floor": slow,
        "share_inside": None if below is None or slow is None else below - slow,
        "share_above": above,
        "cumulative": (curve / max(total, 1e-12)).tolist(),
    }
