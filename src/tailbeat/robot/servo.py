"""The fish's servo, of any family: what the robot asks of a driver, and which driver answers.

`dynamixel` drives ROBOTIS X- and P-series servos and the MX-28 (2.0), `feetech` Feetech STS
and SCS servos.
The fish's `[hardware]` names the family.
"""

from typing import Protocol

import serial

from tailbeat.files import BadInput
from tailbeat.fish.description import Family, Hardware
from tailbeat.robot import dynamixel, feetech, feetech_tables
from tailbeat.robot.dynamixel_tables import P, X, table_of
from tailbeat.robot.servo_state import DEADLINE, PATIENCE, ServoFault, ServoState
from tailbeat.robot.wire import open_port

FAMILIES: tuple[Family, ...] = ("dynamixel-x", "dynamixel-p", "feetech-sts", "feetech-scs")

__all__ = ["DEADLINE", "FAMILIES", "Servo", "ServoFault", "ServoState", "connect", "on_port"]


class Servo(Protocol):
    """A driver. Every method raises ServoFault, but for `stopped_itself` of a servo without a
    watchdog, and `close`. Registers are pairs of address and bytes."""

    port: serial.Serial
    ident: int
    deadline: float  # s for a reply
    silent: int  # replies that did not come

    @property
    def own_watchdog(self) -> bool:
        """Whether the servo itself stops if the bus is silent."""

    def read(self) -> ServoState:
        """Read the servo's state in one transaction."""

    def write(self, angle: float) -> float:
        """Send a setpoint [rad]; returns the angle sent, rounded to whole counts."""

    def prepare(self, low: float, high: float) -> None:
        """Turn torque off; set position mode, limits [rad] in the servo itself, and replies."""

    def arm(self, watchdog: float = 0.1) -> float:
        """Turn torque on and hold the present angle; returns it [rad]. `watchdog` [s] sets the
        servo's own, if it has one."""

    def release(self, watchdog: float = 0.1) -> float:
        """Accept goals from the present angle; returns it [rad]. Torque does not change."""

    def torque_off(self) -> None:
        """Turn torque off in any state, and read it back."""

    def is_on(self) -> bool:
        """Whether the servo holds torque."""

    def stopped_itself(self) -> bool:
        """Whether the servo's own watchdog stopped it."""

    def hardware_errors(self) -> list[str]:
        """Names of the present hardware errors."""

    def reboot(self) -> None:
        """Restart the servo: torque is off afterwards, and its RAM is lost."""

    def get(self, register: tuple[int, int]) -> int:
        """Read an unsigned register."""

    def set(self, register: tuple[int, int], value: int) -> None:
        """Write a register."""

    def reopen(self) -> None:
        """Open the port again after the cable was unplugged."""

    def close(self) -> None:
        """Turn torque off if the servo still answers, and close the port."""


def connect(
    path: str,
    hardware: Hardware,
    ident: int = 1,
    baud: int = 1_000_000,
    sign: int = 1,
    deadline: float = DEADLINE,
) -> Servo:
    """Open a port and check that the fish's servo model answers. `deadline` [s] is for a reply;
    `sign` is 1 if counts increase with the motor angle, else -1. Raises BadInput."""
    port = open_port(path, baud, deadline)
    told = port, ident, sign, max(deadline, PATIENCE), hardware.current_unit
    try:
        if hardware.family.startswith("feetech"):
            sts = feetech.Servo(*told, feetech_tables.table_of(hardware.family))
            feetech.check(sts, path, hardware, baud)
            sts.deadline = deadline
            return sts
        servo = dynamixel.Servo(*told, table_of(hardware.number))
        dynamixel.check(servo, path, hardware, baud)
    except BadInput:
        port.close()
        raise
    servo.deadline = deadline
    return servo


def on_port(port: serial.Serial, family: Family, ident: int, deadline: float) -> Servo:
    """A driver on a port that is open, without asking the servo anything. It may be one that
    answers no writes."""
    if family.startswith("feetech"):
        memory = feetech_tables.table_of(family)
        return feetech.Servo(port, ident, deadline=deadline, table=memory, answers_writes=False)
    table = P if family == "dynamixel-p" else X
    return dynamixel.Servo(port, ident, deadline=deadline, table=table, answers_writes=False)
