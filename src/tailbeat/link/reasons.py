"""Why the robot is in its state: one reason for log, status and operator page, with its text."""

import math
from enum import Enum


class Reason(Enum):
    """One cause each. The value is the text. `text_of` fills in `{value}` [unit of the text],
    `{ms}` (the value in milliseconds) and `{note}`."""

    NOT_ARMED = "not armed yet"
    ARMED = "armed"
    TESTING = "sign test: the tail beats and bends"
    SWIMMING = "swimming{note}"
    ARMING_FAILED = "arming failed: {note}"

    # The robot stops: torque off.
    STOP_ASKED = "stop asked by {note}"
    HARDWARE_ERROR = "the servo reports a hardware error: {note}"
    TORQUE_LOST = "the servo lost its torque: it restarted or shut down"
    SERVO_HOT = "servo at {value:.0f} deg C"
    SHAFT_STUCK = "the shaft does not follow: the tail is jammed, or the encoder is stuck"
    OVERCURRENT = "servo current {value:.1f} A"
    SERVO_LOST = "no servo for {value:.1f} s"
    POSE_LOST = "no pose for {value:.1f} s{note}"
    NO_WATCHDOG = "the watchdog process ended or hangs: torque would stay on if the loop failed"
    SIGN_TEST = "the sign test failed: {note}"

    # The robot holds: back to straight, with torque.
    NOT_A_NUMBER = "the policy's answer is not a number"
    BUS_WATCHDOG = "the servo's own watchdog stopped it"
    SERVO_LATE = "no servo for {ms:.0f} ms"
    YAW_RATE_LATE = "no yaw rate for {ms:.0f} ms"
    POSE_LATE = "no pose for {ms:.0f} ms{note}"
    CLOCK_JUMPED = "the station's clock jumped by {value:.2f} s"
    POSE_AHEAD = "a pose is {ms:.0f} ms in the future: a clock jumped"
    POSES_IMPLAUSIBLE = "{value:.0f} poses in a row are too far from the one before"
    IMU_FROZEN = "the IMU's numbers do not change"
    CLOCKS_UNKNOWN = "the clocks are not compared"
    NO_TARGET = "no target"
    TARGET_OUTSIDE = "the target is {note}"
    SERVO_WARM = "servo at {value:.0f} deg C, too warm to swim"
    SUPPLY = "supply {value:.1f} V"
    PERIODS_MISSED = "{value:.0f} periods missed within a second"
    LOG_FAILED = "the log cannot be written"
    SIGNALS_DISAGREE = "{note}"


REASONS = tuple(Reason)  # a status carries the index in this tuple


def text_of(reason: Reason, value: float = math.nan, note: str = "") -> str:
    """The reason as the operator reads it; `value` in the unit of the text, seconds for times."""
    return reason.value.format(value=value, ms=1e3 * value, note=note)
