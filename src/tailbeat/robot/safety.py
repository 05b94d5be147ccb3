"""When the fish may swim, when it holds, when it stops: states, limits, and what may be sent.

No device and no clock: the loop says what it knows (`Health`), this says what follows. HOLD and
STOP latch with their first reason; out of HOLD leads arming anew, out of STOP only disarming.
"""

import math
from dataclasses import dataclass, replace

from tailbeat.link.status import State


@dataclass(frozen=True)
class SafetyLimits:
    """Beyond what the loop holds or stops; chosen where no source is named."""

    pose_hold: float = 0.3  # s: age of the newest pose
    pose_stop: float = 2.0  # s
    imu_hold: float = 0.2  # s without a yaw rate
    servo_hold: float = 0.06  # s without a reading: three periods
    servo_stop: float = 0.5  # s
    clock_doubt: float = 0.05  # s that a pose's age may be off
    temperature_hold: float = 65.0  # deg C; the servo lets go at 80
    temperature_stop: float = 75.0
    voltage_low: float = 9.5  # V: the servo's own limit
    voltage_high: float = 16.0
    current_stop: float = 4.0  # A, for longer than a beat
    overruns_hold: int = 10  # periods missed within a second
    jumps_hold: int = 6  # frames in a row whose pose the fish cannot have come to
    slew: float = 20.0  # rad/s of the setpoint: above what the generator asks
    ramp: float = 1.0  # rad/s on the way to straight


@dataclass(frozen=True)
class Health:
    """What the loop knows in one period: ages [s] of the newest readings (infinite: never),
    `clock_doubt` [s] (infinite: clocks not compared), whether the fish and a target were seen,
    servo temperature [deg C], voltage [V], mean current [A], hardware alert, whether it holds the
    torque it was told to, whether its own watchdog stopped it; periods missed within a second;
    whether the policy gave a number; whether the log still writes; who asked to stop, if anyone.

    `hardware` names the servo's errors and `imu_frozen` says that the IMU's numbers stand still;
    `follows`: whether the shaft moves when asked; `jumps`: frames in a row with an impossible pose;
    `clock_step` [s] of the laptop's clock since arming; `guarded`: whether someone lets go if the
    loop dies."""

    pose_age: float = math.inf
    imu_age: float = math.inf
    servo_age: float = math.inf
    clock_doubt: float = math.inf
    target: bool = False
    temperature: float = 25.0
    voltage: float = 12.0
    current: float = 0.0
    alert: bool = False
    torque_lost: bool = False
    watchdog: bool = False
    overruns: int = 0
    finite: bool = True
    logging: bool = True
    stop_asked: str = ""
    hardware: str = ""
    imu_frozen: bool = False
    follows: bool = True
    jumps: int = 0
    clock_step: float = 0.0
    guarded: bool = True


@dataclass(frozen=True)
class SafetyStatus:
    """The state, and why."""

    state: State = State.DISARMED
    reason: str = "not armed yet"


def stops(health: Health, limits: SafetyLimits) -> str:
    """Why the torque must go, or "" if it need not."""
    found = {
        f"stop asked by {health.stop_asked}": bool(health.stop_asked),
        f"the servo reports a hardware error: {health.hardware or 'not named yet'}": (
            health.alert or bool(health.hardware)
        ),
        "the servo lost its torque: it restarted or shut down": health.torque_lost,
        f"servo at {health.temperature:.0f} deg C": health.temperature >= limits.temperature_stop,
        "the shaft does not follow: the tail is jammed, or the encoder stands still": (
            not health.follows
        ),
        f"servo current {abs(health.current):.1f} A": abs(health.current) >= limits.current_stop,
        f"no servo for {health.servo_age:.1f} s": health.servo_age >= limits.servo_stop,
        f"no pose for {health.pose_age:.1f} s": health.pose_age >= limits.pose_stop,
    }
    return next((reason for reason, holds in found.items() if holds), "")


def holds(health: Health, limits: SafetyLimits) -> str:
    """Why the fish must not swim on, or "" if it may. Bounds are taken so that NaN holds."""
    voltage = health.voltage
    found = {
        "the policy's answer is not a number": not health.finite,
        "the servo's own watchdog stopped it": health.watchdog,
        f"no servo for {1e3 * health.servo_age:.0f} ms": not health.servo_age < limits.servo_hold,
        f"no yaw rate for {1e3 * health.imu_age:.0f} ms": not health.imu_age < limits.imu_hold,
        f"no pose for {1e3 * health.pose_age:.0f} ms": not health.pose_age < limits.pose_hold,
        f"the laptop's clock jumped by {health.clock_step:.2f} s": health.clock_step != 0,
        f"a pose from {-1e3 * health.pose_age:.0f} ms ahead: a clock jumped": (
            health.pose_age < -limits.clock_doubt
        ),
        f"{health.jumps} poses in a row that the fish cannot have come to": (
            health.jumps >= limits.jumps_hold
        ),
        "the IMU's numbers stand still": health.imu_frozen,
        "the clocks are not compared": not health.clock_doubt < limits.clock_doubt,
        "no target": not health.target,
        f"servo at {health.temperature:.0f} deg C": not health.temperature
        < limits.temperature_hold,
        f"supply {voltage:.1f} V": not limits.voltage_low <= voltage <= limits.voltage_high,
        f"{health.overruns} periods missed within a second": health.overruns
        >= limits.overruns_hold,
        "the log cannot be written": not health.logging,
        "the watchdog process is gone: torque would stay on if the loop died": not health.guarded,
    }
    return next((reason for reason, holds in found.items() if holds), "")


def judge(before: SafetyStatus, health: Health, limits: SafetyLimits) -> SafetyStatus:
    """The stand after one period of an armed or running fish; DISARMED and STOP stay."""
    if before.state in (State.DISARMED, State.STOP):
        return before
    if reason := stops(health, limits):
        return SafetyStatus(State.STOP, reason)
    if before.state is State.RUN and (reason := holds(health, limits)):
        return SafetyStatus(State.HOLD, reason)
    return before


def arm(before: SafetyStatus, health: Health, limits: SafetyLimits) -> SafetyStatus:
    """ARMED if nothing speaks against it, else as before with the reason; never out of STOP."""
    if before.state is State.STOP:
        return replace(before, reason=f"{before.reason}; disarm first")
    reason = stops(health, limits) or holds(replace(health, watchdog=False), limits)
    return replace(before, reason=reason) if reason else SafetyStatus(State.ARMED, "armed")


def run(before: SafetyStatus) -> SafetyStatus:
    """RUN out of ARMED, from nowhere else."""
    return SafetyStatus(State.RUN, "swimming") if before.state is State.ARMED else before


def disarm(before: SafetyStatus) -> SafetyStatus:
    """Back to the beginning."""
    return SafetyStatus()


def shaped(
    wanted: float, last: float, low: float, high: float, speed: float, period: float
) -> float:
    """A setpoint [rad] that is finite, inside the range, and at most `speed` [rad/s] from the last
    one; the last one where nothing finite is wanted."""
    if not math.isfinite(wanted):
        wanted = last
    near = min(max(wanted, last - speed * period), last + speed * period)
    return min(max(near, low), high)
