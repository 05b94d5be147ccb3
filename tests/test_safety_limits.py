"""Every safety limit acts at exactly its value, and at no value that is better."""

import math
from dataclasses import fields, replace

import pytest

from tailbeat.link.status import State
from tailbeat.robot.safety import Health, SafetyLimits, SafetyStatus, judge

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
OTHERWISE = {"voltage_low": 9.5, "voltage_high": 16.0, "slew": 20.0, "ramp": 1.0}


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
    for end, beyond in ((9.5, 0.0), (16.0, 99.0)):
        assert state(voltage=end) is State.RUN
        assert state(voltage=math.nextafter(end, beyond)) is State.HOLD


def test_a_pose_may_be_ahead_by_as_much_as_the_clocks_may_differ():
    assert state(pose_age=-0.05) is State.RUN
    assert state(pose_age=math.nextafter(-0.05, -1)) is State.HOLD


def test_every_limit_has_its_value_here():
    here = {name for name, *_ in AT_LEAST} | set(OTHERWISE)
    assert here == {one.name for one in fields(SafetyLimits)}
    assert {name: getattr(LIMITS, name) for name in OTHERWISE} == OTHERWISE
