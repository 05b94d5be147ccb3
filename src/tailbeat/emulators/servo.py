"""An emulated X-series servo on a pseudo-terminal: control table, packets, faults, a turning shaft.

The table is the XW430-T200's; model number, supply, limits and gain are those of the fish's
hardware. Its packets have their own encoder and parser (`packet`). Both these and the driver's are
tested with the maker's vectors, and the emulator with the maker's library. What the manual leaves
open was not checked on a real servo.
"""

import os
import select
import struct
import termios
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from tailbeat.emulators.line import Line
from tailbeat.emulators.packet import status, take
from tailbeat.fish.description import Hardware

MODEL, FIRMWARE = 1280, 45
UNIT_V = 0.02398  # rad/s
TICK, WATCHDOG = 1e-3, 0.020  # s
NO_LOAD = 5.55  # rad/s at 12 V
STEPS = 4096
# address: (bytes, default); EEPROM lies below 64
REGISTERS = {
    0: (2, MODEL), 2: (4, 0), 6: (1, FIRMWARE), 7: (1, 1), 8: (1, 3), 9: (1, 250), 10: (1, 0),
    11: (1, 3), 12: (1, 255), 13: (1, 2), 20: (4, 0), 24: (4, 10), 31: (1, 80), 32: (2, 160),
    34: (2, 95), 36: (2, 885), 38: (2, 2047), 44: (4, 235), 48: (4, 4095), 52: (4, 0), 60: (1, 0),
    63: (1, 52), 64: (1, 0), 65: (1, 0), 68: (1, 2), 69: (1, 0), 70: (1, 0), 76: (2, 1920),
    78: (2, 100), 80: (2, 0), 82: (2, 0), 84: (2, 900), 88: (2, 0), 90: (2, 0), 98: (1, 0),
    100: (2, 885), 102: (2, 2047), 104: (4, 235), 108: (4, 0), 112: (4, 0), 116: (4, 2048),
    120: (2, 0), 122: (1, 0), 123: (1, 0), 124: (2, 0), 126: (2, 0), 128: (4, 0), 132: (4, 2048),
    136: (4, 0), 140: (4, 2048), 144: (2, 120), 146: (1, 30), 147: (1, 1),
}  # fmt: skip
READ_ONLY = {0, 2, 6, 69, 70, 120, 122, 123, 124, 126, 128, 132, 136, 140, 144, 146, 147}
RAM, GOALS = 64, range(100, 120)
SPEEDS = {
    0: termios.B9600, 1: termios.B57600, 2: termios.B115200, 3: termios.B1000000,
    4: termios.B2000000, 5: termios.B3000000, 6: termios.B4000000,
}  # fmt: skip
FAIL, INSTRUCTION, RANGE, LIMIT, ACCESS = 1, 2, 4, 6, 7
ALERT = 0x80


# ---- the device ---------------------------------------------------------------------------------


@dataclass
class Shaft:
    """A shaft without a plant: speed proportional to the error, at most the no-load speed."""

    angle: float = 0.0
    velocity: float = 0.0
    stiffness: float = 25.0  # 1/s

    def advance(self, goal: float | None, dt: float) -> None:
        """Turn for `dt` [s] towards a goal [rad]; with None (no torque) it stays."""
        wanted = 0.0 if goal is None else self.stiffness * (goal - self.angle)
        self.velocity = max(-NO_LOAD, min(NO_LOAD, wanted))
        self.angle += self.velocity * dt


@dataclass
class Faults:
    """Faults: `mute` replies to drop, `corrupt` replies to damage, `garbage` before a reply, `late`
    [s] for the next reply, `slow` [s] for every reply, `frozen` encoder."""

    mute: int = 0
    corrupt: int = 0
    garbage: bytes = b""
    late: float = 0.0
    slow: float = 0.0
    frozen: bool = False


