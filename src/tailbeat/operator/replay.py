"""A finished run for the operator page, read from its log: a snapshot for any time.

The log has no pool size, no camera pictures and no counts of the link: these are None. The target
is known while the policy swims.
"""

import math
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

from tailbeat.files import BadInput
from tailbeat.fish.description import Fish
from tailbeat.fish.store import hardware_of
from tailbeat.link.status import State
from tailbeat.operator.snapshot import Change, body
from tailbeat.operator.target_motion import SPAN as RECENT
from tailbeat.operator.target_motion import Velocity, velocity
from tailbeat.robot.log import is_whole, read_rows
from tailbeat.robot.log_rows import NUMBERS
from tailbeat.robot.safety import SafetyLimits, limits_for

NEEDED = ("time_s", "state", "reason")  # of every row
POSE = ("x_m", "y_m", "yaw_rad")
TARGET, AGE = slice(3, 5), 5  # of the newest frame in `decided_on`
SPAN = 5  # rows of one status, over which lateness and duration are the longest
TRAIL, STEP = 30.0, 8  # s of path that is shown, rows between two of its points
MINUTE, APART = 60.0, 10  # s of distances that are shown, rows between two of them
STATES = tuple(state.value for state in State)
NO_PICTURES = "The log holds no camera pictures."
Row = Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Run:
    """A log's rows (k,) without the policy's inputs, and their times [s] from the first (k,).
    `whole`: whether the log is complete."""

    name: str
    time: Sequence[float]
    rows: Sequence[Row]
    whole: bool

    @property
    def seconds(self) -> float:
        """Duration [s]."""
        return self.time[-1]

    def changes(self) -> tuple[Change, ...]:
        """Every state and reason with its start [s] after the first row."""
        first = [Change(0.0, self.rows[0]["state"], self.rows[0]["reason"])]
        pairs = zip(self.time[1:], pairwise(self.rows), strict=True)
        return tuple(
            first
            + [
                Change(at, now["state"], now["reason"])
                for at, (before, now) in pairs
                if (before["state"], before["reason"]) != (now["state"], now["reason"])
            ]
        )


def read_run(path: Path) -> Run:
    """Read a log of `drive` or `swim`, up to where it is complete. Raises BadInput if it is not
    one, or lacks a field that a replay needs."""
    rows = read_rows(path)
    for name in NEEDED:
        if all(row.get(name) is None for row in rows):
            needs = ", ".join(NEEDED)
            raise BadInput(
                f"{path}: no row has {name}; a replay needs {needs} of `tailbeat drive`."
            )
    for number, row in enumerate(rows):
        if fault := _fault(row):
            raise BadInput(f"{path}: row {number}: {fault}; give a log of `tailbeat drive`.")
    for number, (before, row) in enumerate(pairwise(rows), 1):
        if row["time_s"] < before["time_s"]:
            raise BadInput(f"{path}: row {number}: time_s goes back; give a log of one run.")
    first = rows[0]["time_s"]
    return Run(path.name, [row["time_s"] - first for row in rows], [*map(_kept, rows)],
               is_whole(path))  # fmt: skip


def _fault(row: Row) -> str:
    """Why a row cannot be shown, or ""."""
    if not _is_number(row.get("time_s")):
        return f"time_s is {row.get('time_s')!r}, not a time"
    if row.get("state") not in STATES:
        return f"state is {row.get('state')!r}, not one of {', '.join(STATES)}"
    if not isinstance(row.get("reason"), str):
        return f"reason is {row.get('reason')!r}, not a text"
    for name in NUMBERS:
        if row.get(name) is not None and not isinstance(row[name], int | float):
            return f"{name} is {row[name]!r}, not a number"
    frames = row.get("decided_on") or []
    newest = frames[: AGE + 1] if isinstance(frames, list) else [None]
    if newest and (len(newest) <= AGE or not all(map(_is_number, newest))):
        return "decided_on is not a list of numbers"
    return ""


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and math.isfinite(value)


def _kept(row: Row) -> Row:
    """A row without the large fields that are not shown."""
    return {name: value for name, value in row.items() if name not in ("observation", "action")}


# ---- one moment ---------------------------------------------------------------------------------


