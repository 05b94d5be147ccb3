"""Shares and their intervals, and what the shipped policies do in twin and pool."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("stable_baselines3", reason="the train extra is not installed")

from policies import POLICIES, trained_in
from tailbeat.cli.options import SHIPPED
from tailbeat.control.actions import PERIOD
from tailbeat.control.policy import check_fits, decide, load_policy
from tailbeat.env.curriculum import OPEN_WATER, STAGES, Stage, settings_of
from tailbeat.env.task import Scene
from tailbeat.env.world import seeds_from
from tailbeat.evaluate import trial
from tailbeat.evaluate.evaluation import EvaluationConfig, pool_of
from tailbeat.evaluate.rates import wilson
from tailbeat.evaluate.reach import by_sector, in_pool, in_twin, reach
from tailbeat.evaluate.runs import surge
from tailbeat.evaluate.seeded_trial import TrialConfig, try_policy
from tailbeat.evaluate.spectrum import windows
from tailbeat.evaluate.tour import tour
from tailbeat.files import BadInput
from tailbeat.fish.store import digest, fish_path, load_fish, with_servo
from tailbeat.pool.water import Water, ensemble

TWIN, FISH = load_fish("pulley-fish-pool"), load_fish("pulley-fish")
FRONT = Stage("trial", 3, 1.0, 1.0, float(np.radians(120)))
BEST = "pulley-fish-pool-generator"
# The default is `far-2`, polished with targets up to 4 m away. `hard-0` was the default before.
RESTING = [
    (SHIPPED, False), ("pulley-fish-pool-far-2", True), ("pulley-fish-pool-hard-0", False)
]  # fmt: skip


def test_wilson_s_interval_is_the_published_one():
    """Newcombe, Statistics in Medicine 17 (1998), table I: 81 of 263, and 0 of 20."""
    assert wilson(81, 263) == pytest.approx([0.2553, 0.3662], abs=1e-4)
    assert wilson(0, 20) == pytest.approx([0.0, 0.1611], abs=1e-4)


def test_sectors_take_both_sides_and_every_target_once():
    bearing = np.radians([-179.9, 180.0, 10.0, -10.0, 95.0, 30.0])
    reached = np.array([True, False, True, True, False, True])
    seconds = np.array([8.0, 30.0, 4.0, 5.0, 30.0, 6.0])
    rows = by_sector(bearing, reached, np.ones(6, bool), seconds)
    assert {(row.low, row.high): row.targets for row in rows} == {
        (0, 30): 2, (30, 60): 1, (90, 120): 1, (150, 180): 2,
    }  # fmt: skip
    assert rows[-1].arrived == 0.5 and rows[-1].near == 1.0
    assert rows[0].p90_s == 5.0  # of 4 and 5 s
    assert rows[-1].p90_s is None  # one of two never came


@pytest.mark.parametrize("name", POLICIES)
def test_the_policies_fit_the_twin_of_their_training(name):
    """With the servo that their name says: the idealised one fits no other."""
    contract = load_policy(POLICIES[name]).contract
    servo = "idealised" if name.endswith("idealised") else "identified"
    twin = with_servo(load_fish(trained_in(name)), servo)
    check_fits(contract, twin.name, digest(twin), twin.band, PERIOD)
    assert contract.training["versions"]["engine"] == "4.0.0"


def test_a_trial_in_pools_is_of_the_policy_s_own_body(tmp_path):
    """The contract's digest was compared with itself: any fish of an equal band was accepted."""
    path = tmp_path / "longer.toml"
    path.write_text(fish_path("pulley-fish").read_text().replace('"180 g"', '"190 g"'))
    config = TrialConfig(targets=2, pools=1)
    assert try_policy(str(BEST), "pulley-fish", config).targets == 2
    with pytest.raises(BadInput, match="the policy's fish is not the pool's"):
        try_policy(str(BEST), str(path), config)


