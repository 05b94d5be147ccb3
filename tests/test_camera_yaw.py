"""The camera's yaw rate: its slope, the contract's flag, the simulated sensors, and training."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import onnx
import pytest

pytest.importorskip("stable_baselines3", reason="the train extra is not installed")

from tailbeat.control import camera_yaw
from tailbeat.control.measure import PAPER
from tailbeat.control.observation import TABLE, table
from tailbeat.control.policy import KEY, Contract, as_text, load_policy, policy_path
from tailbeat.env import sensors
from tailbeat.env.task import Settings, settings_for
from tailbeat.env.world import World
from tailbeat.evaluate.evaluation import EvaluationConfig, pool_of
from tailbeat.evaluate.scenes import grid
from tailbeat.evaluate.seeded_trial import TrialConfig, try_policy
from tailbeat.files import BadInput
from tailbeat.robot.fits import check_yaw_rate
from tailbeat.train.config import RunConfig, begin, check
from tailbeat.train.export import Facts, export
from test_learn import COLUMN, played, random_actions
from test_policy import FISH, run_of, sights, untrained

NAME = "pulley-fish-pool-generator"
CAMERA = Settings(yaw_rate="camera")


def with_contract(to: Path, contract: Contract) -> str:
    """The shipped policy's network with another contract."""
    model = onnx.load(str(policy_path(NAME)))
    (held,) = (one for one in model.metadata_props if one.key == KEY)
    held.value = as_text(contract)
    onnx.save(model, str(to))
    return str(to)


