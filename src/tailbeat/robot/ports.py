"""Addresses of a fish's devices."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Ports:
    """Addresses: serial ports of servo and IMU, our own address, the station's address."""

    servo: str
    imu: str
    listen: tuple[str, int]
    station: tuple[str, int]
