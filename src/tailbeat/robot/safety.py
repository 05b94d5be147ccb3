"""When the robot swims, holds and stops: rules, limits, and the setpoints that are allowed.

No device and no clock: the loop passes what it knows (`Health`), the rules here give the state.
HOLD and STOP latch with their first reason. Arm again to leave HOLD; disarm to leave STOP.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from tailbeat.fish.description import Hardware
from tailbeat.link.reasons import Reason, text_of
from tailbeat.link.status import State

SAG = 0.04  # of the servo's lowest supply: the robot holds so much above it, and swims on no more
WARM, HOT = 15.0, 5.0  # deg C below the servo's own shutdown: the robot holds, stops


@dataclass(frozen=True)
class SafetyLimits:
    """Limits beyond which the robot holds or stops; chosen where no source is named. Those of the
    servo are the XW430-T200's here; `limits_for` takes the fish's own."""

    pose_hold: float = 0.3  # s: age of the newest pose
    pose_stop: float = 2.0  # s
    imu_hold: float = 0.2  # s without a yaw rate
    servo_hold: float = 0.06  # s without a reading: three periods
    servo_stop: float = 0.5  # s
    clock_doubt: float = 0.05  # s, largest error of a pose's age
    temperature_hold: float = 65.0  # deg C; the servo shuts down at 80
    temperature_stop: float = 75.0
    voltage_low: float = 9.88  # V: `SAG` above the servo's own limit, at which it reports an error
    voltage_high: float = 16.0
    current_stop: float = 4.0  # A, for longer than a beat
    overruns_hold: int = 10  # periods missed within a second
    jumps_hold: int = 6  # frames in a row whose pose is implausible
    slew: float = 20.0  # rad/s of the setpoint: above the generator's fastest
    ramp: float = 1.0  # rad/s of the return to straight
    own_watchdog: bool = True  # whether the servo has a watchdog; without one its rule is not used


def limits_for(hardware: Hardware) -> SafetyLimits:
    """The limits, with those of a fish's servo by its maker's numbers."""
    low, high = hardware.supply_range
    return SafetyLimits(
        temperature_hold=hardware.temperature_limit - WARM,
        temperature_stop=hardware.temperature_limit - HOT,
        voltage_low=round((1 + SAG) * low, 3),
        voltage_high=high,
        current_stop=hardware.current_limit,
        own_watchdog=hardware.family.startswith("dynamixel"),
    )


@dataclass(frozen=True)
class Health:
    """What the loop knows in one period.

    Ages [s] of the newest readings (infinite: none yet) and `clock_doubt` [s], the largest error of
    the clock offset (infinite: not compared). `target`: the newest pose has a target. Servo
    temperature [deg C], voltage [V], mean absolute current [A] and hardware `alert`; `hardware`
    names its errors. `torque_lost`: the servo has no torque although it was turned on. `watchdog`:
    the servo's own watchdog stopped it. `overruns`: periods missed within a second. `finite`: the
    policy gave a number. `logging`: the log is written. `stop_asked`: who requested a stop, or "".
    `imu_frozen`: the IMU's numbers do not change. `follows`: the shaft follows its setpoints.
    `jumps`: implausible poses in a row. `clock_step` [s]: jump of the station's clock since arming.
    `guarded`: the watchdog process would turn torque off if the loop failed. `outside` says
    where the pool ends if the set target lies outside it, else "". `signals` says what the robot's
    own signals contradict in, and `warning` what does not keep it from swimming; else "". `strayed`
    says where the newest poses lie, if that is outside the pool, else "".
    """

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
    outside: str = ""
    signals: str = ""
    warning: str = ""
    strayed: str = ""


@dataclass(frozen=True)
class SafetyStatus:
    """The state and its reason, the `value` that was measured (unit of the reason's text), and a
    `note`: who requested it, or which error. `refused`: arming was requested in STOP."""

    state: State = State.DISARMED
    reason: Reason = Reason.NOT_ARMED
    value: float = 0.0
    note: str = ""
    refused: bool = False

    @property
    def text(self) -> str:
        """The reason as the operator reads it."""
        first = "; disarm first" if self.refused else ""
        return text_of(self.reason, self.value, self.note) + first


@dataclass(frozen=True)
class Rule:
    """A condition for HOLD or STOP: `broken` tests it; `value` and `note` fill in the reason's
    text."""

    reason: Reason
    broken: Callable[[Health, SafetyLimits], bool]
    value: Callable[[Health], float] = lambda health: 0.0
    note: Callable[[Health], str] = lambda health: ""


# In order: the first broken rule gives the reason. In HOLDS, a NaN breaks the rule.
STOPS = (
    Rule(Reason.STOP_ASKED, lambda h, _: bool(h.stop_asked), note=lambda h: h.stop_asked),
    Rule(Reason.HARDWARE_ERROR, lambda h, _: h.alert or bool(h.hardware),
         note=lambda h: h.hardware or "not named yet"),
    Rule(Reason.TORQUE_LOST, lambda h, _: h.torque_lost),
    Rule(Reason.SERVO_HOT, lambda h, lim: h.temperature >= lim.temperature_stop,
         lambda h: h.temperature),
    Rule(Reason.SHAFT_STUCK, lambda h, _: not h.follows),
    Rule(Reason.OVERCURRENT, lambda h, lim: abs(h.current) >= lim.current_stop,
         lambda h: abs(h.current)),
    Rule(Reason.SERVO_LOST, lambda h, lim: h.servo_age >= lim.servo_stop, lambda h: h.servo_age),
    Rule(Reason.POSE_LOST, lambda h, lim: h.pose_age >= lim.pose_stop, lambda h: h.pose_age,
         lambda h: h.strayed),
    Rule(Reason.NO_WATCHDOG, lambda h, _: not h.guarded),
)  # fmt: skip
HOLDS = (
    Rule(Reason.NOT_A_NUMBER, lambda h, _: not h.finite),
    Rule(Reason.BUS_WATCHDOG, lambda h, lim: lim.own_watchdog and h.watchdog),
    Rule(Reason.SERVO_LATE, lambda h, lim: not h.servo_age < lim.servo_hold, lambda h: h.servo_age),
    Rule(Reason.YAW_RATE_LATE, lambda h, lim: not h.imu_age < lim.imu_hold, lambda h: h.imu_age),
    Rule(Reason.POSE_LATE, lambda h, lim: not h.pose_age < lim.pose_hold, lambda h: h.pose_age,
         lambda h: h.strayed),
    Rule(Reason.CLOCK_JUMPED, lambda h, _: h.clock_step != 0, lambda h: h.clock_step),
    Rule(Reason.POSE_AHEAD, lambda h, lim: h.pose_age < -lim.clock_doubt, lambda h: -h.pose_age),
    Rule(Reason.POSES_IMPLAUSIBLE, lambda h, lim: h.jumps >= lim.jumps_hold, lambda h: h.jumps),
    Rule(Reason.IMU_FROZEN, lambda h, _: h.imu_frozen),
    Rule(Reason.CLOCKS_UNKNOWN, lambda h, lim: not h.clock_doubt < lim.clock_doubt),
    Rule(Reason.NO_TARGET, lambda h, _: not h.target),
    Rule(Reason.TARGET_OUTSIDE, lambda h, _: bool(h.outside), note=lambda h: h.outside),
    Rule(Reason.SERVO_WARM, lambda h, lim: not h.temperature < lim.temperature_hold,
         lambda h: h.temperature),
    Rule(Reason.SUPPLY, lambda h, lim: not lim.voltage_low <= h.voltage <= lim.voltage_high,
         lambda h: h.voltage),
    Rule(Reason.PERIODS_MISSED, lambda h, lim: h.overruns >= lim.overruns_hold,
         lambda h: h.overruns),
    Rule(Reason.LOG_FAILED, lambda h, _: not h.logging),
    Rule(Reason.SIGNALS_DISAGREE, lambda h, _: bool(h.signals), note=lambda h: h.signals),
)  # fmt: skip


def first_broken(rules: Sequence[Rule], health: Health, limits: SafetyLimits) -> Rule | None:
    """The first rule that is broken, or None."""
    return next((rule for rule in rules if rule.broken(health, limits)), None)


def judge(before: SafetyStatus, health: Health, limits: SafetyLimits) -> SafetyStatus:
    """The status after one period of an armed or running robot; DISARMED and STOP do not change."""
    if before.state in (State.DISARMED, State.STOP):
        return before
    if rule := first_broken(STOPS, health, limits):
        return _status(State.STOP, rule, health)
    moves = before.state in (State.TEST, State.RUN)
    if moves and (rule := first_broken(HOLDS, health, limits)):
        return _status(State.HOLD, rule, health)
    return swimming(health.warning) if before.state is State.RUN else before


def arm(before: SafetyStatus, health: Health, limits: SafetyLimits) -> SafetyStatus:
    """ARMED if no rule is broken, else the state as before with the reason. STOP stays STOP. The
    servo's own watchdog is not tested, because arming resets it."""
    if before.state is State.STOP:
        return replace(before, refused=True)
    rule = first_broken((*STOPS, *HOLDS), replace(health, watchdog=False), limits)
    if rule:
        return _status(before.state, rule, health)
    return SafetyStatus(State.ARMED, Reason.ARMED)


def arming_failed(why: str) -> SafetyStatus:
    """DISARMED, because a device failed during arming."""
    return SafetyStatus(State.DISARMED, Reason.ARMING_FAILED, note=why)


def _status(state: State, rule: Rule, health: Health) -> SafetyStatus:
    return SafetyStatus(state, rule.reason, rule.value(health), rule.note(health))


def run(before: SafetyStatus, test: bool = False) -> SafetyStatus:
    """RUN if the state is ARMED, or TEST if the sign test comes first; else no change."""
    if before.state is not State.ARMED:
        return before
    return SafetyStatus(State.TEST, Reason.TESTING) if test else swimming()


def swimming(warning: str = "") -> SafetyStatus:
    """RUN, with a warning if there is one."""
    return SafetyStatus(State.RUN, Reason.SWIMMING, note=warning and f"; warning: {warning}")


def after_test(said: str) -> SafetyStatus:
    """RUN after a sign test that found nothing; else STOP with what it `said`."""
    return SafetyStatus(State.STOP, Reason.SIGN_TEST, note=said) if said else swimming()


def disarm(before: SafetyStatus) -> SafetyStatus:
    """DISARMED, whatever the state was."""
    return SafetyStatus()


def shaped(
    wanted: float, last: float, low: float, high: float, speed: float, period: float
) -> float:
    """Limit a setpoint [rad]: inside `low` to `high`, and at most `speed` [rad/s] from the last
    one. A setpoint that is not finite is replaced by the last one."""
    if not math.isfinite(wanted):
        wanted = last
    near = min(max(wanted, last - speed * period), last + speed * period)
    return min(max(near, low), high)
