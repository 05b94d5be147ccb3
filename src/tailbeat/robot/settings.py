"""The registers of a servo that tailbeat wants at a value: what they hold, and what it wants.

The doctor tells what is wrong with them and `tailbeat prepare` writes them. Addresses: the e-manual
(Dynamixel), the memory table of STS servos (Feetech).
"""

from collections.abc import Iterator
from dataclasses import dataclass

from tailbeat.fish.description import Hardware
from tailbeat.robot import dynamixel, feetech
from tailbeat.robot.servo import Servo

IDENT, BAUD_RATE = 1, 1_000_000  # at which every verb looks for the servo
OWN_ERRORS = 0b110100  # overheat, electrical shock, overload: turn torque off, as from the factory
STS_ERRORS = 0b101100  # overheat, overcurrent, overload
Register = tuple[int, int]  # address, bytes


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
    family = _of_feetech if hardware.family == "feetech-sts" else _of_dynamixel
    found = []
    for name, register, wanted in family(servo, ends):
        size = register[1]
        now = servo.get(register)
        if wanted < 0 or name == "homing offset":  # two's complement
            now = int.from_bytes(now.to_bytes(size, "little"), "little", signed=True)
        found.append(Setting(name, register, now, wanted))
    return tuple(found)


def _of_dynamixel(
    servo: Servo, ends: tuple[float, float] | None
) -> Iterator[tuple[str, Register, int]]:
    yield "status return level", dynamixel.RETURN_LEVEL, dynamixel.ANSWERS_ALL
    yield "return delay", dynamixel.RETURN_DELAY, 0
    yield "drive mode", dynamixel.DRIVE_MODE, 0
    yield "operating mode", dynamixel.OPERATING_MODE, dynamixel.POSITION_MODE
    yield "homing offset", dynamixel.HOMING, 0
    yield from _limits(ends, dynamixel.LOWEST, dynamixel.HIGHEST)
    yield "shutdown", dynamixel.SHUTDOWN, servo.get(dynamixel.SHUTDOWN) | OWN_ERRORS
    yield "profile acceleration", dynamixel.PROFILE_ACCELERATION, 0
    yield "profile velocity", dynamixel.PROFILE_VELOCITY, 0
    yield "id", dynamixel.ID, IDENT
    yield "baud rate", dynamixel.BAUD, dynamixel.BAUDS[BAUD_RATE]


def _of_feetech(
    servo: Servo, ends: tuple[float, float] | None
) -> Iterator[tuple[str, Register, int]]:
    """The offset (31) is left: calibrating the middle writes it, and so it holds the straight
    tail."""
    yield "response level", feetech.LEVEL, feetech.ANSWERS_ALL
    yield "return delay", feetech.RETURN_DELAY, 0
    yield "phase", feetech.PHASE, servo.get(feetech.PHASE) & ~feetech.TURNS
    yield "operating mode", feetech.MODE, feetech.POSITION_MODE
    yield from _limits(ends, feetech.LOWEST, feetech.HIGHEST)
    yield "unloading condition", feetech.UNLOADING, servo.get(feetech.UNLOADING) | STS_ERRORS
    yield "acceleration", feetech.ACCELERATION, 0
    yield "id", feetech.ID, IDENT
    yield "baud rate", feetech.BAUD, feetech.BAUDS[BAUD_RATE]


def _limits(
    ends: tuple[float, float] | None, lowest: Register, highest: Register
) -> Iterator[tuple[str, Register, int]]:
    """The position limits; both families count 4096 to a turn and 2048 at the straight tail."""
    if ends is not None:
        low, high = (dynamixel.CENTRE + round(end / dynamixel.COUNT) for end in ends)
        yield "lowest position", lowest, low
        yield "highest position", highest, high
