"""Which IMU is at a port: both kinds, behind one interface."""

from typing import Protocol

import serial

from tailbeat.files import BadInput
from tailbeat.robot import imu, imu_rvc
from tailbeat.robot.imu import NoAnswer, YawRate
from tailbeat.robot.mounting import Mounting, Vector


class YawSensor(Protocol):
    """What the robot's loop reads the yaw rate from. Methods and errors are those of `imu.Imu`."""

    name: str
    port: serial.Serial
    deadline: float
    missed: int

    def read(self) -> YawRate | None:
        """The yaw rate, or None if no valid reading came in time."""

    def prepare(self) -> None:
        """Set the sensor up."""

    def healthy(self) -> bool:
        """Whether the sensor reports no error of its own."""

    def up(self) -> Vector:
        """Unit vector that points up by gravity, in the sensor's axes."""

    def reopen(self) -> None:
        """Open the port again after the cable was unplugged."""

    def close(self) -> None:
        """Close the port."""


def connect(path: str, mounting: Mounting, deadline: float = imu.DEADLINE) -> YawSensor:
    """Open a port and find out which IMU is there. Raises BadInput.

    It listens first: a BNO085 in UART-RVC mode sends by itself, and a BNO055 only replies.
    """
    try:
        return imu_rvc.connect(path, mounting, deadline)
    except NoAnswer:
        pass
    try:
        return imu.connect(path, mounting, deadline)
    except NoAnswer:
        raise BadInput(
            f"{path}: neither a BNO055 nor a BNO085 is at this port, at 115200 baud; check cable"
            f" and power, and the pins: BNO055 PS1 high, BNO085 PS0 high and PS1 low."
        ) from None
