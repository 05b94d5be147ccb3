"""Addresses of a fish's devices."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Ports:
    """Addresses: serial ports of servo and IMU ("none": there is no IMU), our own address, the
    station's address."""

    servo: str
    imu: str
    listen: tuple[str, int]
    station: tuple[str, int]