@pytest.fixture(scope="module")
def without_imu(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A policy that says it was trained without an IMU."""
    contract = load_policy(NAME).contract
    changed = replace(contract, yaw_rate="camera", observation=table(contract.measure, "camera"))
    return with_contract(tmp_path_factory.mktemp("policy") / "camera.onnx", changed)


# ---- the slope ----------------------------------------------------------------------------------


def rate(yaw: list[float], staleness: list[float]) -> float:
    return float(camera_yaw.yaw_rate(np.array([yaw]), np.array([staleness]))[0])


AGES = [0.04 + k / 60 for k in range(camera_yaw.FRAMES)]


@pytest.mark.parametrize("turning", [0.0, 1.5, -3.0])
def test_a_steady_turn_gives_its_rate_over_half_turns_and_uneven_times(turning):
    for start in (0.0, np.pi / 2 + 0.05 * turning, np.pi - 0.01, -np.pi + 0.01):
        for ages in (AGES, [0.04, 0.06, 0.11]):
            yaw = [float((start - turning * age + np.pi) % (2 * np.pi) - np.pi) for age in ages]
            assert rate(yaw, ages) == pytest.approx(turning, abs=1e-9)


def test_the_delay_is_half_of_the_frames_span():
    """Of a heading that accelerates, the slope is the rate in the middle."""
    middle = (AGES[0] + AGES[-1]) / 2
    assert rate([0.5 * 4.0 * age**2 for age in AGES], AGES) == pytest.approx(-4.0 * middle)
    assert middle - AGES[0] == pytest.approx(0.042, abs=0.001)


def test_the_noise_is_the_stated_one():
    noise = np.random.default_rng(0).normal(0, 0.01, (20_000, camera_yaw.FRAMES))
    found = camera_yaw.yaw_rate(noise, np.tile(AGES, (20_000, 1)))
    assert found.std() == pytest.approx(0.143, abs=0.005)


def test_too_few_frames_give_zero_and_old_ones_do_not_count():
    assert rate([1.0], [0.04]) == rate([1.0, 1.0], [0.04, 0.04]) == 0.0
    assert rate([1.0, 0.0], [0.04, 0.04 + 1.01 * camera_yaw.SPAN]) == 0.0
    fresh, hidden = [0.02, 0.01, 0.0], [5.0, 5.0]
    ages = [0.04, 0.05, 0.06, 0.5, 0.6]
    assert rate(fresh + hidden, ages) == pytest.approx(1.0)


# ---- the simulated sensors ----------------------------------------------------------------------


def test_the_policy_sees_the_slope_of_the_frames_that_have_arrived():
    actions = random_actions(40, 2)
    imu, camera = (World(FISH, one, [5, 6]) for one in (Settings(), CAMERA))
    with_imu, without = played(imu, actions), played(camera, actions)
    column = camera.simulator.qpos.shape[1] + camera.simulator.qvel.shape[1] + COLUMN["yaw rate"]
    other = np.any([a != b for a, b in zip(with_imu, without, strict=True)], axis=(0, 1))
    assert np.flatnonzero(other).tolist() == [column]  # the rest is the same, bit for bit
    frames = np.empty((2, camera_yaw.FRAMES, 6))
    sensors._gather(camera.seen.frames, camera.age * 0.02, frames)
    seen = camera_yaw.yaw_rate(frames[..., 2], frames[..., 5])
    assert without[-1][:, column] * 2.0 == pytest.approx(seen, abs=1e-6)
    assert np.all(np.diff(frames[..., 5], axis=1) >= 0) and frames[..., 5].min() > 0.03


def test_a_batch_equals_its_members_with_the_camera_s_rate():
    actions, seeds = random_actions(30, 4), [1, 2, 3, 4]
    together = played(World(FISH, CAMERA, seeds), actions)
    for i in range(4):
        alone = played(World(FISH, CAMERA, [seeds[i]]), actions[:, i : i + 1])
        assert all(np.array_equal(a[0], b[i]) for a, b in zip(alone, together, strict=True))


def test_frames_that_did_not_arrive_repeat_the_oldest():
    state = sensors.empty(1, 10)
    begun = sensors.quiet()
    sensors.begin(begun, state, 0, np.zeros(3), np.zeros(2), np.random.default_rng(0))
    state.frames[0, :, 6] = np.inf
    state.frames[0, 3, 6] = 0.0
    found = np.empty((1, 4, 6))
    sensors._gather(state.frames, np.zeros(1), found)
    assert np.all(found == found[:, :1])


# ---- the contract -------------------------------------------------------------------------------


def test_policies_of_before_have_an_imu_and_keep_their_text():
    contract = load_policy(NAME).contract
    model = onnx.load(str(policy_path(NAME)))
    (held,) = (one.value for one in model.metadata_props if one.key == KEY)
    assert contract.yaw_rate == "imu" and "yaw_rate" not in json.loads(held)["contract"]
    assert json.loads(as_text(contract)) == json.loads(held)
    assert settings_for(contract).yaw_rate == "imu"


def test_the_flag_travels_and_names_the_camera_in_the_table(without_imu):
    contract = load_policy(without_imu).contract
    assert contract.yaw_rate == "camera" and settings_for(contract).yaw_rate == "camera"
    assert [row.source for row in contract.observation if row.name == "yaw rate"] == ["camera"]
    assert [a.name for a, b in zip(contract.observation, TABLE, strict=True) if a != b] == [
        "yaw rate"
    ]


def test_a_flag_that_is_none_or_contradicts_the_table_is_refused(tmp_path):
    contract = load_policy(NAME).contract
    odd = with_contract(tmp_path / "odd.onnx", replace(contract, yaw_rate="gyro"))  # type: ignore
    with pytest.raises(BadInput, match="yaw rate comes from 'gyro'; allowed are imu, camera"):
        load_policy(odd)
    wrong = with_contract(tmp_path / "wrong.onnx", replace(contract, yaw_rate="camera"))
    with pytest.raises(BadInput, match=r"observation 3 is .*source='IMU'.*source='camera'"):
        load_policy(wrong)


def test_a_robot_s_yaw_rate_must_be_the_policy_s(without_imu):
    trained, camera = load_policy(NAME).contract, load_policy(without_imu).contract
    check_yaw_rate(trained, "/dev/ttyAMA0")
    check_yaw_rate(camera, "none")
    check_yaw_rate(trained, "none", forced=True)
    with pytest.raises(BadInput, match=r"trained with an IMU.*add --force-camera-yaw-rate"):
        check_yaw_rate(trained, "none")
    with pytest.raises(BadInput, match="trained without an IMU; give --imu none"):
        check_yaw_rate(camera, "/dev/ttyAMA0")
    with pytest.raises(BadInput, match="it needs --imu none"):
        check_yaw_rate(trained, "/dev/ttyAMA0", forced=True)


def test_trials_give_a_policy_the_yaw_rate_of_its_contract(without_imu):
    pool = pool_of(load_policy(without_imu), EvaluationConfig("pulley-fish", episodes=2))
    scene = grid(pool.fish, 2, 0, 0.5, 1.0, np.pi)
    assert pool.condition("a", scene).yaw_rate == pool.in_twin("b", scene).yaw_rate == "camera"
    assert pool_of(load_policy(NAME), EvaluationConfig("pulley-fish")).yaw_rate == "imu"


@pytest.mark.thorough
def test_a_policy_trained_with_an_imu_can_be_tried_without(without_imu):
    asked = TrialConfig(arc=30.0, targets=2, exact=True, newer=True)
    own = try_policy(NAME, "pulley-fish-pool", asked)
    forced = try_policy(NAME, "pulley-fish-pool", replace(asked, yaw_rate="camera"))
    other = try_policy(without_imu, "pulley-fish-pool", asked)
    assert vars(forced) == vars(other) != vars(own)


# ---- training -----------------------------------------------------------------------------------


def test_training_without_an_imu_sees_the_camera_s_rate_and_writes_the_flag(tmp_path):
    space = settings_for(load_policy(NAME).contract).actions
    assert space is not None
    run = replace(run_of(space), yaw_rate="camera", out=tmp_path)
    assert run.settings(0).yaw_rate == run.settings(9).yaw_rate == "camera"
    training: Facts = {"stage": "exact", "seed": 0}
    path = tmp_path / "policy.onnx"
    policy = export(untrained(space), run, sights(100), training, path)
    assert policy.contract.yaw_rate == load_policy(path).contract.yaw_rate == "camera"


def test_a_run_is_not_resumed_with_another_yaw_rate(tmp_path):
    space = settings_for(load_policy(NAME).contract).actions
    run = RunConfig(FISH, tmp_path, actions=space, yaw_rate="camera", measure=PAPER)
    begin(run)
    check(run, resume=True)
    with pytest.raises(BadInput, match="yaw_rate was camera, now imu"):
        check(replace(run, yaw_rate="imu"), resume=True)
    older = {name: one for name, one in asdict(run.record()).items() if name != "yaw_rate"}
    (tmp_path / "run.json").write_text(json.dumps(older))
    check(replace(run, yaw_rate="imu"), resume=True)
