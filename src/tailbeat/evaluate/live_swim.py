"""A swim in real time, read from the fish's log: the tag's poses and the results.

The log has the tag's pose and the motor's angle; the hinge angles are estimated from them.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tailbeat.control.actions import PERIOD
from tailbeat.control.measure import ARRIVAL
from tailbeat.evaluate.tour import Tour
from tailbeat.files import BadInput
from tailbeat.fish.description import Fish
from tailbeat.fish.outline import guessed_shape
from tailbeat.operator.tour import TargetResult

Array = NDArray[np.float64]
TARGET = slice(3, 5)  # of the newest frame in `decided_on`
CLOSE = 1e-3  # m: the link sends float32


def tour_of(log: Path, fish: Fish, targets: Array, arrival: float = ARRIVAL) -> Tour:
    """The swim past targets (m, 2) [m], each reached within `arrival` [m]. Targets that it did not
    swim to count as missed. Raises BadInput for a log without swimming, or with other targets."""
    from tailbeat.robot.log import read_rows  # needs the extra

    rows = [row for row in read_rows(log) if row["state"] == "run" and row["decided_on"]]
    if not rows:
        raise BadInput(f"{log}: the fish never swam; the `reason` of its last rows says why.")
    newest = np.array([row["decided_on"][:6] for row in rows], float)
    motor = np.array([row["motor_angle_rad"] for row in rows], float)
    away = np.linalg.norm(newest[:, None, TARGET] - targets, axis=2)
    known = away.min(axis=1) < CLOSE
    pose, motor, goal = newest[known, :3], motor[known], away[known].argmin(axis=1)
    if not known.any():
        raise BadInput(f"{log}: the fish swam to other targets; give the seed of that swim.")
    reach = np.hypot(*(pose[:, :2] - targets[goal]).T)
    ends = [_end(reach[goal == number], arrival) for number in range(len(targets))]
    reached, seconds, nearest = map(np.array, zip(*ends, strict=True))
    shape = np.stack([guessed_shape(fish, *one) for one in zip(pose, motor, strict=True)])
    return Tour(targets, shape, pose, goal, reached, seconds, nearest)


def as_seen(tour: Tour, rows: Sequence[TargetResult]) -> Tour:
    """The tour with the station's results. The station changes the target at the frame of an
    arrival, which the fish's log may not have. A target without a row was not reached."""
    count = len(tour.targets)
    reached, nearest = np.zeros(count, dtype=bool), np.full(count, np.inf)
    seconds = np.zeros(count)
    for row in rows:
        number = row.target - 1
        reached[number], seconds[number], nearest[number] = row.reached, row.seconds, row.closest
    return replace(tour, reached=reached, nearest=nearest, seconds=seconds)


def _end(reach: Array, arrival: float) -> tuple[bool, float, float]:
    """Whether a target was reached, the time [s] and the closest approach [m]."""
    nearest = float(reach.min()) if reach.size else np.inf
    return nearest < arrival, PERIOD * reach.size, nearest
