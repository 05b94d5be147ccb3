"""The rows of a log: their fields with units, their schema, and a check of rows that are read."""

import json
import math
from pathlib import Path
from typing import Any

from tailbeat.files import BadInput

Row = dict[str, Any]
TOPIC = "/swim"
# What the head of a drive's log tells, which goes into a recording made of it.
NOTED = (
    "date", "policy", "policy_sha256", "contract", "fish_digest", "calibration", "yaw_rate",
    "sign_test", "tailbeat", "git", "onnxruntime", "python",
)  # fmt: skip
LONGEST = 40  # letters of a wrong value that a sentence shows
PLAIN, HUGE = {float, int, type(None)}, 1 << 1000  # no float holds a larger integer
# Fields of a row. A number that is not finite is left out of its row.
NUMBERS = {
    "time_s": "when the period was due, monotonic clock [s]",
    "command_rad": "setpoint that the servo was sent last [rad]",
    "setpoint_rad": "setpoint of the policy, before limits; while it swims [rad]",
    "motor_angle_rad": "shaft angle that the servo measured [rad]",
    "motor_velocity_rad_s": "shaft speed that the servo measured [rad/s]",
    "yaw_rate_rad_s": "yaw rate of IMU or camera, counter-clockwise positive [rad/s]",
    "x_m": "newest accepted pose: x in the pool [m]",
    "y_m": "newest accepted pose: y in the pool [m]",
    "yaw_rad": "newest accepted pose: heading, counter-clockwise from x [rad]",
    "pose_age_s": "time since the newest pose was captured [s]",
    "clock_doubt_s": "largest error of the clock offset [s]",
    "temperature_deg_c": "servo temperature [deg C]",
    "voltage_v": "supply at the servo, median of half a second [V]",
    "current_a": "mean servo current [A]",
    "band_share": "fraction of the tail's power below the band's upper edge",
    "below_band_share": "fraction of the tail's power below the band's lower edge",
    "late_s": "how late the period began [s]",
    "busy_s": "time from the start of the period to its row [s]",
    "compute_s": "processor time of the loop's thread in the period [s]",
    "missed": "periods missed within the last second",
    "spikes": "yaw rates rejected since the start",
    "pose_jumps": "implausible poses in a row",
    "signal_turning": "the camera's turning minus the IMU's, over 2 s [rad/s]",
    "signal_drifting": "the same over 2.5 s, minus the time before [rad/s]",
    "signal_stroke": "motor angle over the one that its setpoints lead to",
    "signal_weakening": "the same over 2 s, over its value before",
    "signal_recoil": "yaw rate over the one that the motor angle leads to",
    "signal_progress": "speed over the rms of the motor velocity [m]",
    "signal_same": "equal poses in a row",
    "signal_wander": "path of the target within 1 s, without its displacement [m]",
    "signal_left": "pull of the left tendon over the one that the motor angle leads to, over 2 s",
    "signal_right": "the same of the right tendon",
    "signal_obeyed": "share of its setpoints that the servo obeys, by its current, over 1 s",
    "signal_course": "direction in which the tag moves over 1 s, minus its heading [rad]",
}
ABSENT = dict.fromkeys(NUMBERS)  # a row without a number
ARRAYS = {
    "observation": "inputs of the policy, scaled; empty while it does not swim",
    "action": "outputs of the policy; empty while it does not swim",
    "decided_on": "three newest frames, newest first, each x, y, yaw, target x, target y, age"
    " [m, m, rad, m, m, s]; empty while the policy does not swim",
}
TEXTS = {
    "state": "disarmed, armed, test, run, hold or stop",
    "reason": "why it is in this state, as the operator reads it",
    "cause": "the reason's name",
}


def schema() -> dict[str, Any]:
    """JSON schema of a row, as Foxglove reads it: one type for each field, and no `null` (its
    parser refuses a list of types, and with it the whole topic)."""
    number, text = {"type": "number"}, {"type": "string"}
    listed = {"type": "array", "items": number}
    kinds = ((NUMBERS, number), (ARRAYS, listed), (TEXTS, text))
    fields = {n: {**kind, "description": d} for names, kind in kinds for n, d in names.items()}
    base = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "tailbeat.Row"}
    return {**base, "type": "object", "properties": fields, "additionalProperties": False}


def read_row(path: Path, number: int, text: bytes) -> Row:
    """A row from a message; a number that it lacks, or that is not finite, is None. Raises BadInput
    for a message that is no row of this package, with its number."""
    try:
        held = json.loads(text)
    except (RecursionError, ValueError):
        held = None
    if not isinstance(held, dict):
        raise BadInput(
            f"{path}: a message of {TOPIC} is not a JSON object; give a log of tailbeat."
        )
    for name, value in held.items():
        if (type(value) is not float or name not in NUMBERS) and (fault := _fault(name, value)):
            shown = repr(value)[:LONGEST]
            raise BadInput(
                f"{path}: row {number}: {name} is {shown}, not {fault}; give a log of `tailbeat"
                f" drive`."
            )
    endless = [name for name, one in held.items() if type(one) is float and not math.isfinite(one)]
    return {**ABSENT, **held, **dict.fromkeys(endless)}


def _fault(name: str, value: Any) -> str:
    """What a field's value should be; "" if it is, or if the field is not one of a row."""
    if name in NUMBERS:
        return "" if _are_numbers({type(value)}, [value]) else "a number"
    if name in TEXTS:
        return "" if isinstance(value, str) else "a text"
    if name in ARRAYS:
        listed = isinstance(value, list) and _are_numbers(set(map(type, value)), value)
        return "" if listed else "a list of numbers"
    return ""


def _are_numbers(kinds: set[type], values: list[Any]) -> bool:
    """Whether values of these types are numbers that a float holds, or None."""
    if int in kinds:
        return kinds <= PLAIN and all(abs(one) < HUGE for one in values if one is not None)
    return kinds <= PLAIN
