"""The hand-made rule that follows: its file is its formula, it is mirrored with its target, it asks
for the target's own velocity, a fish that is too fast glides, and without either of these two it is
farther from its target."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from support import complaint

pytest.importorskip("torch", reason="the train extra is not installed")
pytest.importorskip("onnx", reason="the train extra is not installed")

from tailbeat.cluster.jobs import map_jobs
from tailbeat.control.actions import PERIOD
from tailbeat.control.observation import FOLLOWING
from tailbeat.control.policy import decide
from tailbeat.env.assess import assess
from tailbeat.env.curriculum import FOLLOWING as STAGES
from tailbeat.env.curriculum import MOVING, settings_of, trained_speed
from tailbeat.env.world import World
from tailbeat.evaluate.scenes import follow
from tailbeat.fish.store import load_fish
from tailbeat.operator.paths import PATHS, lap_length
from tailbeat.train import follow_rule as rules
from tailbeat.train.config import RunConfig
from tailbeat.train.export import contract_of, model_of, save
from tailbeat.train.follow_rule import FollowRule, candidates, follow_layers, follow_rule_of
from tailbeat.train.recipes import recipe_of
from tailbeat.train.rule import make

FISH = "pulley-fish-pool"
ONE = FollowRule(0.75, 2.0, 0.05)
NAMES = [one.name for one in FOLLOWING]


def seen(place, velocity, own=0.0):
    """Observations (1, 28) of a target at `place` [m] with `velocity` [m/s], ahead and left, of a
    fish that swims at `own` [m/s]."""
    found = np.zeros((1, 28), np.float32)
    found[0, NAMES.index("own velocity ahead")] = own / 0.5
    for axis, name in enumerate(("ahead", "left")):
        found[0, NAMES.index(f"frame 0 (newest): target {name}")] = place[axis] / 2
        found[0, NAMES.index(f"target's velocity {name}")] = velocity[axis] / 0.5
    return found


def test_the_stroke_is_the_wanted_speed_and_the_centre_the_tangent_of_half_its_bearing(monkeypatch):
    """In 2 s to a target 0.4 m ahead that goes away at 0.1 m/s: 0.3 m/s, less 0.05."""
    action = follow_rule_of(ONE)(seen((0.4, 0.0), (0.1, 0.0), own=0.25))[0]
    assert action[2] == pytest.approx(0.25) and action[1] == 0.0 and action[0] == 0.75
    speed, bearing = 0.4, 0.8
    target = 2.0 * speed * np.array([np.cos(bearing), np.sin(bearing)])
    monkeypatch.setattr(rules, "GAIN", 0.3)
    gentle = follow_rule_of(ONE)(seen(target, (0, 0)))[0]
    assert gentle[1] == pytest.approx(0.3 * np.tan(bearing / 2), rel=0.2)
    assert gentle[1] < 0.3 * np.tan(bearing / 2)  # softened


def test_a_fish_that_is_slower_than_asked_beats_more_and_one_that_is_too_fast_glides():
    slow, fit, fast = (follow_rule_of(ONE)(seen((0.4, 0.0), (0.1, 0.0), own=u))[0, 2]
                       for u in (0.15, 0.25, 0.55))  # fmt: skip
    assert slow == pytest.approx(0.35) and fit == pytest.approx(0.25) and fast == 0.0


def test_beside_its_target_the_fish_goes_where_the_target_goes():
    action = follow_rule_of(ONE)(seen((0.0, 0.0), (0.0, 0.12)))[0]  # to the left
    assert action[2] == pytest.approx(2 * (0.12 - 0.05)) and action[1] == 1.0
    rest = follow_rule_of(ONE)(seen((0.08, 0.0), (0.0, 0.0)))[0]  # 0.04 m/s, so it rests
    assert rest[2] == 0.0 and rest[1] == 0.0


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


def without(rule, name):
    """The rule with an observed number put to 0."""
    steer, column = follow_rule_of(rule), NAMES.index(name)

    def decide(seen):
        seen = seen.copy()
        seen[:, column] = 0.0
        return steer(seen)

    return decide


@pytest.mark.slow
def test_it_follows_and_without_the_target_s_velocity_it_lags():
    """All noise and physics, targets that were not chosen by."""
    build = partial(World, load_fish(FISH), settings_of(STAGES[-1], task=MOVING))
    swims = assess(follow_rule_of(ONE), build, 40, 5)
    blind = assess(without(ONE, "target's velocity ahead"), build, 40, 5)
    assert swims.reached.mean() >= 0.85
    assert blind.apart.mean() > 1.1 * swims.apart.mean()


def away_on_a_slow_circle(decide, fish=6, seconds=40.0):
    """Mean distance [m] of fish in the twin from a target that goes round a circle at 0.06 m/s."""
    lap = lap_length(PATHS["circle"]) / 0.06
    scene = follow(load_fish(FISH), PATHS["circle"], lap, seconds, fish)
    settings = settings_of(STAGES[-1], task=replace(MOVING, seconds=seconds))
    world = World(load_fish(FISH), settings, list(range(fish)), scene=scene)
    seen, away = world.reset(), []
    for _ in range(round(seconds / PERIOD)):
        seen = world.step(decide(seen)).observation
        away.append(np.hypot(*(world.target - world.pose[:, :2]).T))
    return np.mean(away[round(5.0 / PERIOD) :])


@pytest.mark.thorough
def test_without_its_own_speed_it_is_too_fast_for_a_slow_target():
    """The shipped rule; 0.12 and 0.15 m with eight fish for 73 s."""
    rule = FollowRule(0.25, 1.0, 0.08)
    near = away_on_a_slow_circle(follow_rule_of(rule))
    assert away_on_a_slow_circle(without(rule, "own velocity ahead")) > 1.1 * near
    assert near < 0.2


@pytest.mark.slow
def test_the_better_of_two_is_chosen_and_written(tmp_path, monkeypatch):
    """A rule that wants to be there in a minute swims too slowly."""
    slow = replace(ONE, seconds=60.0)
    monkeypatch.setattr("tailbeat.train.rule.candidates", lambda: [slow, ONE])
    monkeypatch.setattr("tailbeat.train.rule.TUNED", 16)
    monkeypatch.setattr("tailbeat.train.rule.TRIED", 16)
    run = RunConfig(load_fish(FISH), Path("unused"), recipe_of("quick", "follow"))
    done = make(run, tmp_path / "rule.onnx", lambda *_: None, map_jobs)
    assert done.rule == ONE and done.mean_distance < 0.6


def test_there_are_twelve_to_choose_from_and_a_course_is_refused(tmp_path):
    assert len(set(candidates())) == 12
    words = ("--fish", FISH, "--task", "follow", "--course", "--out", tmp_path / "rule.onnx")
    assert "--course: of the rule that reaches targets" in complaint("policy", "rule", *words)
    assert "--task sprint" in complaint(
        "policy", "rule", *words[:2], "--task", "sprint", *words[-2:]
    )
