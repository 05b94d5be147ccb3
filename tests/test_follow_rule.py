"""The hand-made rule that follows: its file is its formula, it is mirrored with its target, it asks
for the target's own velocity, and it keeps a target that a rule without that velocity loses."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from support import complaint

pytest.importorskip("torch", reason="the train extra is not installed")
pytest.importorskip("onnx", reason="the train extra is not installed")

from tailbeat.control.observation import FOLLOWING
from tailbeat.control.policy import decide
from tailbeat.env.assess import assess
from tailbeat.env.curriculum import FOLLOWING as STAGES
from tailbeat.env.curriculum import MOVING, settings_of, trained_speed
from tailbeat.env.world import World
from tailbeat.fish.store import load_fish
from tailbeat.train import follow_rule as rules
from tailbeat.train.config import RunConfig
from tailbeat.train.export import contract_of, model_of, save
from tailbeat.train.follow_rule import FollowRule, candidates, follow_layers, follow_rule_of
from tailbeat.train.recipes import recipe_of
from tailbeat.train.rule import make

FISH = "pulley-fish-pool"
ONE = FollowRule(0.75, 3.0, 2.0)
NAMES = [one.name for one in FOLLOWING]


def seen(place, velocity):
    """Observations (1, 28) of a target at `place` [m] with `velocity` [m/s], ahead and left."""
    found = np.zeros((1, 28), np.float32)
    for axis, name in enumerate(("ahead", "left")):
        found[0, NAMES.index(f"frame 0 (newest): target {name}")] = place[axis] / 2
        found[0, NAMES.index(f"target's velocity {name}")] = velocity[axis] / 0.5
    return found


def test_the_stroke_is_the_wanted_speed_and_the_centre_the_tangent_of_half_its_bearing():
    """In 2 s to a target 0.4 m ahead that goes away at 0.1 m/s: 0.3 m/s."""
    action = follow_rule_of(ONE)(seen((0.4, 0.0), (0.1, 0.0)))[0]
    assert action[2] == pytest.approx(0.3) and action[1] == 0.0 and action[0] == 0.75
    speed, bearing = 0.4, 0.8
    target = 2.0 * speed * np.array([np.cos(bearing), np.sin(bearing)])
    gentle = follow_rule_of(replace(ONE, gain=0.3))(seen(target, (0, 0)))[0]
    assert gentle[1] == pytest.approx(0.3 * np.tan(bearing / 2), rel=0.2)
    assert gentle[1] < 0.3 * np.tan(bearing / 2)  # softened


def test_beside_its_target_the_fish_goes_where_the_target_goes():
    action = follow_rule_of(ONE)(seen((0.0, 0.0), (0.0, 0.12)))[0]  # to the left
    assert action[2] == pytest.approx(0.12) and action[1] == 1.0
    rest = follow_rule_of(ONE)(seen((0.0, 0.0), (0.0, 0.0)))[0]
    assert rest[2] == pytest.approx(rules.LEAST) and rest[1] == 0.0


@pytest.mark.parametrize("place", [(0.5, 0.2), (-0.5, 0.01), (-0.02, 0.01), (2.0, -2.0)])
def test_a_mirrored_target_gives_a_mirrored_action(place):
    one, other = (follow_rule_of(ONE)(seen((place[0], k * place[1]), (0.1, k * 0.05)))[0]
                  for k in (1, -1))  # fmt: skip
    assert other == pytest.approx(one * [1, -1, 1, 1, 1, 1])
    assert np.isfinite(one).all() and (np.abs(one) <= 1).all()


def test_for_centimetres_behind_it_the_fish_does_not_turn_about():
    far, near = (follow_rule_of(ONE)(seen((-x, 0.1 * x), (0, 0)))[0, 1] for x in (1.0, 0.02))
    assert far == 1.0 and 0 < near < 0.1


def test_the_file_is_the_formula_and_its_contract_says_the_fastest_target(tmp_path):
    run = RunConfig(load_fish(FISH), Path("unused"), recipe_of("quick", "follow"))
    many = np.random.default_rng(0).uniform(-1, 1, (200, 28)).astype(np.float32)
    facts = {"target_speed": run.settings(0).task.target_speed}
    contract = contract_of(run, many[:16], follow_rule_of(ONE)(many[:16]), facts)
    policy = save(model_of(*follow_layers(ONE, 28), 6, contract), tmp_path / "rule.onnx")
    np.testing.assert_allclose(decide(policy, many), follow_rule_of(ONE)(many), atol=1e-5)
    assert policy.contract.version == 2 and trained_speed(policy.contract) == 0.25


@pytest.mark.thorough
def test_it_follows_and_without_the_target_s_velocity_it_lags(monkeypatch):
    """All noise and physics, targets that were not chosen by."""
    build = partial(World, load_fish(FISH), settings_of(STAGES[-1], task=MOVING))
    swims = assess(follow_rule_of(ONE), build, 40, 5)
    monkeypatch.setattr(rules, "METRES_A_SECOND", 0.0)
    blind = assess(follow_rule_of(ONE), build, 40, 5)
    assert swims.reached.mean() >= 0.85
    assert blind.apart.mean() > 1.1 * swims.apart.mean()


@pytest.mark.thorough
def test_the_better_of_two_is_chosen_and_written(tmp_path, monkeypatch):
    """A rule that wants to be there in a minute swims too slowly."""
    slow = replace(ONE, seconds=60.0)
    monkeypatch.setattr("tailbeat.train.rule.candidates", lambda: [slow, ONE])
    monkeypatch.setattr("tailbeat.train.rule.TUNED", 16)
    monkeypatch.setattr("tailbeat.train.rule.TRIED", 16)
    run = RunConfig(load_fish(FISH), Path("unused"), recipe_of("quick", "follow"))
    done = make(run, tmp_path / "rule.onnx", lambda *_: None)
    assert done.rule == ONE and done.mean_distance < 0.6


def test_there_are_twelve_to_choose_from_and_a_course_is_refused(tmp_path):
    assert len(set(candidates())) == 12
    words = ("--fish", FISH, "--task", "follow", "--course", "--out", tmp_path / "rule.onnx")
    assert "--course: of the rule that reaches targets" in complaint("policy", "rule", *words)
    assert "--task sprint" in complaint(
        "policy", "rule", *words[:2], "--task", "sprint", *words[-2:]
    )
