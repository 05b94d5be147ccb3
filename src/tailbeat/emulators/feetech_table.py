"""The memory of an emulated Feetech servo, STS or SCS, and which writes it takes.

Addresses, sizes, factory values and ranges: the maker's memory table of its STS servos with
magnetic encoder; of an SCS the memory tables of the SCS15 and SCSCL and rustypot's of the SCS0009.
Factory values that these leave open are chosen. An SCS has the high byte of a word first. A servo
never refuses: a value that is not allowed is not taken. What is written to the EEPROM while its
lock is closed is lost when the servo restarts. Nothing was checked on a real servo.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from tailbeat.fish.description import Hardware

SIZE, RAM = 87, 40  # bytes of the memory; where the EEPROM ends
TORQUES = (0, 1, 2, 128)  # off, on, damped; 128: the present position becomes the middle
PHASE = 0b1100  # speeds in counts/s, 0 is the fastest


@dataclass(frozen=True)
class Register:
    """A register: bytes, factory value, what may be written (None: read-only), and the bit that
    holds its sign, if it has one."""

    size: int
    factory: int
    allowed: range | tuple[int, ...] | None = None
    sign: int | None = None


def _upto(size: int, factory: int, high: int, low: int = 0, sign: int | None = None) -> Register:
    return Register(size, factory, range(low, high + 1), sign)


REGISTERS = {
    0: Register(1, 3), 1: Register(1, 10), 2: Register(1, 0), 3: Register(2, 777),
    5: _upto(1, 1, 253), 6: _upto(1, 0, 7), 7: _upto(1, 0, 254), 8: _upto(1, 1, 1),
    9: _upto(2, 0, 4094), 11: _upto(2, 4095, 4095), 13: _upto(1, 70, 100), 14: _upto(1, 140, 254),
    15: _upto(1, 40, 254), 16: _upto(2, 1000, 1000), 18: _upto(1, PHASE, 254),
    19: _upto(1, 0b101100, 254), 20: _upto(1, 0b101111, 254), 21: _upto(1, 32, 254),
    22: _upto(1, 32, 254), 23: _upto(1, 0, 254), 24: _upto(1, 16, 254), 25: _upto(1, 0, 254),
    26: _upto(1, 1, 32), 27: _upto(1, 1, 32), 28: _upto(2, 500, 2047), 30: _upto(1, 1, 128, 1),
    31: _upto(2, 0, 2047, -2047, sign=11), 33: _upto(1, 0, 3), 34: _upto(1, 20, 254),
    35: _upto(1, 200, 254), 36: _upto(1, 80, 254), 37: _upto(1, 10, 254), 38: _upto(1, 200, 254),
    39: _upto(1, 10, 254),
    40: Register(1, 0, TORQUES), 41: _upto(1, 0, 254), 42: _upto(2, 2048, 32767, -32767, sign=15),
    44: _upto(2, 0, 2047), 46: _upto(2, 3400, 32767, -32767, sign=15), 48: _upto(2, 1000, 1000),
    55: _upto(1, 1, 1),
    56: Register(2, 2048, sign=15), 58: Register(2, 0, sign=15), 60: Register(2, 0, sign=10),
    62: Register(1, 120), 63: Register(1, 30), 64: Register(1, 0), 65: Register(1, 0),
    66: Register(1, 0), 67: Register(2, 2048, sign=15), 69: Register(2, 0, sign=15),
    80: Register(1, 1), 81: Register(1, 20), 82: Register(1, 1), 83: Register(1, 1),
    84: Register(1, 68), 85: Register(1, 254), 86: Register(1, 1),
}  # fmt: skip


_OF_SCS = {
    3: Register(2, 1284),
    9: _upto(2, 20, 1023), 11: _upto(2, 1003, 1023), 13: _upto(1, 80, 100),
    16: _upto(2, 1023, 1023), 18: _upto(1, 8, 254), 19: _upto(1, 37, 254), 20: _upto(1, 37, 254),
    21: _upto(1, 15, 254), 22: _upto(1, 0, 254), 24: _upto(2, 0, 1023), 26: _upto(1, 2, 32),
    27: _upto(1, 2, 32), 37: _upto(1, 20, 254), 38: _upto(1, 200, 254), 39: _upto(1, 80, 254),
    40: Register(1, 0, (0, 1)), 42: _upto(2, 511, 1023), 44: _upto(2, 0, 9999),
    46: _upto(2, 0, 1023), 48: _upto(1, 1, 1), 56: Register(2, 511), 69: Register(2, 0, sign=15),
}  # fmt: skip
_SHARED = (0, 1, 5, 6, 7, 8, 14, 15, 23, 58, 60, 62, 63, 64, 65, 66)


@dataclass(frozen=True)
class Kind:
    """In what STS and SCS differ: registers, byte order, the `lock` of the EEPROM, counts of a turn
    (`steps`; of an SCS those of its 300 degrees), the count of the straight tail, the angle of all
    counts [degrees], the phase's bit that reverses it, and registers of limit and patience [10 ms]
    of overload and of overcurrent (None: not watched)."""

    registers: dict[int, Register]
    order: Literal["little", "big"]
    lock: int
    steps: int
    middle: int
    span: float
    reversed: int
    overload: tuple[int, int]
    overcurrent: tuple[int, int] | None


STS = Kind(REGISTERS, "little", 55, 4096, 2048, 360, 128, (36, 35), (28, 38))
SCS = Kind(
    {at: REGISTERS[at] for at in _SHARED} | _OF_SCS,
    "big", 48, 1024, 511, 300, 1, (39, 38), None,
)  # fmt: skip


class Table:
    """The bytes of a memory. `stored` is what the EEPROM keeps without power."""

    def __init__(self, hardware: Hardware | None = None) -> None:
        self.kind = SCS if hardware is not None and hardware.family == "feetech-scs" else STS
        self.registers = self.kind.registers
        self.own = {} if hardware is None else _own(hardware)
        self.bytes = bytearray(SIZE)
        self.stored = bytes(RAM)
        self.factory()

    def factory(self, kept: frozenset[int] = frozenset()) -> None:
        """Write factory values, but for registers that are `kept`, and store them."""
        for address, register in self.registers.items():
            if address not in kept:
                self.put(address, self.own.get(address, register.factory))
        self.stored = bytes(self.bytes[:RAM])

    def restart(self) -> None:
        """As after a loss of power: the stored EEPROM, and RAM from the factory but for what the
        servo measures."""
        for address, register in self.registers.items():
            if RAM <= address and address not in (62, 63):
                self.put(address, register.factory)
        self.bytes[:RAM] = self.stored
        if self.kind is STS:
            self.put(48, self.get(16))

    def get(self, address: int) -> int:
        """Read a register, with its sign; 0 where there is none."""
        register = self.registers.get(address, Register(1, 0))
        word = int.from_bytes(self.bytes[address : address + register.size], self.kind.order)
        return _signed(word, register.sign)

    def put(self, address: int, value: int) -> None:
        """Set a register, also a read-only one; nothing where there is none."""
        register = self.registers.get(address)
        if register is None:
            return
        word = value if value >= 0 or register.sign is None else -value + (1 << register.sign)
        self.bytes[address : address + register.size] = word.to_bytes(
            register.size, self.kind.order
        )

    def read(self, address: int, length: int) -> bytes:
        """Bytes from an address on; 0 beyond the memory's end."""
        return bytes(self.bytes[address : address + length]).ljust(length, b"\0")

    def write(self, address: int, data: bytes) -> None:
        """Write whole registers from an address on; what is not allowed is not taken."""
        for at, part in _parts(self.registers, address, data):
            allowed, sign = self.registers[at].allowed, self.registers[at].sign
            value = _signed(int.from_bytes(part, self.kind.order), sign)
            if allowed is not None and value in allowed:
                self.bytes[at : at + len(part)] = part
                if at < RAM and not self.get(self.kind.lock):
                    self.stored = self.stored[:at] + part + self.stored[at + len(part) :]


def _signed(word: int, sign: int | None) -> int:
    return word if sign is None or not word & 1 << sign else -(word - (1 << sign))


def _parts(
    registers: dict[int, Register], address: int, data: bytes
) -> Iterator[tuple[int, bytes]]:
    """The registers that a write fills whole, with their bytes."""
    at = 0
    while at < len(data):
        register = registers.get(address + at)
        size = 1 if register is None else register.size
        if register is not None and at + size <= len(data):
            yield address + at, data[at : at + size]
        at += size


def _own(hardware: Hardware) -> dict[int, int]:
    """Factory values of a fish's own servo: model, temperature's and supply's limits, gain, present
    supply."""
    low, high = hardware.supply_range
    return {
        3: hardware.number,
        13: round(hardware.temperature_limit),
        14: round(10 * high),
        15: round(10 * low),
        21: min(hardware.gain, 254),
        62: round(10 * hardware.supply),
    }
