"""The robot's devices, open."""

import socket
from dataclasses import dataclass

from tailbeat.link.datagrams import Receiver
from tailbeat.robot.imu import Imu
from tailbeat.robot.servo import Servo


@dataclass(frozen=True, eq=False)
class Devices:
    """What the loop reads and writes; status and questions for the clock go to `station`."""

    servo: Servo
    imu: Imu
    receiver: Receiver
    socket: socket.socket
    station: tuple[str, int]