@dataclass(eq=False)
class Dynamixel:
    """The servo with its control table; `answer` handles bytes, `advance` steps time."""

    shaft: Shaft = field(default_factory=Shaft)
    faults: Faults = field(default_factory=Faults)
    hardware: Hardware | None = None  # None: an XW430-T200 at 12 V
    table: bytearray = field(default_factory=lambda: bytearray(256))
    stream: bytearray = field(default_factory=bytearray)
    registered: bytes = b""
    quiet_until: float = 0.0  # while it restarts
    heard: float = 0.0  # time of the last packet
    now: float = 0.0

    def __post_init__(self) -> None:
        _fresh(self.table, 0, self.hardware)

    def get(self, address: int, signed: bool = False) -> int:
        """Read a register."""
        size = REGISTERS[address][0]
        return int.from_bytes(self.table[address : address + size], "little", signed=signed)

    def put(self, address: int, value: int) -> None:
        """Set a register, also a read-only one."""
        size = REGISTERS[address][0]
        self.table[address : address + size] = (value % (1 << 8 * size)).to_bytes(size, "little")

    # ---- time -----------------------------------------------------------------------------------

    def advance(self, now: float) -> None:
        """Step to time `now` [s]: turn the shaft, check the bus watchdog, update the readings."""
        dt, self.now = max(now - self.now, 0.0), now
        limit = self.get(98)
        if self.get(64) and 0 < limit < 128 and now - self.heard > limit * WATCHDOG:
            self.trip()
        goal = (self.get(116, True) - 2048) * 2 * 3.141592653589793 / STEPS
        while dt > 0:
            self.shaft.advance(goal if self.get(64) else None, min(dt, TICK))
            dt -= TICK
        self.put(120, int(now * 1e3) % 32768)
        if not self.faults.frozen:
            self.put(132, self._counts())
            self.put(128, round(self.shaft.velocity / UNIT_V))

    def _counts(self) -> int:
        return 2048 + round(self.shaft.angle * STEPS / (2 * 3.141592653589793))

    def trip(self) -> None:
        """Trip the bus watchdog: the servo stops where it is and refuses goals until 0 is written
        to it."""
        self.put(98, 0xFF)
        self.put(116, self._counts())

    def fail(self, bit: int) -> None:
        """Set a hardware error; torque goes off if it is in the shutdown mask."""
        self.put(70, self.get(70) | 1 << bit)
        if self.get(63) >> bit & 1:
            self.put(64, 0)

    def reboot(self) -> None:
        """Restart: RAM as at power-up; no replies for a tenth of a second."""
        _fresh(self.table, RAM, self.hardware)
        self.quiet_until = self.now + 0.1

    # ---- packets --------------------------------------------------------------------------------

    def answer(self, data: bytes) -> bytes:
        """Bytes in, bytes out."""
        if self.now < self.quiet_until:
            return b""
        self.stream += data
        out = b""
        while (packet := take(self.stream)) is not None:
            if packet[0] in (self.get(7), 0xFE):
                self.heard = self.now
                out += self._spoilt(self._execute(*packet))
        return out

    def _execute(self, ident: int, instruction: int, body: bytes) -> bytes:
        own, level = self.get(7), self.get(68)
        if instruction == 0x01:
            return self._status(0, struct.pack("<HB", self.get(0), FIRMWARE))
        if instruction == 0x82:
            address, length = struct.unpack_from("<HH", body)
            error, data = self._read(address, length)
            return self._status(error, data) if own in body[4:] else b""
        if instruction == 0x83:
            self._sync_write(body)
            return b""
        error, data = self._single(instruction, body)
        wanted = level == 2 or (level == 1 and instruction == 0x02)
        return self._status(error, data) if ident != 0xFE and wanted else b""

    def _single(self, instruction: int, body: bytes) -> tuple[int, bytes]:
        if instruction == 0x02 and len(body) == 4:
            return self._read(*struct.unpack("<HH", body))
        if instruction == 0x03 and len(body) > 2:
            return self._write(struct.unpack_from("<H", body)[0], body[2:]), b""
        if instruction == 0x04:
            self.registered = body
            self.put(69, 1)
            return 0, b""
        if instruction == 0x05 and self.registered:
            body, self.registered = self.registered, b""
            self.put(69, 0)
            return self._write(struct.unpack_from("<H", body)[0], body[2:]), b""
        if instruction == 0x08:
            self.reboot()
            return 0, b""
        return INSTRUCTION, b""

    def _read(self, address: int, length: int) -> tuple[int, bytes]:
        if address + length > 148 or not length:
            return ACCESS, b""
        return 0, bytes(self.table[address : address + length])

    def _sync_write(self, body: bytes) -> None:
        address, length = struct.unpack_from("<HH", body)
        for first in range(4, len(body), length + 1):
            if body[first] == self.get(7):
                self._write(address, body[first + 1 : first + 1 + length])

    def _write(self, address: int, data: bytes) -> int:
        error = self._refusal(address, data)
        if error:
            return error
        self.table[address : address + len(data)] = data
        return 0

    def _refusal(self, address: int, data: bytes) -> int:
        """The error number of a write, 0 if it is allowed."""
        if address not in REGISTERS or address in READ_ONLY:
            return ACCESS
        if address < RAM and self.get(64):
            return ACCESS
        if address in GOALS and self.get(98) == 0xFF:
            return RANGE
        value = int.from_bytes(data, "little", signed=True)
        if address == 116 and not self.get(52) <= value <= self.get(48):
            return LIMIT
        if address == 64 and value and self.get(70) & self.get(63):
            return FAIL  # after a shutdown, only a reboot clears it
        return RANGE if address == 98 and not 0 <= value <= 127 else 0

    def _status(self, error: int, data: bytes) -> bytes:
        return status(self.get(7), error | (ALERT if self.get(70) else 0), data)

    def _spoilt(self, reply: bytes) -> bytes:
        faults = self.faults
        if not reply:
            return b""
        if faults.mute > 0:
            faults.mute -= 1
            return b""
        if faults.corrupt > 0:
            faults.corrupt -= 1
            reply = reply[:-3] + bytes([reply[-3] ^ 0x40]) + reply[-2:]
        garbage, faults.garbage = faults.garbage, b""
        return garbage + reply


