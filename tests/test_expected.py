"""What a policy's file says of its swims: written, read back, bounded, and refused if it is odd."""

import json
import math
from dataclasses import replace
from pathlib import Path

import pytest

from tailbeat.control import expected as looks
from tailbeat.control.expected import Expected
from tailbeat.control.policy import load_policy, policy_path
from tailbeat.files import BadInput
from tailbeat.fish.store import load_fish
from tailbeat.robot.fits import check_swims
from tailbeat.train import expect

POLICY = load_policy("pulley-fish-pool-generator")
FISH = load_fish("pulley-fish")  # the pool's, which no policy was trained in
BIG = 10**400  # an integer that no float holds


@pytest.fixture(scope="module")
def known() -> Expected:
    assert POLICY.expected is not None
    return POLICY.expected


def test_what_is_written_into_a_policy_is_read_back_and_its_contract_stays(tmp_path, known):
    copy = tmp_path / "policy.onnx"
    copy.write_bytes(policy_path("pulley-fish-pool-generator").read_bytes())
    changed = replace(known, seconds=7.0)
    expect.write(copy, changed)
    back = load_policy(copy)
    assert back.expected == changed and back.contract == POLICY.contract


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("recoil", [1.0]),
        pytest.param("recoil", [BIG] * 20, id="a huge weight"),
        ("recoil", [math.nan, 1.0]),
        ("seconds", "a"),
        pytest.param("seconds", BIG, id="a huge time"),
        ("shaft", 3),
        ("limits", {}),
        ("least_rate", None),
        ("least_angle", 2.0),
    ],
)
def test_odd_expectations_are_one_sentence(tmp_path, known, field, value):
    content = json.loads(looks.as_text(known)) | {field: value}
    with pytest.raises(BadInput, match="policy expect"):
        looks.read(Path("policy.onnx"), json.dumps(content))
    with pytest.raises(BadInput, match="policy expect"):
        looks.read(Path("policy.onnx"), "[" * 100_000)


@pytest.mark.parametrize(
    ("part", "name", "value"),
    [
        ("limits", "turning", 1e300), ("limits", "drifting", 2.0), ("limits", "stroke_low", -1e300),
        ("limits", "stroke_high", 6.0), ("limits", "recoil_low", -9.0),
        ("limits", "recoil_high", math.inf), ("limits", "progress_low", -1.0),
        ("shaft", "kp", -1e9), ("shaft", "damping", -1.0), ("shaft", "inertia", 0.0),
        ("shaft", "stiffness", math.nan), ("shaft", "delay", 3.0),
    ],
)  # fmt: skip
def test_expectations_that_would_turn_a_monitor_off_are_refused(known, part, name, value):
    content = json.loads(looks.as_text(known))
    content[part][name] = value
    with pytest.raises(BadInput, match=name):
        looks.read(Path("policy.onnx"), json.dumps(content))


def test_tours_that_go_too_far_give_the_widest_bounds_that_a_file_may_have(known):
    wild = replace(known.limits, turning=9.0, stroke_low=-9.0, recoil_high=9.0)
    found = looks.bounded(replace(known, limits=wild))
    assert looks.read(Path("policy.onnx"), looks.as_text(found)) == found
    assert (found.limits.turning, found.limits.stroke_low, found.limits.recoil_high) == (1, -2, 5)
    assert looks.bounded(known) == known


def test_the_expected_shaft_has_the_servo_of_the_fish(known):
    """What a file says of its swims is in no digest of the contract."""
    check_swims(POLICY, None, FISH)
    other = replace(known, shaft=replace(known.shaft, kp=2 * known.shaft.kp))
    with pytest.raises(BadInput, match=r"expected kp of the servo is 10\.8278, here 5\.41388"):
        check_swims(replace(POLICY, expected=other), None, FISH)
