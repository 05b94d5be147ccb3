"""The log of a swim: one MCAP file, readable in Foxglove.

Rows are JSON with a schema. A thread writes them in small chunks, straight to the file: the loop
never waits, and a process that is killed loses only the last chunk. With a full queue or a full
disk, rows are dropped and counted; the loop decides what follows.
"""

import contextlib
import json
import math
import queue
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import count, pairwise
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from mcap.reader import NonSeekingReader
from mcap.writer import CompressionType, Writer

from tailbeat import __version__
from tailbeat.files import BadInput, refuse_existing
from tailbeat.robot.log_rows import TOPIC, read_row, schema
from tailbeat.robot.log_salvage import (
    MAGIC,
    Gap,
    Part,
    gaps,
    in_turn,
    missing,
    promise,
    split,
    whole_messages,
)

CHUNK = 4096  # bytes, about 0.14 s of rows: the most that is lost
WAITING = 500  # rows, ten seconds
BEHIND = 25  # rows, half a second: with more, the writer hangs or is too slow
PATIENCE = 10.0  # s for the queued rows to be written at the end
RECORD = 1 << 24  # bytes: a longer record is damage
NOTES = "tailbeat"
SECOND = 1_000_000_000
# Columns of a recording that identification reads; see `log_export`.
COLUMNS = ("command_rad", "motor_angle_rad", "yaw_rate_rad_s", "x_m", "y_m", "yaw_rad")


@dataclass(frozen=True)
class Note:
    """What the head of a log tells under a name."""

    name: str
    text: str


@dataclass(eq=False)
class Log:
    """An open log; see `start`. `put` and `note` never wait. `dropped` counts rows that were not
    written. `failed` says why writing ended, or is ""."""

    path: Path
    file: BinaryIO
    waiting: "queue.Queue[Mapping[str, Any] | Note | None]"
    thread: threading.Thread | None = None
    dropped: int = 0
    failed: str = ""
    last_notes: dict[str, str] = field(default_factory=dict)

    def put(self, row: Mapping[str, Any]) -> None:
        """Queue a row for writing; `time_s` is the loop's monotonic time."""
        self._queue(row)

    def note(self, name: str, text: str) -> None:
        """Queue what became known after the start; it replaces a note of that name."""
        self._queue(Note(name, text))

    def _queue(self, one: Mapping[str, Any] | Note) -> None:
        try:
            self.waiting.put_nowait(one)
        except queue.Full:
            self.dropped += 1

    @property
    def healthy(self) -> bool:
        """Whether every row so far is written, or will be within half a second."""
        on_time = self.alive and self.waiting.qsize() <= BEHIND
        return on_time and not self.failed and not self.dropped

    @property
    def alive(self) -> bool:
        """Whether the writer's thread runs."""
        return self.thread is not None and self.thread.is_alive()

    def close(self) -> None:
        """Write the queued rows, `last_notes` and the end of the file; `failed` says if the writer
        does not get there."""
        end = time.monotonic() + (PATIENCE if self.alive else 0.0)
        try:
            self.waiting.put(None, timeout=max(end - time.monotonic(), 0.0))
        except queue.Full:
            self.dropped += self.waiting.qsize()
        if self.thread is not None:
            self.thread.join(max(end - time.monotonic(), 0.0))
        if self.alive:
            self.failed = self.failed or f"its writer did not end within {PATIENCE:g} s"
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
        while (one := log.waiting.get()) is not None:
            _write_one(writer, channel, one)
        if log.last_notes:
            writer.add_metadata(NOTES, log.last_notes)
        writer.finish()
    except Exception as error:  # a full disk, a closed file, or a row that is none: none is silent
        log.failed = str(error) or type(error).__name__
        while log.waiting.get() is not None:
            log.dropped += 1


def _write_one(writer: Writer, channel: int, one: Mapping[str, Any] | Note) -> None:
    if isinstance(one, Note):
        writer.add_metadata(NOTES, {one.name: one.text})
        return
    at = round(one["time_s"] * SECOND)
    writer.add_message(channel, at, _text(one).encode(), at)


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


@dataclass(frozen=True, eq=False)
class Swim:
    """The rows of a log, in the file's order.

    `damaged`: its bytes are not what was written; `gaps` say where rows are missing. `whole`: it
    has its end; the log of a process that was killed has none. `lost`: how many of the rows that
    its end counts are missing; None where no end counts them. `logs`: how many are in the file, one
    after the other, of which `left_out` are not read, because their times overlap with the longest.
    `twice`: rows whose time is there already; `sorted`: whether time rises.
    """

    rows: list[dict[str, Any]]
    damaged: bool
    whole: bool
    gaps: tuple[Gap, ...] = ()
    lost: int | None = None
    logs: int = 1
    left_out: int = 0
    twice: int = 0
    sorted: bool = True


def read_log(path: Path) -> Swim:
    """Every undamaged row of a log, even if its writer was killed. A number that a row lacks is
    None. Raises BadInput."""
    if not path.is_file():
        raise BadInput(f"{path}: no such file; give a log, .mcap.")
    data = path.read_bytes()
    texts, well = _texts(path)
    parts = split(data)
    read = [texts] if well and len(parts) == 1 else [[*whole_messages(one)] for one in parts]
    number = count()
    found = [
        Part([read_row(path, next(number), text) for text in texts], promise(one))
        for one, texts in zip(parts, read, strict=True)
    ]
    kept = in_turn([one for one in found if one.rows])
    rows = [row for one in kept for row in one.rows]
    if not rows:
        raise BadInput(f"{path}: no row of a swim in this file; give a log of `tailbeat drive`.")
    where, lost = gaps(kept), missing(kept)
    whole = is_whole(path) or kept[-1].promise is not None
    well = well and all(one.promise for one in found)
    times = [row["time_s"] for row in rows if row["time_s"] is not None]
    twice, rises = len(times) - len(set(times)), all(a <= b for a, b in pairwise(times))
    return Swim(
        rows,
        damaged=bool(where or lost or twice) or not rises or (whole and not well),
        whole=whole,
        gaps=where,
        lost=lost,
        logs=len(found),
        left_out=sum(bool(one.rows) for one in found) - len(kept),
        twice=twice,
        sorted=rises,
    )


def read_rows(path: Path) -> list[dict[str, Any]]:
    """The rows of `read_log`. Raises BadInput."""
    return read_log(path).rows


def _texts(path: Path) -> tuple[list[bytes], bool]:
    """The messages of the first log of a file, and whether all is well; without them if not."""
    try:
        with path.open("rb") as file:
            reader = NonSeekingReader(file, validate_crcs=True, record_size_limit=RECORD)
            messages = reader.iter_messages(log_time_order=False)
            return [one.data for _, channel, one in messages if channel.topic == TOPIC], True
    except Exception:  # damaged bytes make a reader raise whatever they like
        return [], False


def read_notes(path: Path) -> dict[str, str]:
    """What the head of a log tells, as far as it is whole: date, policy, versions; the last note of
    a name counts."""
    found: dict[str, str] = {}
    with contextlib.suppress(Exception), path.open("rb") as file:  # as in `_texts`
        for one in NonSeekingReader(file, record_size_limit=RECORD).iter_metadata():
            found |= one.metadata if one.name == NOTES else {}
    return found


def is_whole(path: Path) -> bool:
    """Whether a log is complete. The log of a process that was killed has no end mark."""
    with path.open("rb") as file:
        file.seek(max(path.stat().st_size - len(MAGIC), 0))
        return file.read() == MAGIC
