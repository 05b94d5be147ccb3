"""A fish's task is in its own measure; for the paper's fish the paper's numbers come out."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import onnx
import pytest

pytest.importorskip("stable_baselines3", reason="the train extra is not installed")

from tailbeat.control.measure import NEAR, PAPER, Measure, arrival_of, measure, preferred
from tailbeat.control.observation import TABLE, Samples, observe, scales, table
from tailbeat.control.policy import KEY, _digests, load_policy
from tailbeat.control.runner import Readings, begin, steer
from tailbeat.env import randomize
from tailbeat.env.curriculum import STAGES, settings_of
from tailbeat.env.measured import measure_of
from tailbeat.env.randomize import Randomisation
from tailbeat.env.task import Scene, Settings, Task, settings_for, sized
from tailbeat.env.world import World, seeds_from
from tailbeat.evaluate import disturb, out_of_distribution, reach, track
from tailbeat.evaluate.trial import Pool
from tailbeat.files import BadInput
from tailbeat.fish.first_draft import described
from tailbeat.fish.proportions import Given, sketch
from tailbeat.fish.store import load_fish, with_values
from tailbeat.identify.tag_pose import tracked_pose
from tailbeat.operator.tour import draw_targets
from tailbeat.pool.water import Water
from tailbeat.train.config import RunConfig, measured_run
from tailbeat.train.export import export
from tailbeat.train.spaces import action_space
from test_policy import FISH, sights, untrained

HALF = Measure(size=0.5, reach=0.4, speed=0.5, mass=0.3)
SMALL = described(sketch(Given(0.28, 0.35, 4, "xl330")))


@pytest.mark.parametrize("name", ["pulley-fish", "pulley-fish-pool"])
def test_the_paper_s_numbers_come_out_for_the_paper_s_fish(name):
    assert measure_of(load_fish(name)) == PAPER
    assert table(PAPER) == TABLE
    last = settings_of(STAGES[9], measure=measure_of(load_fish(name)))
    assert (last.task.nearest, last.task.farthest) == (0.5, 2.5)
    assert (last.task.seconds, last.task.limit) == (30.0, 6.0)
    assert (last.task.arrival, NEAR) == (0.05, 0.2)  # what the paper counts
    assert last.physics == Randomisation()
    assert RunConfig(FISH, FISH_OUT).discount == RunConfig(FISH, FISH_OUT).recipe.discount


FISH_OUT = Path()


def test_ratios_are_preferred_numbers_that_a_small_change_does_not_move():
    assert [preferred(one) for one in (0.9, 1.0, 1.1)] == [1.0, 1.0, 1.0]
    assert preferred(0.5) == preferred(0.52) == 0.501
    known = measure(0.27, 0.225, 0.156, 0.365)
    assert known == Measure(size=0.501, reach=0.501, speed=0.501, mass=0.316)
    assert measure(0.27, 0.225, 2 * 0.39, 0.365).reach == 2.0  # it turns in wide circles
    assert arrival_of(0.27) == known.arrival == pytest.approx(0.025, rel=0.01)
    assert known.near == 4 * known.arrival


def test_the_nearest_target_of_a_long_and_slow_fish_is_not_within_its_arrival():
    slow = measure(1.2, 0.04, 0.04, 15.0)
    task = sized(Task(), slow)
    assert task.nearest >= 2.4 * task.arrival


def test_a_small_fish_gets_a_small_task():
    own = measure_of(SMALL)
    assert own.size == 0.501 and own.mass == 0.316
    task = settings_of(STAGES[9], measure=own).task
    assert task.arrival == pytest.approx(0.025, rel=0.01)
    assert task.farthest == pytest.approx(2.5 * own.reach)
    assert task.seconds == pytest.approx(30 * own.time, abs=0.02)


def test_similar_swims_look_alike():
    """All lengths by the reach, speeds of turning by the time: the same observation."""
    rng = np.random.default_rng(0)
    frames = rng.uniform(-1, 1, (5, 3, 6))
    angle, speed, yaw_rate, phase = rng.uniform(-1, 1, (4, 5))
    raw = Samples(angle, speed, yaw_rate, phase, rng.uniform(-1, 1, (5, 3, 2)), frames)
    small = frames * [HALF.reach, HALF.reach, 1, HALF.reach, HALF.reach, 1]
    scaled = replace(raw, frames=small, yaw_rate=raw.yaw_rate / HALF.time)
    assert observe(scaled, HALF) == pytest.approx(observe(raw), abs=1e-6)


def test_a_world_in_another_measure_draws_and_ends_in_it():
    settings = settings_of(STAGES[9], measure=HALF)
    world = World(FISH, settings, seeds_from(0, 40), threads=1)
    world.reset()
    away = np.hypot(*(world.target - world.pose[:, :2]).T)
    assert (away >= 0.2 - 1e-9).all() and (away <= 1.0 + 1e-9).all() and away.max() > 0.8
    world.target = world.pose[:, :2] + [0.024, 0.0]  # within its 2.5 cm
    done = world.step(np.zeros((40, 6)))
    assert done.reached.all()
    world.reset()
    world.target = world.pose[:, :2] + [0.04, 0.0]  # within the paper's 5 cm only
    done = world.step(np.zeros((40, 6)))
    assert not done.reached.any()
    moved = np.hypot(*(world.target - world.pose[:, :2]).T)
    assert done.terms.distance == pytest.approx(-moved / HALF.reach)


def test_pushes_and_currents_follow_mass_and_speed():
    found = randomize.sized(Randomisation(), HALF)
    assert found.push == pytest.approx(0.3 * 0.3 * 0.5)
    assert found.current == pytest.approx(0.03 * 0.5)
    assert found.head_centre == pytest.approx(0.005 * 0.5)
    assert found.fluid == Randomisation().fluid


def test_a_fish_that_hardly_swims_is_refused_before_training(tmp_path):
    lame = with_values(FISH, {"servos.identified.force_limit": 0.02})
    with pytest.raises(BadInput, match="lengths a second, and a policy needs"):
        measured_run(RunConfig(lame, tmp_path / "run"))


# ---- in the contract ----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    path = tmp_path_factory.mktemp("small") / "policy.onnx"
    space = action_space("generator", FISH)
    run = RunConfig(FISH, path.parent, actions=space, measure=HALF)
    return path, export(untrained(space), run, sights(64), {"stage": "exact"}, path)


@pytest.mark.thorough
def test_the_contract_carries_the_measure_and_the_robot_observes_in_it(written):
    policy = load_policy(written[0])
    assert policy.contract.measure == HALF
    assert policy.contract.observation == table(HALF)
    frames = np.array([[0.0, 0.0, 0.0, 0.6, 0.2, 0.03]] * 3)
    _, decision = steer(policy, begin(policy), Readings(0.1, 0.2, 0.3, frames))
    assert decision.observation[12] * scales(HALF)[12] == pytest.approx(np.hypot(0.6, 0.2))
    assert decision.observation[13] == pytest.approx(0.6 / (2.0 * HALF.reach))


@pytest.mark.parametrize(
    ("held", "said"),
    [
        ({**asdict(HALF), "reach": -1.0}, "impossible ratios"),
        ({"size": 1.0}, "missing, unknown or impossible"),
        ({**asdict(HALF), "reach": "far"}, "impossible ratios"),
        ([1.0, 2.0], "missing, unknown or impossible"),
        ({**asdict(HALF), "reach": 0.5}, "observation 3 is"),
    ],
)
def test_a_measure_that_cannot_be_or_does_not_fit_is_refused(written, tmp_path, held, said):
    model = onnx.load(str(written[0]))
    found = {one.key: one.value for one in model.metadata_props}
    content = json.loads(found[KEY])["contract"] | {"measure": held}
    text = json.dumps({"contract": content, "digests": _digests(content)})
    onnx.helper.set_model_props(model, {KEY: text})
    onnx.save(model, str(tmp_path / "bad.onnx"))
    with pytest.raises(BadInput, match=said):
        load_policy(tmp_path / "bad.onnx")


# ---- in the trials ------------------------------------------------------------------------------


def test_every_trial_is_in_the_fish_s_measure():
    """Distances by the reach, times by the time, pushes by mass and speed."""
    space = action_space("generator", FISH)
    pools = [
        Pool(FISH, FISH, space, (Water(),), 8, 0, (5.5 * m.reach, 2.7 * m.reach), None, m)
        for m in (PAPER, HALF)
    ]
    for trial in (reach, disturb, out_of_distribution):
        for one, other in zip(*(trial.conditions(pool) for pool in pools), strict=True):
            assert other.task.seconds == pytest.approx(one.task.seconds * HALF.time, abs=0.02)
            assert other.task.arrival == one.task.arrival * HALF.size
            if one.name == "reach walled" or one.name.endswith("rear"):
                continue  # drawn inside walls, or turned about the head: the tag's place matters
            assert away(other.scene) == pytest.approx(away(one.scene) * HALF.reach)
    calm, poked = (disturb.conditions(pools[1])[i] for i in (0, 3))
    assert calm.measure == HALF
    first = disturb.conditions(pools[0])[3].around[0].pokes[0]
    assert poked.around[0].pokes[0][2] == pytest.approx(first[2] * HALF.push)
    eights = [track.conditions(pool)[0].scene.target for pool in pools]
    assert np.abs(eights[1]).max() == pytest.approx(np.abs(eights[0]).max() * HALF.reach, rel=1e-3)


def away(scene: Scene) -> np.ndarray:
    """Distances (n,) [m] of the targets from the tags at the start."""
    return np.hypot(*(scene.target[:, 0] - tracked_pose(FISH, scene.start)[:, :2]).T)


def test_a_tour_of_a_small_fish_stays_about_the_middle():
    wide, narrow = draw_targets(30, 0), draw_targets(30, 0, measure=HALF)
    assert narrow == pytest.approx(wide * HALF.reach)
    large = Measure(2.0, 2.5, 1.0, 8.0)
    with pytest.raises(BadInput, match="too small to turn in"):
        draw_targets(3, 0, measure=large)


def test_a_policy_is_not_tried_in_worlds_of_another_measure(written):
    policy = load_policy(written[0])
    with pytest.raises(BadInput, match=r"take settings_for\(policy.contract\)"):
        reach.reach(policy, reach.in_twin(FISH, Settings(policy.contract.actions)), 2, 0)
    own = settings_for(policy.contract)
    assert own.task.arrival == 0.05 * HALF.size and own.measure == HALF
    assert reach.reach(policy, reach.in_twin(FISH, own), 2, 0).targets == 2
