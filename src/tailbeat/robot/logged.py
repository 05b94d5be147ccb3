"""Read a robot's logs for what its swims alone tell (`identify.offsets`), and for its fish."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tailbeat.files import BadInput
from tailbeat.fish.description import Fish
from tailbeat.fish.store import fish_of, load_fish, shipped
from tailbeat.identify.offsets import Offsets, offsets
from tailbeat.identify.swim_columns import Logged
from tailbeat.robot.log import read_log, read_notes
from tailbeat.robot.log_losses import losses

NEEDED = (
    "time_s", "x_m", "y_m", "yaw_rad", "pose_age_s", "yaw_rate_rad_s", "motor_angle_rad",
    "motor_velocity_rad_s", "command_rad",
)  # fmt: skip
SAME = ("fish_digest", "policy_sha256", "calibration")  # of all logs of one robot
MOVES = NEEDED[1:4] + NEEDED[5:]  # of a fish that swims
SWIMS = "run"  # state in which the policy swims


def offsets_of(paths: Sequence[Path]) -> Offsets:
    """Offsets of one robot from its logs. Raises BadInput for logs of two robots, without poses, or
    too short."""
    swims, damage = swims_of(paths)
    return replace(offsets(swims), damage=damage)


def swims_of(paths: Sequence[Path]) -> tuple[list[Logged], tuple[str, ...]]:
    """The swimming parts of the logs of one robot, and what the logs lack, a sentence each. Raises
    BadInput, also for logs of two robots."""
    check_same(paths)
    read = {path: read_log(path) for path in paths}
    damage = tuple(f"{path}: {said}" for path, one in read.items() for said in losses(one))
    return [_swum(path, one.rows) for path, one in read.items()], damage


def logged(path: Path) -> Logged:
    """The swimming part of a log. Raises BadInput."""
    return _swum(path, read_log(path).rows)


def _swum(path: Path, every: Sequence[Mapping[str, Any]]) -> Logged:
    rows = [row for row in every if row.get("state") == SWIMS]
    whole = [row for row in rows if all(row.get(name) is not None for name in NEEDED)]
    if not rows:
        raise BadInput(f"{path}: its policy swims in no row; give a log of a swim.")
    if len(whole) < 2:
        lacking = [name for name in NEEDED if all(row.get(name) is None for row in rows)]
        what = f"no row has {lacking[0]}" if lacking else f"{len(whole)} rows are complete"
        raise BadInput(
            f"{path}: {len(rows)} rows while its policy swims, but {what}; give a log of a swim"
            f" with camera, servo and yaw rate."
        )
    table = np.array([[row[name] for name in NEEDED] for row in whole], float)
    table = table[np.argsort(table[:, 0], kind="stable")]
    for name, column in zip(NEEDED, table.T, strict=True):
        if name in MOVES and np.ptp(column) == 0:
            raise BadInput(
                f"{path}: {name} is {column[0]:g} in all {len(column)} rows while its policy swims:"
                f" the reading is frozen; mend the sensor, and give another log."
            )
    time, x, y, yaw, age, *rest = table.T
    return Logged(time, time - age, np.column_stack([x, y, yaw]), *rest)


def fish_in(path: Path, named: str | None = None) -> Fish:
    """The fish `named`, by file or name; None is the one that a log tells in its head. An earlier
    log tells the shipped fish that its policy was trained on. Raises BadInput if it tells neither,
    or is no log."""
    if named:
        return load_fish(named)
    notes = read_notes(path)
    if "fish" in notes:
        return fish_of(_content(path, notes["fish"]))
    trained = notes.get("contract", "")
    if trained not in shipped():
        read_log(path)
        raise BadInput(f"{path}: it does not tell which fish swam; give it with --fish.")
    return load_fish(trained)


def _content(path: Path, text: str) -> dict[str, Any]:
    try:
        return dict(json.loads(text))
    except (ValueError, TypeError):
        raise BadInput(
            f"{path}: the fish in its head is no JSON object; give the fish with --fish."
        ) from None


def check_swum_by(paths: Sequence[Path], policy: Path) -> None:
    """Raises BadInput for a log of another policy than the file."""
    ours = hashlib.sha256(policy.read_bytes()).hexdigest()
    for path in paths:
        theirs = read_notes(path).get("policy_sha256", "") if path.is_file() else ""
        if not theirs:
            read_log(path)  # it may be no log at all
        if theirs != ours:
            raise BadInput(
                f"{path}: its policy_sha256 is {theirs[:12] or 'not told'}, that of {policy} is"
                f" {ours[:12]}; give the policy that swam."
            )


def check_same(paths: Sequence[Path]) -> None:
    """Raises BadInput if logs are of different fish, policies or calibrations, or one was given
    twice: it would count as two swims."""
    seen: dict[str, Path] = {}
    for path in filter(Path.is_file, paths):
        before = seen.setdefault(hashlib.sha256(path.read_bytes()).hexdigest(), path)
        if before is not path:
            raise BadInput(f"{path}: the same log as {before}; give each log once.")
    first = read_notes(paths[0])
    for path in paths[1:]:
        notes = read_notes(path)
        for name in SAME:
            if name in first and name in notes and first[name] != notes[name]:
                raise BadInput(
                    f"{path}: its {name} is {notes[name]}, that of {paths[0]} is {first[name]};"
                    f" give logs of one fish, policy and calibration."
                )
