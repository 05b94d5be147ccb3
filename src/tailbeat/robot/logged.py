"""Read a robot's logs for what its swims alone tell (`identify.offsets`), and for its fish."""

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tailbeat.files import BadInput
from tailbeat.fish.description import Fish
from tailbeat.fish.store import fish_of, load_fish, shipped
from tailbeat.identify.offsets import Logged, Offsets, offsets
from tailbeat.robot.log import read_log, read_notes

NEEDED = (
    "time_s", "x_m", "y_m", "yaw_rad", "pose_age_s", "yaw_rate_rad_s", "motor_angle_rad",
    "motor_velocity_rad_s", "command_rad",
)  # fmt: skip
SAME = ("fish_digest", "policy_sha256", "calibration")  # of all logs of one robot
SWIMS = "run"  # state in which the policy swims


def offsets_of(paths: Sequence[Path]) -> Offsets:
    """Offsets of one robot from its logs. Raises BadInput for logs of two robots, without poses, or
    too short."""
    check_same(paths)
    return offsets([logged(path) for path in paths])


def logged(path: Path) -> Logged:
    """The swimming part of a log. Raises BadInput."""
    rows = [row for row in read_log(path).rows if row.get("state") == SWIMS]
    whole = [row for row in rows if all(row.get(name) is not None for name in NEEDED)]
    if len(whole) < 2:
        lacking = [name for name in NEEDED if all(row.get(name) is None for row in rows)]
        what = f"no row has {lacking[0]}" if rows and lacking else f"{len(whole)} rows are complete"
        raise BadInput(
            f"{path}: {len(rows)} rows while its policy swims, but {what}; give a log of a swim"
            f" with camera, servo and yaw rate."
        )
    table = np.array([[row[name] for name in NEEDED] for row in whole], float)
    table = table[np.argsort(table[:, 0], kind="stable")]
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
        theirs = read_notes(path).get("policy_sha256", "unknown")
        if theirs != ours:
            raise BadInput(
                f"{path}: its policy_sha256 is {theirs[:12]}, that of {policy} is {ours[:12]}; give"
                f" the policy that swam."
            )


def check_same(paths: Sequence[Path]) -> None:
    """Raises BadInput if logs are of different fish, policies or calibrations."""
    first = read_notes(paths[0])
    for path in paths[1:]:
        notes = read_notes(path)
        for name in SAME:
            if name in first and name in notes and first[name] != notes[name]:
                raise BadInput(
                    f"{path}: its {name} is {notes[name]}, that of {paths[0]} is {first[name]};"
                    f" give logs of one fish, policy and calibration."
                )
