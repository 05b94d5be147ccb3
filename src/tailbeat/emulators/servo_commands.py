"""The instructions of Protocol 2.0, answered by one emulated servo alone on its line."""

import struct
from collections.abc import Callable
from typing import Protocol

from tailbeat.emulators.packet import fast_status, status
from tailbeat.emulators.servo_table import FIRMWARE, INSTRUCTION, LENGTH, RANGE, Table

PING, READ, WRITE, REG_WRITE, ACTION, FACTORY, REBOOT = 0x01, 0x02, 0x03, 0x04, 0x05, 0x06, 0x08
CLEAR, BACKUP, SYNC_READ, SYNC_WRITE, FAST_SYNC = 0x10, 0x20, 0x82, 0x83, 0x8A
BULK_READ, BULK_WRITE, FAST_BULK = 0x92, 0x93, 0x9A
ALL = 0xFE  # the broadcast id
ALERT = 0x80
CLEAR_TURNS, KEEP = b"\x01\x44\x58\x4c\x22", b"\x43\x54\x52\x4c"  # what the manual asks for
Error = int
Answer = tuple[Error, bytes]


class Servo(Protocol):
    """What the instructions act on."""

    table: Table
    registered: bytes

    def reboot(self) -> None:
        """Restart."""


def execute(servo: Servo, ident: int, instruction: int, body: bytes) -> bytes:
    """The status packet that answers an instruction; b"" where the servo says nothing."""
    table = servo.table
    own, level = table.get(7), table.get(68)
    if instruction == PING:
        return _said(table, 0, struct.pack("<HB", table.get(0), FIRMWARE))
    if instruction in (SYNC_READ, FAST_SYNC, BULK_READ, FAST_BULK):
        return _many(table, instruction, body) if level else b""
    if instruction in (SYNC_WRITE, BULK_WRITE):
        for part in _parts(instruction, own, body):
            table.write(*part)
        return b""
    error, data = _single(servo, instruction, body)
    wanted = level == 2 or (level == 1 and instruction == READ)
    return _said(table, error, data) if ident != ALL and wanted else b""


def _said(table: Table, error: Error, data: bytes) -> bytes:
    return status(table.get(7), _with_alert(table, error), data)


def _with_alert(table: Table, error: Error) -> int:
    return error | (ALERT if table.get(70) else 0)


# ---- one servo ----------------------------------------------------------------------------------


def _single(servo: Servo, instruction: int, body: bytes) -> Answer:
    known = SINGLE.get(instruction)
    return (INSTRUCTION, b"") if known is None else known(servo, body)


def _read(servo: Servo, body: bytes) -> Answer:
    return servo.table.read(*struct.unpack("<HH", body)) if len(body) == 4 else (LENGTH, b"")


def _write(servo: Servo, body: bytes) -> Answer:
    if len(body) < 3:
        return LENGTH, b""
    return servo.table.write(struct.unpack_from("<H", body)[0], body[2:]), b""


def _register(servo: Servo, body: bytes) -> Answer:
    servo.registered = body
    servo.table.put(69, 1)
    return 0, b""


def _act(servo: Servo, body: bytes) -> Answer:
    held, servo.registered = servo.registered, b""
    servo.table.put(69, 0)
    return _write(servo, held) if held else (0, b"")


def _reboot(servo: Servo, body: bytes) -> Answer:
    servo.reboot()
    return 0, b""


def _to_factory(servo: Servo, body: bytes) -> Answer:
    """0xFF: all; 1: all but the id; 2: all but id and baud rate."""
    kept = {b"\xff": frozenset[int](), b"\x01": frozenset({7}), b"\x02": frozenset({7, 8})}
    if body not in kept:
        return RANGE, b""
    servo.table.factory(0, kept[body])
    return 0, b""


def _clear(servo: Servo, body: bytes) -> Answer:
    """The multi-turn position: this servo counts none beyond its encoder's."""
    return (0 if body == CLEAR_TURNS else RANGE), b""


def _backup(servo: Servo, body: bytes) -> Answer:
    return (0 if body[1:] == KEEP and body[0] in (1, 2) else RANGE), b""


SINGLE: dict[int, Callable[[Servo, bytes], Answer]] = {
    READ: _read,
    WRITE: _write,
    REG_WRITE: _register,
    ACTION: _act,
    FACTORY: _to_factory,
    REBOOT: _reboot,
    CLEAR: _clear,
    BACKUP: _backup,
}


# ---- many at once -------------------------------------------------------------------------------


def _many(table: Table, instruction: int, body: bytes) -> bytes:
    """The answer to a read of many servos. Each waits for the one before it in the list, so a servo
    alone on its line answers only if it is the first."""
    own = table.get(7)
    if instruction in (SYNC_READ, FAST_SYNC):
        asked = struct.unpack("<HH", body[:4]) if len(body) > 4 and body[4] == own else None
    else:
        asked = struct.unpack("<HH", body[1:5]) if len(body) >= 5 and body[0] == own else None
    if asked is None:
        return b""
    error, data = table.read(*asked)
    if instruction in (SYNC_READ, BULK_READ):
        return _said(table, error, data)
    return fast_status(own, _with_alert(table, error), data)


def _parts(instruction: int, own: int, body: bytes) -> list[tuple[int, bytes]]:
    """Address and bytes for this servo in a write to many; nothing from a packet that is cut
    short."""
    found = []
    if instruction == SYNC_WRITE and len(body) > 4:
        address, length = struct.unpack_from("<HH", body)
        for first in range(4, len(body), length + 1):
            data = body[first + 1 : first + 1 + length]
            if body[first] == own and len(data) == length:
                found.append((address, data))
    at = 0
    while instruction == BULK_WRITE and at + 5 <= len(body):
        ident, address, length = struct.unpack_from("<BHH", body, at)
        data = body[at + 5 : at + 5 + length]
        if ident == own and len(data) == length:
            found.append((address, data))
        at += 5 + length
    return found
