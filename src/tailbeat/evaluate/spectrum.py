"""How much of the motor's motion stays below the band's edge: runs of identification, of a policy
in its twin and in the pool; forward and reversing gaits apart."""

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.control.band import velocity_spectrum
from tailbeat.evaluate.runs import Runs, surge
from tailbeat.files import BadInput
from tailbeat.fish.description import Fish
from tailbeat.learn.body import PERIOD
from tailbeat.pool.protocols import record_fluid

Array = NDArray[np.float64]
WINDOW = 2.0  # s of one gait
SPEED = 0.02  # m/s: slower than this either way is neither forward nor reversing
BINS = np.arange(0.25, 12.01, 0.25)  # Hz, of the curves


def numbers(by_arm: dict[str, Runs], edge: float) -> list[dict[str, Any]]:
    """Per arm and gait: share of the motor's velocity power below `edge` [Hz], and the cumulative
    curve over `BINS`."""
    rows = []
    for name, runs in by_arm.items():
        speed = surge(runs)
        for gait, wanted in (("all", None), ("forward", 1), ("reversing", -1)):
            row = power_below(windows(runs, speed, wanted), edge)
            rows.append({"runs": name, "gait": gait, **row})
    return rows


def identification(fish: Fish, edge: float, seed: int) -> dict[str, Any]:
    """The same of the swims that a fish's fluid is identified on, recorded in the pool."""
    recordings = record_fluid(fish, seed)
    pairs = ((one.time, one.columns["motor_angle_rad"]) for one in recordings)
    return {"runs": "identification", "gait": "all", **power_below(pairs, edge)}


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


def power_below(pairs: Iterable[tuple[Array, Array]], edge: float) -> dict[str, Any]:
    """Velocity power of some motor angles (time, angle): its share below `edge` [Hz], None where
    nothing moves, and the cumulative curve over `BINS`."""
    below, total, count, curve = 0.0, 0.0, 0, np.zeros(BINS.size)
    for time, angle in pairs:
        try:
            found = velocity_spectrum(time, angle)
        except BadInput:
            continue
        # density times resolution times duration: longer pieces count for more
        below += float(found.power[found.frequency <= edge].sum())
        total += float(found.power.sum())
        curve += [found.power[found.frequency <= top].sum() for top in BINS]
        count += 1
    share = below / total if total > 0 else None
    return {
        "pieces": count,
        "share_below": share,
        "cumulative": (curve / max(total, 1e-12)).tolist(),
    }
