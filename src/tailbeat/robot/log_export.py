"""Turn a robot's log into a recording. This happens on the station: the robot
does not install polars.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tailbeat.files import BadInput, refuse_existing
from tailbeat.recording import Recording, write_recording
from tailbeat.robot.log import COLUMNS, Swim, read_log, read_rows

GAPS = 5  # of which a sentence tells the times


def as_recording(path: Path) -> Recording:
    """Convert a log to a recording that `identify` reads: the rows that have all of `COLUMNS`.
    Raises BadInput."""
    return _recording(path, read_rows(path))


def _recording(path: Path, rows: list[dict[str, Any]]) -> Recording:
    whole = [row for row in rows if all(row.get(c) is not None for c in COLUMNS)]
    if len(whole) < 2:
        raise BadInput(f"{path}: {len(whole)} complete rows; a recording needs at least 2.")
    time = np.array([row["time_s"] for row in whole])
    columns = {name: np.array([row[name] for row in whole]) for name in COLUMNS}
    return Recording(path.stem, time - time[0], columns, {"source": "tailbeat drive"})


def export(log: Path, out: Path) -> tuple[Recording, Swim]:
    """Write a log as a recording, CSV or Parquet; returns it, and the log. Raises BadInput."""
    refuse_existing(out)
    swim = read_log(log)
    recording = replace(_recording(log, swim.rows), name=out.stem)
    write_recording(recording, out)
    return recording, swim


def losses(swim: Swim) -> list[str]:
    """What a log lacks, a sentence each."""
    said = []
    if not swim.whole:
        said.append("the log has no end: its process was killed, or the file was cut off")
    if swim.damaged:
        lost = sum(gap.seconds for gap in swim.gaps)
        where = ", ".join(f"{gap.at:.2f} s" for gap in swim.gaps[:GAPS])
        more = f" and {len(swim.gaps) - GAPS} more" if len(swim.gaps) > GAPS else ""
        at = f", after {where}{more}" if swim.gaps else ""
        said.append(f"the file is damaged: {lost:.2f} s of rows are missing{at}")
    return said
