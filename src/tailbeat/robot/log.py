"""The log of a swim: one MCAP file, readable in Foxglove.

Rows are JSON with a schema. A thread writes them in small chunks, straight to the file: the loop
never waits, and a process that is killed loses only the last chunk. With a full queue or a full
disk, rows are dropped and counted; the loop decides what follows.
"""

import json
import math
import queue
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from mcap.reader import NonSeekingReader
from mcap.writer import CompressionType, Writer

from tailbeat import __version__
from tailbeat.files import BadInput, refuse_existing
from tailbeat.robot.log_salvage import whole_messages

CHUNK = 4096  # bytes, about 0.14 s of rows: the most that is lost
WAITING = 500  # rows, ten seconds
RECORD = 1 << 24  # bytes: a longer record is damage
MAGIC = b"\x89MCAP0\r\n"  # begins and ends an MCAP file
TOPIC, NOTES = "/swim", "tailbeat"
SECOND = 1_000_000_000
# Fields of a row. A number that is not finite is left out of its row.
NUMBERS = {
    "time_s": "when the period was due, monotonic clock [s]",
    "command_rad": "setpoint that the servo was sent last [rad]",
    "setpoint_rad": "setpoint of the policy, before limits; while it swims [rad]",
    "motor_angle_rad": "shaft angle that the servo measured [rad]",
    "motor_velocity_rad_s": "shaft speed that the servo measured [rad/s]",
    "yaw_rate_rad_s": "yaw rate of IMU or camera, counter-clockwise positive [rad/s]",
    "x_m": "newest accepted pose: x in the pool [m]",
    "y_m": "newest accepted pose: y in the pool [m]",
    "yaw_rad": "newest accepted pose: heading, counter-clockwise from x [rad]",
    "pose_age_s": "time since the newest pose was captured [s]",
    "clock_doubt_s": "largest error of the clock offset [s]",
    "temperature_deg_c": "servo temperature [deg C]",
    "voltage_v": "supply at the servo, median of half a second [V]",
    "current_a": "mean servo current [A]",
    "band_share": "fraction of the tail's power below the band's upper edge",
    "below_band_share": "fraction of the tail's power below the band's lower edge",
    "late_s": "how late the period began [s]",
    "busy_s": "time from the start of the period to its row [s]",
    "compute_s": "processor time of the loop's thread in the period [s]",
    "missed": "periods missed within the last second",
    "spikes": "yaw rates rejected since the start",
    "pose_jumps": "implausible poses in a row",
    "signal_turning": "the camera's turning minus the IMU's, over 2 s [rad/s]",
    "signal_drifting": "the same over 2.5 s, minus the time before [rad/s]",
    "signal_stroke": "motor angle over the one that its setpoints lead to",
    "signal_recoil": "yaw rate over the one that the motor angle leads to",
    "signal_progress": "speed over the rms of the motor velocity [m]",
    "signal_same": "equal poses in a row",
    "signal_wander": "path of the target within 1 s, without its displacement [m]",
    "signal_course": "direction in which the tag moves over 1 s, minus its heading [rad]",
}
ARRAYS = {
    "observation": "24 inputs of the policy, scaled; empty while it does not swim",
    "action": "outputs of the policy; empty while it does not swim",
    "decided_on": "three newest frames, newest first, each x, y, yaw, target x, target y, age"
    " [m, m, rad, m, m, s]; empty while the policy does not swim",
}
TEXTS = {
    "state": "disarmed, armed, test, run, hold or stop",
    "reason": "why it is in this state, as the operator reads it",
    "cause": "the reason's name",
}
# Columns of a recording that identification reads; see `log_export`.
COLUMNS = ("command_rad", "motor_angle_rad", "yaw_rate_rad_s", "x_m", "y_m", "yaw_rad")


def schema() -> dict[str, Any]:
    """JSON schema of a row, as Foxglove reads it: one type for each field, and no `null` (its
    parser refuses a list of types, and with it the whole topic)."""
    number, text = {"type": "number"}, {"type": "string"}
    listed = {"type": "array", "items": number}
    kinds = ((NUMBERS, number), (ARRAYS, listed), (TEXTS, text))
    fields = {n: {**kind, "description": d} for names, kind in kinds for n, d in names.items()}
    base = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "tailbeat.Row"}
    return {**base, "type": "object", "properties": fields, "additionalProperties": False}


@dataclass(eq=False)
class Log:
    """An open log; see `start`. `put` never waits. `dropped` counts rows that were not written.
    `failed` says why writing ended, or is ""."""

    path: Path
    file: BinaryIO
    waiting: "queue.Queue[Mapping[str, Any] | None]"
    thread: threading.Thread | None = None
    dropped: int = 0
    failed: str = ""
    last_notes: dict[str, str] = field(default_factory=dict)

    def put(self, row: Mapping[str, Any]) -> None:
        """Queue a row for writing; `time_s` is the loop's monotonic time."""
        try:
            self.waiting.put_nowait(row)
        except queue.Full:
            self.dropped += 1

    @property
    def healthy(self) -> bool:
        """Whether every row so far is written, or will be."""
        alive = self.thread is not None and self.thread.is_alive()
        return alive and not self.failed and not self.dropped

    def close(self) -> None:
        """Write the queued rows, `last_notes` and the end of the file."""
        self.waiting.put(None)
        if self.thread is not None:
            self.thread.join(10)
        self.file.close()


