"""When the robot may swim: every rule holds or stops, every limit acts at exactly its value."""

import math
import re
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import pytest

from tailbeat.link.reasons import Reason
from tailbeat.link.status import State
from tailbeat.robot.safety import (
    HOLDS,
    STOPS,
    Health,
    SafetyLimits,
    SafetyStatus,
    after_test,
    arm,
    disarm,
    first_broken,
    judge,
    run,
    shaped,
)

LIMITS, RUNNING = SafetyLimits(), SafetyStatus(State.RUN)
WELL = Health(pose_age=0.1, imu_age=0.02, servo_age=0.02, clock_doubt=0.005, target=True)
# Limit, its value, the field of Health it judges, and the state that it leads to.
AT_LEAST = (
    ("servo_hold", 0.06, "servo_age", State.HOLD),
    ("servo_stop", 0.5, "servo_age", State.STOP),
    ("imu_hold", 0.2, "imu_age", State.HOLD),
    ("pose_hold", 0.3, "pose_age", State.HOLD),
    ("pose_stop", 2.0, "pose_age", State.STOP),
    ("clock_doubt", 0.05, "clock_doubt", State.HOLD),
    ("temperature_hold", 65.0, "temperature", State.HOLD),
    ("temperature_stop", 75.0, "temperature", State.STOP),
    ("current_stop", 4.0, "current", State.STOP),
    ("overruns_hold", 10, "overruns", State.HOLD),
    ("jumps_hold", 6, "jumps", State.HOLD),
)
OTHERWISE = {
    "voltage_low": 9.88,
    "voltage_high": 16.0,
    "slew": 20.0,
    "ramp": 1.0,
    "own_watchdog": True,
}


def state(**changed: float) -> State:
    return judge(RUNNING, replace(WELL, **changed), LIMITS).state  # type: ignore[arg-type]


@pytest.mark.parametrize(("limit", "value", "field", "leads_to"), AT_LEAST)
def test_a_limit_acts_from_its_value_on(limit, value, field, leads_to):
    assert getattr(LIMITS, limit) == value
    below = value - 1 if isinstance(value, int) else math.nextafter(value, 0)
    assert state(**{field: value}) is leads_to
    assert state(**{field: below}) is not leads_to


def test_a_current_backwards_counts_as_much():
    assert state(current=-4.0) is State.STOP and state(current=-3.9) is State.RUN


def test_both_ends_of_the_supply_s_range_are_allowed():
    for end, beyond in ((9.88, 0.0), (16.0, 99.0)):
        assert state(voltage=end) is State.RUN
        assert state(voltage=math.nextafter(end, beyond)) is State.HOLD


def test_a_pose_may_be_ahead_by_as_much_as_the_clocks_may_differ():
    assert state(pose_age=-0.05) is State.RUN
    assert state(pose_age=math.nextafter(-0.05, -1)) is State.HOLD


def test_every_limit_has_its_value_here():
    here = {name for name, *_ in AT_LEAST} | set(OTHERWISE)
    assert here == {one.name for one in fields(SafetyLimits)}
    assert {name: getattr(LIMITS, name) for name in OTHERWISE} == OTHERWISE


# ---- rules --------------------------------------------------------------------------------------


def test_the_way_to_swim_leads_through_arming():
    safety_status = SafetyStatus()
    assert run(safety_status).state is State.DISARMED
    safety_status = arm(safety_status, WELL, LIMITS)
    assert safety_status.state is State.ARMED
    assert safety_status.text == "armed" and safety_status.value == 0
    safety_status = run(safety_status)
    assert judge(safety_status, WELL, LIMITS) == safety_status and safety_status.state is State.RUN
    assert safety_status.text == "swimming"


def test_the_sign_test_comes_between_arming_and_swimming_and_decides():
    testing = run(SafetyStatus(State.ARMED), test=True)
    assert testing.state is State.TEST and "sign test" in testing.text
    assert judge(testing, WELL, LIMITS) == testing
    assert judge(testing, replace(WELL, pose_age=0.4), LIMITS).state is State.HOLD
    assert after_test("").state is State.RUN
    stopped = after_test("the tail bends to the wrong side")
    assert stopped.state is State.STOP and stopped.text.endswith("to the wrong side")
    assert run(stopped) == stopped  # no order to swim leads past it


def test_a_warning_is_said_and_swims_on_and_goes():
    warned = judge(RUNNING, replace(WELL, warning="the camera turns"), LIMITS)
    assert warned.state is State.RUN and warned.text == "swimming; warning: the camera turns"
    assert judge(warned, WELL, LIMITS).text == "swimming"


