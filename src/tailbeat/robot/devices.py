"""The robot's open devices."""

import socket
from dataclasses import dataclass

from tailbeat.link.datagrams import Receiver
from tailbeat.robot.imu import Imu
from tailbeat.robot.servo import Servo


@dataclass(frozen=True, eq=False)
class Devices:
    """What the loop reads and writes. Status and clock requests are sent to `station`."""

    servo: Servo
    imu: Imu
    receiver: Receiver
    socket: socket.socket
    station: tuple[str, int]
