"""What is whole in a damaged log, and what is missing.

A log is a row of chunks of about 4 KiB, each with its own CRC-32 (MCAP specification). Wherever a
chunk begins, its length and checksum tell whether it is whole, so one that follows damage is found
by looking at every byte. A chunk that is damaged loses its rows, about 0.14 s. The summary at the
log's end, with a checksum of its own, tells how many rows were written, and when.
"""

import struct
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import median

from tailbeat.robot.log_rows import Row

MAGIC = b"\x89MCAP0\r\n"  # begins and ends an MCAP file
CHUNK, MESSAGE, STATISTICS = 0x06, 0x05, 0x0B  # opcodes
HEAD = struct.Struct("<BQQQQII")  # opcode, length, times, size, checksum, length of compression
PREFIX = struct.Struct("<BQ")  # opcode and length of every record
MESSAGE_HEAD = 22  # bytes of channel, sequence and two times before a message's data
BEGIN = MAGIC + b"\x01"  # of a log: its header follows
DATA_END, DATA_END_SIZE = PREFIX.pack(0x0F, 4), 13  # bytes; the summary follows
FOOTER, FOOTER_CRC = PREFIX.pack(0x02, 20), 25  # bytes before its checksum, which covers them too
COUNTS = struct.Struct("<QHIIIIQQ")  # rows, schemas, channels, three more counts, first and last
SECOND = 1_000_000_000
APART = 1.5  # of the usual time between two rows, from which rows are missing
ROUNDED = 1e-6  # s: less is rounding


@dataclass(frozen=True)
class Promise:
    """What a log's end says was written: how many rows, and the times of the first and last [s].
    `count` is None in a file that is not ours, where others count too."""

    count: int | None
    first: float
    last: float


@dataclass(frozen=True, eq=False)
class Part:
    """The rows of one log of a file, and what its end says; None: it has none that is whole."""

    rows: list[Row]
    promise: Promise | None


@dataclass(frozen=True)
class Gap:
    """Rows that are missing: from `at` [s] after the first row, `seconds` long; `at` is below 0
    where they came before it."""

    at: float
    seconds: float


# ---- bytes --------------------------------------------------------------------------------------


def split(data: bytes) -> list[bytes]:
    """The logs of a file, which may follow each other; the first may lack its begin."""
    found, at = [0], data.find(BEGIN, 1)
    while at >= 0:
        found.append(at)
        at = data.find(BEGIN, at + 1)
    return [data[a:b] for a, b in pairwise([*found, len(data)])]


def whole_messages(data: bytes) -> Iterator[bytes]:
    """The data of every message in a chunk that is whole, in the file's order. Chunks must not be
    compressed, as `robot.log` writes them."""
    at = data.find(CHUNK)
    while at >= 0:
        chunk = _chunk(data, at)
        if chunk is None:
            at = data.find(CHUNK, at + 1)
            continue
        records, end = chunk
        yield from (one[MESSAGE_HEAD:] for opcode, one in _records(records) if opcode == MESSAGE)
        at = data.find(CHUNK, end)


def _chunk(data: bytes, at: int) -> tuple[bytes, int] | None:
    """The records of a chunk that begins at a byte, and where it ends; None if there is none, or
    its checksum does not hold."""
    if at + HEAD.size + 8 > len(data):
        return None
    _, length, _, _, size, checksum, named = HEAD.unpack_from(data, at)
    first, end = at + HEAD.size + 8, at + PREFIX.size + length
    if named or size > len(data) or end != first + size or end > len(data):
        return None
    records = data[first:end]
    return (records, end) if zlib.crc32(records) == checksum else None


def _records(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Opcode and content of every record."""
    at = 0
    while at + PREFIX.size <= len(data):
        opcode, length = PREFIX.unpack_from(data, at)
        first, at = at + PREFIX.size, at + PREFIX.size + length
        yield opcode, data[first:at]


def promise(data: bytes) -> Promise | None:
    """What the end of a log says was written; None if it has no end whose checksum holds."""
    footer = data.rfind(FOOTER)
    begin = data.rfind(DATA_END, 0, max(footer, 0)) + DATA_END_SIZE
    end = footer + FOOTER_CRC
    if footer < 0 or begin < DATA_END_SIZE or end + 4 > len(data):
        return None
    checksum = int.from_bytes(data[end : end + 4], "little")
    if checksum not in (0, zlib.crc32(data[begin:end])):
        return None
    counts = [one for code, one in _records(data[begin:footer]) if code == STATISTICS]
    if not counts or len(counts[0]) < COUNTS.size:
        return Promise(None, 0.0, 0.0)
    rows, _, channels, _, _, _, first, last = COUNTS.unpack_from(counts[0])
    return Promise(rows if channels == 1 else None, first / SECOND, last / SECOND)


# ---- rows ---------------------------------------------------------------------------------------


def in_turn(parts: Sequence[Part]) -> list[Part]:
    """Logs that follow each other in time, in this order; of logs whose times overlap, that with
    the most rows alone."""
    timed = sorted((one for one in parts if _times(one)), key=lambda one: _times(one)[0])
    if all(_times(a)[-1] < _times(b)[0] for a, b in pairwise(timed)):
        return timed or list(parts[:1])
    return [max(timed, key=lambda one: len(one.rows))]


def missing(parts: Sequence[Part]) -> int | None:
    """How many rows are missing of those that were written; None where no end tells of them."""
    written = [one.promise.count if one.promise else None for one in parts]
    if None in written:
        return None
    here = [len(_times(one)) for one in parts]
    return sum(max((a or 0) - b, 0) for a, b in zip(written, here, strict=True))


def gaps(parts: Sequence[Part]) -> tuple[Gap, ...]:
    """Where rows are missing."""
    found = [gap for one in parts for gap in _holes(one)]
    first = min((_times(one)[0] for one in parts if _times(one)), default=0.0)
    return tuple(Gap(at - first, seconds) for at, seconds in found)


def _times(part: Part) -> list[float]:
    """The rows' times [s], rising, each once."""
    return sorted({row["time_s"] for row in part.rows if row["time_s"] is not None})


def _holes(part: Part) -> list[tuple[float, float]]:
    """Holes between a log's rows, before the first and after the last: the time of the row before,
    and how long [s]."""
    time, told = _times(part), part.promise
    if not time:
        return []
    lost = missing([part])
    lead, tail = (time[0] - told.first, told.last - time[-1]) if told and lost else (0.0, 0.0)
    elsewhere = not lost or max(lead, tail) > ROUNDED
    ends = [(time[0] - lead, lead), (time[-1], tail)]
    known = [one for one in ends if one[1] > ROUNDED]
    return sorted([*known, *_inner(part.rows, time, elsewhere)])


def _inner(rows: Sequence[Row], time: list[float], elsewhere: bool) -> list[tuple[float, float]]:
    """Holes between rows, without the loop's own pauses: periods that it missed, which its next row
    counts, and the time of arming. If these are all, and rows are not missing `elsewhere`, they
    are the holes."""
    steps = [(a, b - a) for a, b in pairwise(time)]
    usual = median(step for _, step in steps) if steps else 0.0
    holes = [(at, step - usual) for at, step in steps if step > APART * usual]
    row, after = {one["time_s"]: one for one in rows}, dict(pairwise(time))
    lost = [
        (at, long)
        for at, long in holes
        if not _paused(row[at], row[after[at]], round(long / usual))
    ]
    return lost if lost or elsewhere else holes


def _paused(before: Row, after: Row, periods: int) -> bool:
    """Whether the loop itself had no row for so many periods."""
    return (after.get("missed") or 0) >= periods or before.get("state") != after.get("state")
