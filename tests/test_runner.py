"""The robot's decisions are the environment's, to the bit; and when it may act on them."""

import math
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("onnxruntime")

from policies import POLICIES
from tailbeat.control.policy import decide, load_policy
from tailbeat.control.runner import Readings, begin, steer
from tailbeat.env.task import Settings
from tailbeat.env.world import World
from tailbeat.fish.store import load_fish
from tailbeat.link.reasons import Reason
from tailbeat.link.status import State
from tailbeat.robot.safety import (
    HOLDS,
    STOPS,
    Health,
    SafetyLimits,
    SafetyStatus,
    arm,
    disarm,
    first_broken,
    judge,
    run,
    shaped,
)

FISH, LIMITS = load_fish("pulley-fish-pool"), SafetyLimits()
WELL = Health(
    pose_age=0.04, imu_age=0.01, servo_age=0.01, clock_doubt=0.003, target=True
)  # fmt: skip


@pytest.mark.parametrize("name", POLICIES)
def test_a_swim_recorded_in_the_environment_is_replayed_to_the_bit(name, monkeypatch):
    """Noise, drops and delays on: the readings of 500 steps give the same 500 setpoints."""
    policy = load_policy(POLICIES[name])
    world = World(FISH, Settings(policy.contract.actions), [5])
    kept, observe_ = [], world._observe

    def keep(readings):
        kept.append(readings)
        return observe_(readings)

    monkeypatch.setattr(world, "_observe", keep)
    seen, sent = world.reset(), []
    for _ in range(500):
        done = world.step(np.asarray(decide(policy, seen), float))
        seen = done.observation
        sent.append(float(world.simulator.ctrl[0, 0]))
    course = begin(policy)
    for readings, setpoint in zip(kept, sent, strict=False):
        own = Readings(
            float(readings.motor_angle[0]),
            float(readings.motor_velocity[0]),
            float(readings.yaw_rate[0]),
            readings.frames[0],
        )
        course, decision = steer(policy, course, own)
        assert decision.setpoint == setpoint
    assert np.ptp(sent) > 0.5


def test_a_reading_that_is_no_number_gives_no_number_and_no_further_state():
    policy = load_policy("pulley-fish-pool-generator")
    course = begin(policy)
    bad = Readings(float("nan"), 0.0, 0.0, np.zeros((3, 6)))
    after, decision = steer(policy, course, bad)
    assert math.isnan(decision.setpoint) and after is course


# ---- safety -------------------------------------------------------------------------------------


def test_the_way_to_swim_leads_through_arming():
    safety_status = SafetyStatus()
    assert run(safety_status).state is State.DISARMED
    safety_status = arm(safety_status, WELL, LIMITS)
    assert safety_status.state is State.ARMED
    safety_status = run(safety_status)
    assert judge(safety_status, WELL, LIMITS) == safety_status and safety_status.state is State.RUN


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
    "watchdog process is gone": {"guarded": False},
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


def test_every_field_of_health_can_stop_or_hold():
    touched = {name for case in (*HOLD_CASES.values(), *STOP_CASES.values()) for name in case}
    assert touched == {one.name for one in fields(Health)}


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


def test_setpoints_stay_in_range_and_never_jump():
    assert shaped(1.0, 0.0, -1.4, 1.4, 20.0, 0.02) == pytest.approx(0.4)
    assert shaped(float("nan"), 0.3, -1.4, 1.4, 20.0, 0.02) == 0.3
    assert shaped(9.0, 1.3, -1.4, 1.4, 20.0, 0.02) == 1.4
    angle = 1.2
    for _ in range(200):
        angle = shaped(0.0, angle, -1.4, 1.4, LIMITS.ramp, 0.02)
    assert angle == 0.0