def test_arming_clears_the_servo_s_own_watchdog_so_it_is_no_reason_to_refuse():
    assert arm(SafetyStatus(), replace(WELL, watchdog=True), LIMITS).state is State.ARMED


def test_a_servo_without_a_watchdog_has_no_rule_of_it():
    without = replace(LIMITS, own_watchdog=False)
    assert judge(RUNNING, replace(WELL, watchdog=True), without).state is State.RUN
    assert judge(RUNNING, replace(WELL, watchdog=True), LIMITS).state is State.HOLD


def test_what_nobody_has_measured_yet_keeps_it_from_arming():
    broken = {rule.reason for rule in HOLDS if rule.broken(Health(), LIMITS)}
    assert broken == {Reason.SERVO_LATE, Reason.YAW_RATE_LATE, Reason.POSE_LATE,
                      Reason.CLOCKS_UNKNOWN, Reason.NO_TARGET}  # fmt: skip


HOLD_CASES: dict[str, dict[str, Any]] = {
    "not a number": {"finite": False},
    "own watchdog": {"watchdog": True},
    "no servo for 80 ms": {"servo_age": 0.08},
    "no yaw rate for 250 ms": {"imu_age": 0.25},
    "no pose for 400 ms": {"pose_age": 0.4},
    "clocks are not compared": {"clock_doubt": math.inf},
    "no target": {"target": False},
    "servo at 66": {"temperature": 66.0},
    "supply 9.0 V": {"voltage": 9.0},
    "12 periods missed": {"overruns": 12},
    "log cannot be written": {"logging": False},
    "clock jumped by 5.00 s": {"clock_step": 5.0},
    "4000 ms in the future": {"pose_age": -4.0},
    "7 poses in a row": {"jumps": 7},
    "numbers do not change": {"imu_frozen": True},
    "the tail does not": {"signals": "the tail does not answer"},
    "the target is outside the pool": {"outside": "outside the pool"},
}
STOP_CASES: dict[str, dict[str, Any]] = {
    "asked by the operator page": {"stop_asked": "the operator page"},
    "hardware error": {"alert": True},
    "error: overload": {"hardware": "overload"},
    "does not follow": {"follows": False},
    "lost its torque": {"torque_lost": True},
    "servo at 76": {"temperature": 76.0},
    "current 4.2 A": {"current": -4.2},
    "no servo for 0.6 s": {"servo_age": 0.6},
    "no pose for 2.5 s": {"pose_age": 2.5},
    "watchdog process ended or hangs": {"guarded": False},
}


@pytest.mark.parametrize(("reason", "changed"), HOLD_CASES.items())
def test_what_makes_it_hold_latches_with_its_reason(reason, changed):
    running = SafetyStatus(State.RUN, Reason.SWIMMING)
    held = judge(running, replace(WELL, **changed), LIMITS)
    assert held.state is State.HOLD and reason in held.text
    assert judge(held, WELL, LIMITS) == held  # well again is not enough
    assert run(held) == held
    assert run(arm(held, WELL, LIMITS)).state is State.RUN
    if "watchdog" not in changed:  # arming clears the watchdog
        assert arm(SafetyStatus(), replace(WELL, **changed), LIMITS).state is State.DISARMED


@pytest.mark.parametrize(("reason", "changed"), STOP_CASES.items())
def test_what_makes_it_stop_stays_until_disarmed(reason, changed):
    for before in (State.ARMED, State.RUN, State.HOLD):
        safety_status = judge(SafetyStatus(before), replace(WELL, **changed), LIMITS)
        assert safety_status.state is State.STOP and reason in safety_status.text
        assert arm(safety_status, WELL, LIMITS).state is State.STOP
        assert run(safety_status).state is State.STOP
        assert arm(safety_status, WELL, LIMITS).text == f"{safety_status.text}; disarm first"
    assert arm(disarm(safety_status), WELL, LIMITS).state is State.ARMED


@pytest.mark.parametrize("changed", [*HOLD_CASES.values(), *STOP_CASES.values()])
def test_the_status_carries_the_size_of_what_was_measured(changed):
    """A pose 4 s ahead has an age of -4 s; the text says by how much. Without a number it is 0."""
    (measured,) = changed.values()
    number = isinstance(measured, int | float) and not isinstance(measured, bool)
    found = judge(SafetyStatus(State.RUN), replace(WELL, **changed), LIMITS)
    assert found.value == (abs(measured) if number and math.isfinite(measured) else 0.0)


def test_every_field_of_health_can_stop_or_hold():
    touched = {name for case in (*HOLD_CASES.values(), *STOP_CASES.values()) for name in case}
    assert touched == {one.name for one in fields(Health)} - {"warning", "strayed"}


