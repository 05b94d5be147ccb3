"""The hand-made steering rule: its file is its formula, it turns towards the target, and it reaches
targets that it was not chosen by. It is what a learned policy has to beat."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from support import complaint

pytest.importorskip("torch", reason="the train extra is not installed")
pytest.importorskip("onnx", reason="the train extra is not installed")

from tailbeat.cluster.jobs import map_jobs
from tailbeat.control.observation import REMEMBERING
from tailbeat.control.policy import decide, load_policy
from tailbeat.evaluate.seeded_trial import TrialConfig, try_policy
from tailbeat.fish.store import load_fish
from tailbeat.train import rule as rules
from tailbeat.train.config import RunConfig
from tailbeat.train.export import contract_of, model_of, save
from tailbeat.train.rule import Rule, make, rule_of

FISH = "pulley-fish-pool"
ONE = Rule(0.2, 0.6, 6.0)
COURSE = replace(ONE, course=True)


def seen(distance, bearing, columns=24):
    """An observation (1, columns) of a target at a distance [m] and a bearing [rad]."""
    found = np.zeros((1, columns), np.float32)
    found[0, 12:15] = np.array([1.0, np.cos(bearing), np.sin(bearing)]) * distance / 2
    return found


@pytest.mark.parametrize("bearing", [0.0, 0.05, 1.0, 2.0, 3.1])
def test_the_centre_is_the_tangent_of_half_the_bearing_and_bounded(bearing):
    action = rule_of(Rule(0.2, 0.6, 0.3))(seen(1.5, bearing))[0]
    exact = 0.3 * np.tan(bearing / 2)
    assert 0.7 * min(exact, 0.3) <= action[1] + 1e-3 <= min(exact, 1.0) + 2e-3  # finite behind
    if bearing <= 1.0:
        assert action[1] == pytest.approx(exact, rel=0.04, abs=1e-3)
    assert action[[0, 2]] == pytest.approx([0.2, 0.6]) and not action[3:].any()
    mirrored = rule_of(Rule(0.2, 0.6, 0.3))(seen(1.5, -bearing))[0]
    assert mirrored[1] == -action[1]


def swimming(distance, bearing, speed, slip):
    """The same of a fish that swims at `speed` [m/s], `slip` [rad] to the left of its heading."""
    found = seen(distance, bearing, 42)
    names = [one.name for one in REMEMBERING]
    for name, size in (("ahead", np.cos(slip)), ("left", np.sin(slip))):
        found[0, names.index(f"own velocity {name}, fast average")] = speed * size / 0.5
    return found


@pytest.mark.parametrize("slip", [-0.4, 0.1, 0.5])
def test_a_rule_with_a_course_steers_what_lies_beside_the_course(slip):
    """An askew tag turns bearing and course alike: the action is nearly that of a straight one."""
    steer = rule_of(replace(COURSE, gain=0.3))
    straight, askew = (steer(swimming(1.5, 0.5 + one, 0.3, one))[0] for one in (0.0, slip))
    assert askew[1] == pytest.approx(straight[1], rel=0.15) and straight[1] > 0.05
    plain = rule_of(replace(ONE, gain=0.3))(seen(1.5, 0.5 + slip))[0]
    assert abs(plain[1] - straight[1]) > abs(askew[1] - straight[1])
    mirrored = steer(swimming(1.5, -0.5 - slip, 0.3, -slip))[0]
    assert mirrored[1] == pytest.approx(-askew[1], abs=1e-6)


def test_a_fish_at_rest_or_going_backward_keeps_its_heading():
    steer, plain = rule_of(replace(COURSE, gain=0.3)), rule_of(replace(ONE, gain=0.3))
    for speed in (0.0, -0.2):
        assert steer(swimming(1.5, 0.7, speed, 0.0))[0, 1] == pytest.approx(
            plain(seen(1.5, 0.7))[0, 1], rel=0.02
        )


def test_the_file_of_a_rule_with_a_course_is_its_formula(tmp_path):
    run = RunConfig(load_fish(FISH), Path("unused"), averages=True)
    rng = np.random.default_rng(0)
    drawn = rng.uniform([0.02, -3, -0.3, -3], [3, 3, 0.5, 3], (200, 4))
    many = np.concatenate([swimming(*one) for one in drawn])
    contract = contract_of(run, many[:16], rule_of(COURSE)(many[:16]), {})
    policy = save(model_of(*rules.layers(COURSE, 42), 6, contract), tmp_path / "rule.onnx")
    np.testing.assert_allclose(decide(policy, many), rule_of(COURSE)(many), atol=1e-5)
    assert policy.contract.version == 3


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A rule of one candidate, for the time that twelve take, and of fewer targets."""
    with pytest.MonkeyPatch.context() as patch:
        for name, value in (("FREQUENCIES", (0.0,)), ("STROKES", (0.6,)), ("GAINS", (1.0, 12.0))):
            patch.setattr(rules, name, value)
        patch.setattr(rules, "TUNED", 24)
        patch.setattr(rules, "TRIED", 40)
        path = tmp_path_factory.mktemp("rule") / "rule.onnx"
        return path, make(
            RunConfig(load_fish(FISH), Path("unused")), path, lambda *_: None, map_jobs
        )


@pytest.mark.thorough
def test_the_file_is_the_formula_and_names_its_constants(made):
    path, done = made
    policy = load_policy(path)
    rng = np.random.default_rng(0)
    many = np.concatenate([seen(d, b) for d, b in rng.uniform([0.02, -3], [3, 3], (200, 2))])
    np.testing.assert_allclose(decide(policy, many), rule_of(done.rule)(many), atol=1e-5)
    assert policy.contract.training["recipe"] == "steering rule"
    assert policy.contract.training["gain"] == done.rule.gain


@pytest.mark.thorough
def test_the_better_of_two_gains_is_chosen_and_reaches_other_targets(made):
    """A gain of 1 turns too slowly: in the twin it reaches a tenth of the targets."""
    path, done = made
    assert done.rule.gain == 12.0 and done.reached > 0.9
    found = try_policy(str(path), FISH, TrialConfig(arc=180, targets=40, seed=99))
    assert found.reached > 0.9


@pytest.mark.thorough
def test_a_crank_and_a_file_that_exists_are_refused(made, tmp_path):
    path, _ = made
    assert "exists" in complaint("policy", "rule", "--fish", FISH, "--out", path)
    said = complaint("policy", "rule", "--fish", "crank-fish", "--out", tmp_path / "r.onnx")
    assert "needs a generator" in said and not list(tmp_path.iterdir())


@pytest.mark.thorough
def test_in_other_processes_a_rule_swims_to_the_bit_as_in_this_one():
    score = partial(rules._scored, RunConfig(load_fish(FISH), Path("unused")), 8)
    two = [ONE, replace(ONE, gain=1.0)]
    here, elsewhere = [score(one) for one in two], map_jobs(score, two, lambda *_: None)
    assert here == elsewhere and here[0] != here[1]
