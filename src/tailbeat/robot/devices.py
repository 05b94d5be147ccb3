"""The robot's open devices."""

import socket
from dataclasses import dataclass

from tailbeat.link.datagrams import Receiver
from tailbeat.robot.imus import YawSensor
from tailbeat.robot.servo import Servo


@dataclass(frozen=True, eq=False)
class Devices:
    """What the loop reads and writes. Without an IMU (None) the yaw rate comes from the camera.
    Status and clock requests are sent to `station`."""

    servo: Servo
    imu: YawSensor | None
    receiver: Receiver
    socket: socket.socket
    station: tuple[str, int]


@dataclass(frozen=True, eq=False)
class Line:
    """The link to a station: what it sends, our socket, and its address."""

    receiver: Receiver
    socket: socket.socket
    station: tuple[str, int]