def test_every_rule_has_a_case_and_a_text_of_its_own():
    kinds = [(State.HOLD, HOLDS, HOLD_CASES), (State.STOP, STOPS, STOP_CASES)]
    for state, rules, cases in kinds:
        found = {judge(SafetyStatus(State.RUN), replace(WELL, **changed), LIMITS)
                 for changed in cases.values()}  # fmt: skip
        assert {one.state for one in found} == {state}
        assert {one.reason for one in found} == {rule.reason for rule in rules}
    assert len({one.value for one in Reason}) == len(Reason.__members__)  # no alias of another


def test_what_is_not_a_number_holds():
    for name in ("pose_age", "imu_age", "servo_age", "clock_doubt", "temperature", "voltage"):
        nan: dict[str, Any] = {name: float("nan")}
        broken = replace(WELL, **nan)
        assert judge(SafetyStatus(State.RUN), broken, LIMITS).state is State.HOLD, name
    assert first_broken((*HOLDS, *STOPS), WELL, LIMITS) is None


def test_a_missing_pose_says_where_the_refused_ones_lie():
    where = ": the camera sees fish or target at 3.90, 0.10 m, outside the pool"
    for age in (0.4, 2.5):
        lost = replace(WELL, pose_age=age, strayed=where)
        assert judge(SafetyStatus(State.RUN), lost, LIMITS).text.endswith("s" + where)


def test_setpoints_stay_in_range_and_never_jump():
    assert shaped(1.0, 0.0, -1.4, 1.4, 20.0, 0.02) == pytest.approx(0.4)
    assert shaped(float("nan"), 0.3, -1.4, 1.4, 20.0, 0.02) == 0.3
    assert shaped(9.0, 1.3, -1.4, 1.4, 20.0, 0.02) == 1.4
    assert shaped(0.0, 1.2, -1.4, 1.4, LIMITS.ramp, 0.02) == pytest.approx(1.18)
    assert shaped(0.0, -1.2, -1.4, 1.4, LIMITS.ramp, 0.02) == pytest.approx(-1.18)
    angle = 1.2
    for _ in range(200):
        angle = shaped(0.0, angle, -1.4, 1.4, LIMITS.ramp, 0.02)
    assert angle == 0.0


# ---- the page that explains them ----------------------------------------------------------------

PAGE = Path(__file__).parents[1] / "docs" / "explain" / "safety.md"
STATED = {  # what the condition of each rule with a limit must say
    Reason.SERVO_HOT: f"{LIMITS.temperature_stop:g} °C",
    Reason.OVERCURRENT: f"{LIMITS.current_stop:g} A",
    Reason.SERVO_LOST: f"for {LIMITS.servo_stop:g} s",
    Reason.POSE_LOST: f"older than {LIMITS.pose_stop:g} s",
    Reason.SERVO_LATE: f"for {1e3 * LIMITS.servo_hold:g} ms",
    Reason.YAW_RATE_LATE: f"for {LIMITS.imu_hold:g} s",
    Reason.POSE_LATE: f"older than {LIMITS.pose_hold:g} s",
    Reason.POSE_AHEAD: f"more than {1e3 * LIMITS.clock_doubt:g} ms",
    Reason.CLOCKS_UNKNOWN: f"by {1e3 * LIMITS.clock_doubt:g} ms",
    Reason.POSES_IMPLAUSIBLE: f"{LIMITS.jumps_hold} poses",
    Reason.SERVO_WARM: f"{LIMITS.temperature_hold:g} °C",
    Reason.SUPPLY: f"{LIMITS.voltage_low:g} to {LIMITS.voltage_high:g} V",
    Reason.PERIODS_MISSED: f"{LIMITS.overruns_hold} periods",
}


def rules_on_the_page() -> list[tuple[str, str]]:
    """Condition and reason of every row under the two headings of rules, in their order."""
    sections = re.split(r"^## ", PAGE.read_text("utf-8"), flags=re.M)
    chosen = [part for part in sections if part.startswith("Rules that")]
    rows = re.findall(r"^\| (.*?) \| (.*?) \|$", "".join(chosen), flags=re.M)
    return [row for row in rows if row[0] != "condition"]


def test_the_page_lists_every_rule_with_its_limit_in_the_order_of_the_code():
    rules, rows = (*STOPS, *HOLDS), rules_on_the_page()
    read = [re.sub(r"{[^}]*}", "…", rule.reason.value) for rule in rules]
    assert [reason for _, reason in rows] == read
    said = {rule.reason: condition for rule, (condition, _) in zip(rules, rows, strict=True)}
    wrong = {reason for reason, text in STATED.items() if text not in said[reason]}
    assert not wrong