def start(path: Path, notes: Mapping[str, str]) -> Log:
    """Open a new log; `notes` (policy, fish, configuration) are written at its start. Raises
    BadInput."""
    refuse_existing(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = path.open("wb", buffering=0)
    except OSError as error:
        raise BadInput(f"{path}: {error.strerror}; choose a folder you can write to.") from None
    log = Log(path, file, queue.Queue(WAITING))
    log.thread = threading.Thread(target=_write, args=(log, dict(notes)), daemon=True)
    log.thread.start()
    return log


def _write(log: Log, notes: dict[str, str]) -> None:
    """The writer's thread."""
    try:
        writer = Writer(log.file, chunk_size=CHUNK, compression=CompressionType.NONE)
        writer.start(profile="", library=f"tailbeat {__version__}")
        writer.add_metadata(NOTES, notes)
        kind = writer.register_schema("tailbeat.Row", "jsonschema", json.dumps(schema()).encode())
        channel = writer.register_channel(TOPIC, "json", kind)
        while (row := log.waiting.get()) is not None:
            at = round(row["time_s"] * SECOND)
            writer.add_message(channel, at, _text(row).encode(), at)
        if log.last_notes:
            writer.add_metadata(NOTES, log.last_notes)
        writer.finish()
    except Exception as error:  # a full disk, a closed file, or a row that is none: none is silent
        log.failed = str(error) or type(error).__name__
        while log.waiting.get() is not None:
            log.dropped += 1


def _text(row: Mapping[str, Any]) -> str:
    plain = {name: _plain(value) for name, value in row.items()}
    return json.dumps({name: value for name, value in plain.items() if value is not None})


def _plain(value: Any) -> Any:
    """Convert numpy arrays to lists and numbers that are not finite to None: JSON has neither."""
    if isinstance(value, np.ndarray):
        value = value.ravel().tolist()
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value


# ---- reading ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Gap:
    """Rows that are missing: from `at` [s] after the first row, `seconds` long."""

    at: float
    seconds: float


@dataclass(frozen=True, eq=False)
class Swim:
    """The rows of a log. `damaged`: its bytes are not what was written, and `gaps` say where rows
    are missing. `whole`: it has its end mark; the log of a process that was killed has none."""

    rows: list[dict[str, Any]]
    damaged: bool
    whole: bool
    gaps: tuple[Gap, ...] = ()


def read_log(path: Path) -> Swim:
    """Every undamaged row of a log, even if its writer was killed. A number that a row lacks is
    None. Raises BadInput."""
    if not path.is_file():
        raise BadInput(f"{path}: no such file; give a log, .mcap.")
    texts, well = _texts(path)
    absent = dict.fromkeys(NUMBERS)
    rows = [{**absent, **_row(path, text)} for text in texts]
    if not rows:
        raise BadInput(f"{path}: no row of a swim in this file; give a log of `tailbeat drive`.")
    whole, gaps = is_whole(path), () if well else _gaps(rows)
    return Swim(rows, bool(gaps) or (whole and not well), whole, gaps)


def read_rows(path: Path) -> list[dict[str, Any]]:
    """The rows of `read_log`. Raises BadInput."""
    return read_log(path).rows


def _texts(path: Path) -> tuple[list[bytes], bool]:
    """The messages, and whether all is well; else those of the whole chunks."""
    try:
        with path.open("rb") as file:
            reader = NonSeekingReader(file, validate_crcs=True, record_size_limit=RECORD)
            messages = reader.iter_messages(log_time_order=False)
            return [one.data for _, channel, one in messages if channel.topic == TOPIC], True
    except Exception:  # damaged bytes make a reader raise whatever they like
        return list(whole_messages(path)), False


def _gaps(rows: list[dict[str, Any]]) -> tuple[Gap, ...]:
    """Where rows of a damaged log are missing."""
    time = np.array([row["time_s"] for row in rows if row["time_s"] is not None])
    away = np.diff(time)
    usual = float(np.median(away)) if away.size else 0.0
    return tuple(
        Gap(float(time[k] - time[0]), float(away[k] - usual))
        for k in np.flatnonzero(away > 1.5 * usual)
    )


def _row(path: Path, text: bytes) -> dict[str, Any]:
    try:
        row = json.loads(text)
    except ValueError:
        row = None
    if not isinstance(row, dict):
        raise BadInput(
            f"{path}: a message of {TOPIC} is not a JSON object; give a log of tailbeat."
        )
    return row


def is_whole(path: Path) -> bool:
    """Whether a log is complete. The log of a process that was killed has no end mark."""
    with path.open("rb") as file:
        file.seek(max(path.stat().st_size - len(MAGIC), 0))
        return file.read() == MAGIC
