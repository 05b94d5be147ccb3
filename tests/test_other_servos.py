"""Servos that the fit's model was not made for: another group's friction model and numbers."""

import math

import numpy as np
import pytest

from other_servos import MOTIONS, SERVOS, bench_of, friction, pendulum_log
from tailbeat.fish.store import load_fish
from tailbeat.identify.servo_job import identify_servo
from tailbeat.identify.servo_report import as_report
from tailbeat.identify.servo_search import Effort, ServoConfig
from tailbeat.identify.shaft import Bench

FISH = load_fish("pulley-fish")


def test_friction_is_that_of_the_paper():
    """By hand, for a servo that lifts: sums of products at rest, and without the slow part far
    above the Stribeck speed."""
    servo = SERVOS["mx64"]
    moved, rest = 0.31147 * 2 + 0.0 * 1, 0.18774 * 2 + 0.014066 * 1
    at_rest = 0.1227 + moved + rest + 0.01 * 1**2
    assert friction(servo, 2.0, -1.0, 0.0) == pytest.approx(at_rest)
    assert friction(servo, 2.0, -1.0, 1e3) == pytest.approx(moved + 0.025337 * 1e3)


def test_a_released_pendulum_falls_and_a_driven_one_follows():
    released = pendulum_log("mx106", "lift_and_drop", 32, (2.0, 0.15), 1)["entries"]
    assert released[0]["torque_enable"] and not released[-1]["torque_enable"]
    lifted = [e for e in released if e["torque_enable"]][-1]["position"]
    assert lifted == pytest.approx(-math.pi / 2, abs=0.2) and abs(released[-1]["position"]) < 0.4
    driven = pendulum_log("mx106", "sin_sin", 32, (1.0, 0.15), 2)["entries"]
    assert np.mean([abs(e["goal_position"] - e["position"]) for e in driven]) < 0.1


@pytest.mark.thorough
@pytest.mark.parametrize("make", ["mx64", "xl320"])
def test_a_load_and_a_gain_never_seen_are_predicted(make, tmp_path):
    """Asked before any were fitted: half the error of the best naive predictor. And of the readings
    of -pi every one is found, and nothing else is left out."""
    servo, planted = SERVOS[make], 0
    runs: dict[str, list[Bench]] = {"fit": [], "held": []}
    gains, (light, heavy) = servo.gains[-2:], sorted(servo.loads)
    for seed, (gain, load, motion) in enumerate(
        [(gains[0], light, m) for m in MOTIONS] + [(gains[1], heavy, m) for m in MOTIONS]
    ):
        log = pendulum_log(make, motion, gain, load, seed)
        if seed % 4 == 0:
            log["entries"][300]["position"] = -math.pi
        planted += sum(entry["position"] == -math.pi for entry in log["entries"])
        runs["fit" if load == light else "held"].append(bench_of(log, tmp_path, FISH))
    config = ServoConfig(seeds=1, effort=Effort(generations=60))
    report = as_report(identify_servo(FISH, runs["fit"], runs["held"], config, tmp_path))
    assert report["error_over_best_naive"] < 0.5
    assert sum(one["count"] for one in report["glitches"]) == planted >= 2