def snapshot(run: Run, fish: Fish, room: tuple[float, float], at: float) -> dict[str, Any]:
    """What the page shows at a time [s] after the first row; outside the run, its nearest end.
    `room` is length and width of the pool [m]."""
    index = max(bisect_right(run.time, at) - 1, 0)
    row, limits = run.rows[index], limits_for(hardware_of(fish))
    return {
        "at": min(max(at, 0.0), run.seconds),
        "room": room,
        "fish": _fish(fish, row),
        "trail": _trail(run, index),
        "target": _target(row),
        "velocity": _velocity(run, index),
        "distances": _distances(run, index),
        "operator": False,
        "outcomes": [],
        "note": NO_PICTURES,
        "status": _status(run.rows[max(index - SPAN + 1, 0) : index + 1], limits),
        "loss_back": None,
        "limits": asdict(limits),
    }


def _pose(row: Row) -> list[float] | None:
    found = [row.get(name) for name in POSE]
    return found if all(map(_is_number, found)) else None  # type: ignore[return-value]


def _target(row: Row) -> list[float] | None:
    frames = row.get("decided_on")
    return list(frames[TARGET]) if frames else None


def _fish(fish: Fish, row: Row) -> dict[str, Any] | None:
    pose = _pose(row)
    if pose is None:
        return None
    motor = row.get("motor_angle_rad")
    bend = float(motor) if _is_number(motor) else 0.0  # type: ignore[arg-type]
    age = row.get("pose_age_s")
    return {"pose": pose, "age": age, "body": body(fish, (pose[0], pose[1], pose[2]), bend)}


def _trail(run: Run, index: int) -> list[list[float]]:
    """Age [s], x and y [m] of points of the path so far, oldest first. The same rows are used at
    every time, so that the path does not flicker."""
    places, now = [], run.time[index]
    first = bisect_right(run.time, now - TRAIL)
    for k in [*range(first + -first % STEP, index, STEP), index]:
        if (pose := _pose(run.rows[k])) is not None:
            places.append([round(now - run.time[k], 3), pose[0], pose[1]])
    return places


def _velocity(run: Run, index: int) -> Velocity | None:
    """The target's velocity at a row [m/s]; None while the policy does not swim."""
    first = bisect_right(run.time, run.time[index] - RECENT)
    rows = [run.rows[k] for k in range(first, index + 1)]
    if _target(run.rows[index]) is None:
        return None
    shown = {_filmed(row): place for row in rows if (place := _target(row)) is not None}
    return velocity(sorted(shown), [shown[at] for at in sorted(shown)])


def _filmed(row: Row) -> float:
    """When the newest frame of a row was filmed [s]; its age is the frame's last number."""
    return float(row["time_s"]) - float(row["decided_on"][AGE])


def _distances(run: Run, index: int) -> list[list[float]]:
    """Age [s] of the last minute's distances of tag and target [m], oldest first; the same rows are
    used at every time."""
    found, now = [], run.time[index]
    first = bisect_right(run.time, now - MINUTE)
    for k in [*range(first + -first % APART, index, APART), index]:
        frame = run.rows[k].get("decided_on")
        if frame:
            away = math.dist(frame[:2], frame[TARGET])
            found.append([round(now - run.time[k], 3), round(away, 4)])
    return found


def _status(rows: Sequence[Row], limits: SafetyLimits) -> dict[str, Any]:
    """The last of these rows as the fish's status."""
    row = rows[-1]
    return {
        "state": row["state"],
        "reason": row["reason"],
        "cause": row.get("cause"),
        "age": 0.0,
        "target": _target(row),
        "pose_age": row.get("pose_age_s"),
        "pose_hold": limits.pose_hold,
        "pose_stop": limits.pose_stop,
        "angle": row.get("motor_angle_rad"),
        "setpoint": row.get("command_rad"),
        "temperature": row.get("temperature_deg_c"),
        "voltage": row.get("voltage_v"),
        "current": row.get("current_a"),
        "late": _longest(rows, "late_s"),
        "busy": _longest(rows, "busy_s"),
        "missed": row.get("missed"),
        "band_share": row.get("band_share"),
        "clock_doubt": row.get("clock_doubt_s"),
        "loss": None,
        "rejects": None,
    }


def _longest(rows: Sequence[Row], name: str) -> float | None:
    known = [row[name] for row in rows if row.get(name) is not None]
    return max(known, default=None)