def test_the_shipped_generator_reaches_its_targets_in_twin_and_pool():
    """Far below what the documentation reports of a thousand: here are but forty each."""
    policy = load_policy(BEST)
    settings = settings_of(FRONT, policy.contract.actions)
    twin = reach(policy, in_twin(TWIN, settings), 40, seed=3)
    pool = reach(policy, in_pool(FISH, settings, ensemble(8, 1)), 40, seed=3)
    assert twin.arrived > 0.9, twin
    assert pool.arrived > 0.9, pool


@pytest.mark.thorough
def test_the_shipped_generator_does_not_circle_a_target_behind_it():
    """Seed 0, which reached 998 of 1,000 targets in its twin, needs up to 25 s for these, and in a
    tour of the whole robot it circled the first target for 30 s. The shipped one needs 10 s."""
    policy = load_policy(BEST)
    behind = replace(OPEN_WATER, least_arc=float(np.radians(165)))
    settings = settings_of(STAGES[-1], policy.contract.actions, behind)
    found = reach(policy, in_pool(FISH, settings, [Water()]), 50, seed=1)
    assert found.arrived == 1.0, found
    assert found.slowest_seconds is not None and found.slowest_seconds < 14, found


@pytest.mark.thorough
def test_the_shipped_generator_does_not_back_off_in_the_twin():
    """Two-second pieces with everything drawn, targets all round. The policies of the twin that
    was not the identified one went backward in half of them; the pool's fish never does."""
    policy, count = load_policy(BEST), 120  # of 40, two pieces are 2 %
    rng = np.random.default_rng(4)
    bearing, distance = rng.uniform(-np.pi, np.pi, count), rng.uniform(0.5, 2.5, count)
    target = distance[:, None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
    start = np.zeros((count, 3))
    scene = Scene(start, start, target[:, None], np.full(count, np.inf))
    condition = trial.Condition("twin", TWIN, scene, policy.contract.actions, None)
    runs = trial.swim(lambda seen: decide(policy, seen), condition, seeds_from(5, count))
    speed = surge(runs)
    pieces = {way: len(list(windows(runs, speed, way))) for way in (1, -1)}
    assert pieces[1] > 50 and pieces[-1] <= 0.02 * pieces[1], pieces


@pytest.mark.thorough
@pytest.mark.parametrize(("name", "rests"), RESTING[:2])
def test_a_trial_with_far_targets_shows_a_policy_that_rests(name, rests):
    """As docs/how-to/choose-a-seed.md has it. At the usual distances both reach all of them."""
    config = TrialConfig(180, 40, 7, pools=1, least_arc=165, nearest=3.5, farthest=4)
    found = try_policy(str(POLICIES[name]), "pulley-fish", config)
    assert (found.slowest_seconds is None or found.slowest_seconds > 14) == rests, found
    usual = try_policy(
        str(POLICIES[name]), "pulley-fish", replace(config, nearest=None, farthest=None)
    )
    assert usual.slowest_seconds is not None and usual.slowest_seconds < 14, usual


@pytest.mark.thorough
@pytest.mark.parametrize(("name", "rests"), RESTING)
def test_the_default_does_not_rest_where_a_target_is_far_behind(name, rests):
    """From end to end of the pool, the next target always behind and 3.7 m away: farther than any
    in training or trials. Seed 2 of `far` waits there for up to 30 s, and clean labs do not show
    it. Polished with targets up to 4 m away, it does not."""
    policy = load_policy(POLICIES[name])
    places = np.random.default_rng(5).uniform(-0.6, 0.6, 30)
    ends = np.column_stack([1.85 * (-1.0) ** np.arange(30), places])
    pool = pool_of(policy, EvaluationConfig(twin=trained_in(name)))
    found = tour(policy, pool, ends, 3, lambda *_: None)
    assert (found.seconds.max() > 14) == rests, found.seconds
    assert found.reached.all() or rests, found.nearest
