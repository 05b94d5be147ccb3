"""The newest readings of servo and IMU, and which are accepted."""

import math
import time
from collections import deque
from dataclasses import dataclass, field

import numpy as np

from tailbeat.control.band import Monitor, Shares
from tailbeat.robot import plausible
from tailbeat.robot.imu import ImuFault, YawRate
from tailbeat.robot.imus import YawSensor
from tailbeat.robot.plausible import READINGS, Bounds, Gate, Travel
from tailbeat.robot.poses import Poses
from tailbeat.robot.servo import Servo, ServoFault, ServoState

CURRENT_TIME = 0.5  # s over which the servo's current is averaged
REOPEN_EVERY = 0.5  # s between two tries to open an unplugged port again
NEVER = YawRate(-math.inf, 0.0)
UNKNOWN = Shares(math.nan, math.nan, math.nan)


@dataclass(frozen=True, eq=False)
class CameraYaw:
    """What stands in for an IMU: the slope of the headings in the accepted poses."""

    poses: Poses

    def read(self) -> YawRate | None:
        """The yaw rate, with the time at which the newest frame was taken; None before the first
        pose."""
        age, rate = self.poses.age(time.monotonic_ns()), self.poses.yaw_rate()
        return None if age is None or rate is None else YawRate(time.monotonic() - age, rate)


@dataclass(eq=False)
class Sensors:
    """The newest reading of each device; before the first it is None, or has the time minus
    infinity. `imu_fault` is the kind of the IMU's last fault, or "". `servo_gone`, `imu_gone`: the
    port is missing."""

    period: float
    bounds: Bounds
    monitor: Monitor
    servo: ServoState | None = None
    yaw: YawRate = NEVER
    gate: Gate = field(default_factory=Gate)
    shares: Shares = UNKNOWN
    imu_fault: str = ""
    servo_gone: bool = False
    imu_gone: bool = False
    reopened: float = -math.inf  # s, the last try
    currents: deque[float] = field(init=False)  # A, of the last half second
    volts: deque[float] = field(init=False)  # V, as long
    travelled: deque[Travel] = field(default_factory=lambda: deque(maxlen=READINGS))

    def __post_init__(self) -> None:
        self.currents = deque(maxlen=round(CURRENT_TIME / self.period))
        self.volts = deque(maxlen=round(CURRENT_TIME / self.period))

    def read(self, servo: Servo, imu: "YawSensor | CameraYaw", sent: float) -> None:
        """Read both devices; `sent` [rad] is the last setpoint. A missing reply shows in a
        reading's age."""
        try:
            self._take(servo.read(), sent)
        except ServoFault as fault:
            self.servo_gone = fault.kind == "gone"
        try:
            self._believe(imu.read())
            self.imu_gone, self.imu_fault = False, ""
        except ImuFault as fault:
            self.imu_gone, self.imu_fault = fault.kind == "gone", fault.kind

    def _take(self, reading: ServoState, sent: float) -> None:
        self.servo, self.servo_gone = reading, False
        self.currents.append(reading.current)
        self.volts.append(reading.voltage)
        self.monitor.add(reading.time, reading.angle)
        self.travelled.append((reading.time, sent, reading.angle))

    def _believe(self, yaw: YawRate | None) -> None:
        if yaw is None:
            return
        self.gate, believed = plausible.gated(self.gate, yaw.rate, self.bounds)
        if believed:
            self.yaw = yaw

    def current(self) -> float:
        """Mean absolute current of the last half second [A]."""
        return float(np.mean(np.abs(self.currents))) if self.currents else 0.0

    def supply(self) -> float:
        """Median supply of the last half second [V]: one sample of a beat's peak decides nothing.
        12 V before the first reading."""
        return float(np.median(self.volts)) if self.volts else 12.0

    def follows(self) -> bool:
        """Whether the shaft follows its setpoints."""
        return plausible.shaft_follows(self.travelled, self.bounds)

    def look_at_band(self) -> None:
        """Compute in which frequencies the tail's power is; takes longer than a decision."""
        self.shares = self.monitor.shares() or UNKNOWN

    def reopen(self, servo: Servo, imu: YawSensor | None, now: float) -> None:
        """Open the port of an unplugged device, or of a frozen IMU, again; at most twice a
        second."""
        broken = self.servo_gone or self.imu_gone or self.imu_fault == "frozen"
        if not broken or now - self.reopened < REOPEN_EVERY:
            return
        self.reopened = now
        try:
            if self.servo_gone:
                servo.reopen()
            elif imu is not None:
                imu.reopen()
        except (ServoFault, ImuFault):
            pass  # the next call tries again
