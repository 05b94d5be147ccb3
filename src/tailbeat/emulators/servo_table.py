"""The control table of an emulated Dynamixel, and which writes its manual allows.

Addresses, sizes, factory values and ranges are those of the XW430-T200 (e-manual); other models
differ in a few (`servo_models`), and the P series in more (`servo_p`). Registers are named by the
X series' addresses everywhere but on the wire. What the manual leaves open was not checked on a
real servo.
"""

from collections.abc import Iterator
from dataclasses import dataclass

from tailbeat.emulators.servo_models import MODELS, Model
from tailbeat.emulators.servo_p import END, MODES, NUMBERS, P_MODELS, PModel, ranges, units_of
from tailbeat.fish.description import Hardware

FIRMWARE = 45
RAM, GOALS = 64, range(100, 120)
SIZE = 148  # bytes of the table; indirect addresses beyond are not emulated
FAIL, INSTRUCTION, RANGE, LENGTH, LIMIT, ACCESS = 1, 2, 4, 5, 6, 7  # errors of a status packet
POSITION, HOLDING = 3, (3, 4, 5)  # operating modes: position; all that hold one
WHOLE = 1_048_575  # counts to either side that the extended position mode takes


@dataclass(frozen=True)
class Register:
    """A register: bytes, factory value, and what may be written, in rising order (None:
    read-only)."""

    size: int
    factory: int
    allowed: range | tuple[int, ...] | None = None


def _upto(size: int, factory: int, high: int, low: int = 0) -> Register:
    return Register(size, factory, range(low, high + 1))


REGISTERS = {
    0: Register(2, 1280), 2: Register(4, 0), 6: Register(1, FIRMWARE),
    7: _upto(1, 1, 252), 8: _upto(1, 3, 7), 9: _upto(1, 250, 254), 10: _upto(1, 0, 13),
    11: Register(1, 3, (0, 1, 3, 4, 5, 16)), 12: _upto(1, 255, 255), 13: Register(1, 2, (2,)),
    20: _upto(4, 0, 1_044_479, -1_044_479), 24: _upto(4, 10, 1023), 31: _upto(1, 80, 100),
    32: _upto(2, 160, 160, 95), 34: _upto(2, 95, 160, 95), 36: _upto(2, 885, 885),
    38: _upto(2, 2047, 2047), 44: _upto(4, 235, 2047), 48: _upto(4, 4095, 4095),
    52: _upto(4, 0, 4095), 60: _upto(1, 0, 3), 63: _upto(1, 52, 63),
    64: _upto(1, 0, 1), 65: _upto(1, 0, 1), 68: _upto(1, 2, 2), 69: Register(1, 0),
    70: Register(1, 0), 76: _upto(2, 1920, 16383), 78: _upto(2, 100, 16383),
    80: _upto(2, 0, 16383), 82: _upto(2, 0, 16383), 84: _upto(2, 900, 16383),
    88: _upto(2, 0, 16383), 90: _upto(2, 0, 16383), 98: _upto(1, 0, 127),
    100: _upto(2, 885, 885, -885), 102: _upto(2, 2047, 2047, -2047),
    104: _upto(4, 235, 2047, -2047), 108: _upto(4, 0, 32767), 112: _upto(4, 0, 32767),
    116: _upto(4, 2048, WHOLE, -WHOLE), 120: Register(2, 0), 122: Register(1, 0),
    123: Register(1, 0), 124: Register(2, 0), 126: Register(2, 0), 128: Register(4, 0),
    132: Register(4, 2048), 136: Register(4, 0), 140: Register(4, 2048), 144: Register(2, 120),
    146: Register(1, 30), 147: Register(1, 1),
}  # fmt: skip
GUARDED = {100: 36, 102: 38, 104: 44}  # goal: the limit in the EEPROM that it may not pass


