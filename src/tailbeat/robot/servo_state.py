"""What every servo's driver gives and raises."""

from dataclasses import dataclass

DEADLINE = 0.005  # s for a reply
PATIENCE = 0.1  # s for the first reply and for arming: nothing moves yet


class ServoFault(Exception):
    """The servo did not follow a command. `kind`: "silent" (no reply), "gone" (the port is
    missing), "refused" (an error in its status, or a value that it did not take), "watchdog" (it
    stopped itself and must be armed again)."""

    def __init__(self, kind: str, text: str) -> None:
        super().__init__(text)
        self.kind = kind


@dataclass(frozen=True)
class ServoState:
    """One reading: `time` [s] monotonic at its arrival, angle [rad] and velocity [rad/s] of the
    shaft, current [A], voltage [V], temperature [deg C], and whether there is a hardware error."""

    time: float
    angle: float
    velocity: float
    current: float
    voltage: float
    temperature: float
    alert: bool
