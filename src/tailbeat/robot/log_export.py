"""Turn a robot's log into a recording. This happens on the station: the robot
does not install polars.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tailbeat.files import BadInput, refuse_existing
from tailbeat.recording import Recording, write_recording
from tailbeat.robot.log import COLUMNS, Swim, read_log, read_notes, read_rows
from tailbeat.robot.log_rows import NOTED

LONGEST = 300  # letters of a note


def as_recording(path: Path) -> Recording:
    """Convert a log to a recording that `identify` reads: the rows that have all of `COLUMNS`.
    Raises BadInput."""
    return _recording(path, read_rows(path))


def _recording(path: Path, rows: list[dict[str, Any]]) -> Recording:
    """The complete rows in the order of their times, each time once."""
    needed = ("time_s", *COLUMNS)
    whole = {row["time_s"]: row for row in rows if all(row.get(c) is not None for c in needed)}
    if len(whole) < 2:
        raise BadInput(f"{path}: {len(whole)} complete rows; a recording needs at least 2.")
    time = np.array(sorted(whole), dtype=np.float64)
    columns = {name: np.array([whole[at][name] for at in time], float) for name in COLUMNS}
    return Recording(path.stem, time - time[0], columns, _meta(path))


def _meta(path: Path) -> dict[str, str]:
    """Where a recording comes from, with what its log tells of policy, fish and versions."""
    notes = read_notes(path)
    told = {name: " ".join(notes[name].split())[:LONGEST] for name in NOTED if name in notes}
    return {"source": "tailbeat drive", **told}


def export(log: Path, out: Path) -> tuple[Recording, Swim]:
    """Write a log as a recording, CSV or Parquet; returns it, and the log. Raises BadInput."""
    refuse_existing(out)
    swim = read_log(log)
    recording = replace(_recording(log, swim.rows), name=out.stem)
    write_recording(recording, out)
    return recording, swim