def _fresh(table: bytearray, first: int, hardware: Hardware | None) -> None:
    """Write factory values from address `first` on; a fish's own servo differs in a few."""
    own = {} if hardware is None else _own(hardware)
    for address, (size, usual) in REGISTERS.items():
        if address >= first:
            value = own.get(address, usual)
            table[address : address + size] = value.to_bytes(size, "little")


def _own(hardware: Hardware) -> dict[int, int]:
    """Registers of a servo that differ from the table above: model, temperature's and supply's
    limits, gain, present supply."""
    low, high = hardware.supply_range
    return {
        0: hardware.number,
        31: round(hardware.temperature_limit),
        32: round(10 * high),
        34: round(10 * low),
        84: hardware.gain,
        144: round(10 * hardware.supply),
    }


# ---- the pseudo-terminal ------------------------------------------------------------------------


def hears(device: Dynamixel, line: Line) -> bool:
    """Whether the driver's end of the line has the servo's baud rate; otherwise it receives
    noise."""
    return termios.tcgetattr(line.slave)[5] == SPEEDS.get(device.get(8))


def serve(device: Dynamixel, line: Line, stop: Callable[[], bool], baud: int = 1_000_000) -> None:
    """Answer until `stop` returns True, with the time of the wire in both directions and the return
    delay."""
    began = time.monotonic()
    while not stop():
        ready, _, _ = select.select([line.master], [], [], TICK)
        device.advance(time.monotonic() - began)
        if not ready:
            continue
        data = os.read(line.master, 1024)
        reply = device.answer(data) if hears(device, line) else b""
        if reply:
            late, device.faults.late = device.faults.late + device.faults.slow, 0.0
            time.sleep(10 * (len(data) + len(reply)) / baud + 2e-6 * device.get(9) + late)
            os.write(line.master, reply)
