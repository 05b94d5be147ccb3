"""Where a fish's devices are."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Ports:
    """Where the devices are: serial ports, our own address, the station's."""

    servo: str
    imu: str
    listen: tuple[str, int]
    station: tuple[str, int]
