"""The registers of a servo that tailbeat wants at a value: what they hold, and what it wants.

The doctor tells what is wrong with them and `tailbeat prepare` writes them. Addresses: the e-manual
(Dynamixel), the memory table of STS servos (Feetech).
"""

from collections.abc import Iterator
from dataclasses import dataclass

from tailbeat.fish.description import Hardware
from tailbeat.robot import dynamixel, feetech, feetech_tables
from tailbeat.robot import dynamixel_tables as at
from tailbeat.robot.dynamixel_tables import Register, table_of
from tailbeat.robot.servo import Servo

IDENT, BAUD_RATE = 1, 1_000_000  # at which every verb looks for the servo
OWN_ERRORS = 0b110100  # overheat, electrical shock, overload: turn torque off, as from the factory


@dataclass(frozen=True)
class Setting:
    """A register with what it holds `now` and the value `wanted`."""

    name: str
    register: Register
    now: int
    wanted: int

    @property
    def fits(self) -> bool:
        """Whether it holds what is wanted."""
        return self.now == self.wanted


def settings(
    servo: Servo, hardware: Hardware, ends: tuple[float, float] | None
) -> tuple[Setting, ...]:
    """Every such register of a servo, in the order in which they are written: id and baud rate
    last. `ends` are the lowest and highest motor angle [rad]; None leaves the servo's own limits.
    Raises ServoFault."""
    family = _of_feetech if hardware.family.startswith("feetech") else _of_dynamixel
    found = []
    for name, register, wanted in family(servo, hardware, ends):
        found.append(Setting(name, register, held(servo, register), wanted))
    return tuple(found)


def held(servo: Servo, register: Register) -> int:
    """What a register holds; four bytes (positions, of a Dynamixel) have a sign. Raises
    ServoFault."""
    size = register[1]
    return int.from_bytes(servo.get(register).to_bytes(size, "little"), "little", signed=size == 4)


def _of_dynamixel(
    servo: Servo, hardware: Hardware, ends: tuple[float, float] | None
) -> Iterator[tuple[str, Register, int]]:
    table = table_of(hardware.number)
    yield "status return level", table.return_level, dynamixel.ANSWERS_ALL
    yield "return delay", at.RETURN_DELAY, 0
    yield "drive mode", at.DRIVE_MODE, 0
    yield "operating mode", at.OPERATING_MODE, dynamixel.POSITION_MODE
    yield "homing offset", at.HOMING, 0
    yield from _limits(ends, table.centre, table.count, (at.LOWEST, at.HIGHEST))
    yield "shutdown", at.SHUTDOWN, servo.get(at.SHUTDOWN) | OWN_ERRORS
    yield "profile acceleration", table.profile_acceleration, 0
    yield "profile velocity", table.profile_velocity, 0
    yield "id", at.ID, IDENT
    yield "baud rate", at.BAUD, dynamixel.BAUDS[BAUD_RATE]


def _of_feetech(
    servo: Servo, hardware: Hardware, ends: tuple[float, float] | None
) -> Iterator[tuple[str, Register, int]]:
    """The offset (31) of an STS is left: calibrating the middle writes it, and so it holds the
    straight tail."""
    own, table = feetech_tables, feetech_tables.table_of(hardware.family)
    yield "response level", own.LEVEL, feetech.ANSWERS_ALL
    if table.modes:
        yield "return delay", own.RETURN_DELAY, 0
        yield "phase", own.PHASE, servo.get(own.PHASE) & ~own.TURNS
        yield "operating mode", own.MODE, feetech.POSITION_MODE
    yield from _limits(ends, table.centre, table.count, (own.LOWEST, own.HIGHEST))
    yield "unloading condition", own.UNLOADING, servo.get(own.UNLOADING) | table.errors
    yield "acceleration" if table.modes else "goal time", table.plain, 0
    yield "id", own.ID, IDENT
    yield "baud rate", own.BAUD, own.BAUDS[BAUD_RATE]


def _limits(
    ends: tuple[float, float] | None,
    centre: int,
    count: float,
    registers: tuple[Register, Register],
) -> Iterator[tuple[str, Register, int]]:
    """The position limits: `count` [rad] of one, `centre` at the straight tail; the registers of
    the lowest and the highest."""
    if ends is not None:
        low, high = (centre + round(end / count) for end in ends)
        yield "lowest position", registers[0], low
        yield "highest position", registers[1], high