class Table:
    """The bytes of a control table."""

    def __init__(self, hardware: Hardware | None = None) -> None:
        number = REGISTERS[0].factory if hardware is None else hardware.number
        self.units = units_of(number)
        self.registers = _of_p(number) if number in NUMBERS else _of_x(number)
        self.own = {} if hardware is None else _own(hardware)
        self.bytes = bytearray(256)
        self.factory(0)

    def factory(self, first: int, kept: frozenset[int] = frozenset()) -> None:
        """Write factory values from address `first` on, but for registers that are `kept`."""
        for address in self.registers:
            if address >= first and address not in kept:
                self.put(address, self.factory_value(address))

    def factory_value(self, address: int) -> int:
        """What a register holds from the factory, or of the fish's own servo."""
        return self.own.get(address, self.registers[address].factory)

    def get(self, address: int, signed: bool = False) -> int:
        """Read a register."""
        size = self.registers[address].size
        return int.from_bytes(self.bytes[address : address + size], "little", signed=signed)

    def put(self, address: int, value: int) -> None:
        """Set a register, also a read-only one."""
        size = self.registers[address].size
        self.bytes[address : address + size] = (value % (1 << 8 * size)).to_bytes(size, "little")

    def read(self, address: int, length: int) -> tuple[int, bytes]:
        """Error number and bytes of a read."""
        first = self._named(address, length)
        if first is None or not length:
            return ACCESS, b""
        return 0, bytes(self.bytes[first : first + length])

    def _named(self, address: int, length: int) -> int | None:
        """The X series' address of bytes on the wire; None where no register is."""
        shift = self.units.shift
        if not shift:
            return address if address + length <= SIZE else None
        if address + length <= RAM:
            return address
        inside = RAM + shift <= address and address + length <= END + shift
        return address - shift if inside else None

    def write(self, address: int, data: bytes) -> int:
        """Write whole registers from an address on, all or none; returns the error number."""
        first = self._named(address, len(data))
        if first is None:
            return ACCESS
        parts = list(self._parts(first, data))
        for register, value in parts:
            if error := LENGTH if value is None else self._refusal(register, value):
                return error
        self.bytes[first : first + len(data)] = data
        return 0

    def _refusal(self, address: int, data: bytes) -> int:
        """The error number of a write to one register, 0 if it is allowed."""
        register = self.registers.get(address)
        if register is None or register.allowed is None:
            return ACCESS
        if address < RAM and self.get(64):
            return ACCESS  # the EEPROM is locked while there is torque
        if address in GOALS and self.get(98) == 0xFF:
            return RANGE  # after the bus watchdog
        value = int.from_bytes(data, "little", signed=register.allowed[0] < 0)
        if address == 64 and value and self.get(70) & self.get(63):
            return FAIL  # after a shutdown, only a reboot clears it
        if value not in register.allowed:
            return RANGE
        return 0 if self._within_limits(address, value) else LIMIT

    def _within_limits(self, address: int, value: int) -> bool:
        """Whether a goal lies within the limits of the EEPROM."""
        if address == 116 and self.get(11) == POSITION:
            return self.get(52, True) <= value <= self.get(48, True)
        return address not in GUARDED or abs(value) <= self.get(GUARDED[address])

    def _parts(self, address: int, data: bytes) -> Iterator[tuple[int, bytes | None]]:
        """The registers that a write fills, with their bytes; None: it ends within one."""
        at = 0
        while at < len(data):
            register = self.registers.get(address + at)
            size = 1 if register is None else register.size
            part = data[at : at + size]
            yield address + at, part if len(part) == size else None
            at += size


def _of_p(number: int) -> dict[int, Register]:
    """The registers of a P model."""
    known = ranges(P_MODELS.get(number, PModel(P_MODELS[2100].steps)))
    own = {at: _upto(size, usual, high, low) for at, (size, usual, low, high) in known.items()}
    starts = {132: Register(4, 0), 140: Register(4, 0), 144: Register(2, 240)}
    found = REGISTERS | own | starts | {0: Register(2, number), 11: Register(1, 3, MODES)}
    return {at: found[at] for at in sorted(found) if at not in (60, 147)}


def _of_x(number: int) -> dict[int, Register]:
    """The registers of a model: without current, it has no limit and no goal of it."""
    model = MODELS.get(number, Model())
    low, high = model.volts
    own = REGISTERS | {
        11: Register(1, 3, model.modes),
        32: _upto(2, high, high, low),
        34: _upto(2, low, high, low),
        38: _upto(2, model.current, model.current),
        44: _upto(4, model.velocity, 2047),
        63: _upto(1, model.shutdown, 63),
        102: _upto(2, model.current, model.current, -model.current),
        104: _upto(4, model.velocity, 2047, -2047),
    }
    return {at: one for at, one in own.items() if model.current or at not in (38, 102)}


def _own(hardware: Hardware) -> dict[int, int]:
    """Factory values of a fish's own servo: model, temperature's and supply's limits, gain, present
    supply."""
    low, high = hardware.supply_range
    return {
        0: hardware.number,
        31: round(hardware.temperature_limit),
        32: round(10 * high),
        34: round(10 * low),
        84: hardware.gain,
        144: round(10 * hardware.supply),
    }
