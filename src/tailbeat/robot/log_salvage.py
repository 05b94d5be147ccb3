"""What is whole in a damaged log: the chunks whose checksums hold.

A log is a row of chunks of about 4 KiB, each with its own CRC-32 (MCAP specification). Wherever a
chunk begins, its length and checksum tell whether it is whole, so one that follows damage is found
by looking at every byte. A chunk that is damaged loses its rows, about 0.14 s.
"""

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

CHUNK, MESSAGE = 0x06, 0x05  # opcodes
HEAD = struct.Struct("<BQQQQII")  # opcode, length, times, size, checksum, length of compression
PREFIX = struct.Struct("<BQ")  # opcode and length of every record
MESSAGE_HEAD = 22  # bytes of channel, sequence and two times before a message's data


def whole_messages(path: Path) -> Iterator[bytes]:
    """The data of every message in a chunk that is whole, in the file's order. Chunks must not be
    compressed, as `robot.log` writes them."""
    data = path.read_bytes()
    at = data.find(CHUNK)
    while at >= 0:
        chunk = _chunk(data, at)
        if chunk is None:
            at = data.find(CHUNK, at + 1)
            continue
        records, end = chunk
        yield from _messages(records)
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


def _messages(records: bytes) -> Iterator[bytes]:
    at = 0
    while at + PREFIX.size <= len(records):
        opcode, length = PREFIX.unpack_from(records, at)
        first, at = at + PREFIX.size, at + PREFIX.size + length
        if opcode == MESSAGE:
            yield records[first + MESSAGE_HEAD : at]
