"""An exported policy: its network is SB3's, and what it says is what runs."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("stable_baselines3", reason="the train extra is not installed")

import gymnasium
import torch
from stable_baselines3 import SAC

from support import complaint, tailbeat, tailbeat_process
from tailbeat.control import actions as act
from tailbeat.control.actions import Direct, Generator
from tailbeat.control.measure import Measure
from tailbeat.control.observation import REMEMBERING, TABLE
from tailbeat.control.policy import Policy, decide, load_policy
from tailbeat.env.task import Settings
from tailbeat.env.vector_env import FishEnv, FishVecEnv
from tailbeat.fish.store import load_fish
from tailbeat.train.config import RunConfig
from tailbeat.train.export import Facts, export
from tailbeat.train.export import act as act_of_sb3
from tailbeat.train.features import TargetFeatures

FISH = load_fish("pulley-fish-pool")
LOW, HIGH = FISH.motor.range or (-1.0, 1.0)
CLOSE_UP: dict[str, Any] = {
    "features_extractor_class": TargetFeatures,
    "features_extractor_kwargs": {"measure": Measure()},
}


def run_of(space: act.ActionSpace) -> RunConfig:
    return RunConfig(FISH, Path(), actions=space)


def untrained(actions: act.ActionSpace, seed: int = 0, **shape: Any) -> SAC:
    env = FishVecEnv(FISH, 1, Settings(actions=actions), seed=0)
    shape = {"net_arch": [32, 32], **shape}
    return SAC("MlpPolicy", env, policy_kwargs=shape, seed=seed, device="cpu")


def sights(count: int) -> np.ndarray:
    """Observations of real swims under random actions."""
    env = FishVecEnv(FISH, 8, seed=3)
    rng, found = np.random.default_rng(0), [np.asarray(env.reset())]
    while len(found) * 8 < count:
        found.append(np.asarray(env.step(rng.uniform(-1, 1, (8, 6)))[0]))
    return np.concatenate(found)[:count]


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, SAC, Policy]:
    space = Generator(LOW, HIGH)
    model, path = untrained(space), tmp_path_factory.mktemp("policy") / "policy.onnx"
    training: Facts = {"stage": "exact", "seed": 0}
    return path, model, export(model, run_of(space), sights(400), training, path)


def test_the_network_in_the_file_is_sb3_s(written):
    _, model, policy = written
    seen = sights(1000)
    assert np.abs(decide(policy, seen) - act_of_sb3(model, seen)).max() <= 1e-6


def test_a_network_with_a_close_up_is_sb3_s_too(tmp_path):
    space = Generator(LOW, HIGH)
    model = untrained(space, **CLOSE_UP)
    policy = export(model, run_of(space), sights(400), {}, tmp_path / "policy.onnx")
    seen = sights(1000)
    assert np.abs(decide(policy, seen) - act_of_sb3(model, seen)).max() <= 1e-6


def test_a_close_up_gives_bearings_far_off_and_decimetres_near():
    """The table says which numbers are meant, so a change of its order or scales is followed."""
    seen = np.zeros((3, 24), dtype=np.float32)
    away, angle = np.array([2.5, 0.1, 0.01]), np.radians(30)
    for name, metres in (("distance", away), ("ahead", away * np.cos(angle)),
                         ("left", away * np.sin(angle))):  # fmt: skip
        entry = next(e for e in TABLE if e.name == f"frame 0 (newest): target {name}")
        seen[:, TABLE.index(entry)] = metres / entry.scale
    env = FishVecEnv(FISH, 1, seed=0)
    found = TargetFeatures(env.observation_space, Measure())(torch.as_tensor(seen)).numpy()
    assert np.array_equal(found[:, :24], seen)
    share = away / (away + 0.1)
    wanted = np.stack([share * np.cos(angle), share * np.sin(angle), 1 - share], axis=1)
    assert found[:, 24:] == pytest.approx(wanted, abs=1e-6)


def test_with_averages_the_target_is_seen_from_the_course_too():
    """A fish that swims 30 degrees to the left of its heading sees a target there straight
    ahead."""
    names, seen = [one.name for one in REMEMBERING], np.zeros((1, 42), np.float32)
    angle = np.radians(30)
    for name, metres in (("distance", 2.4), ("ahead", 2.4 * np.cos(angle)),
                         ("left", 2.4 * np.sin(angle))):  # fmt: skip
        seen[0, names.index(f"frame 0 (newest): target {name}")] = metres / 2.0
    for name, speed in (("ahead", 0.4 * np.cos(angle)), ("left", 0.4 * np.sin(angle))):
        seen[0, names.index(f"own velocity {name}, fast average")] = speed / 0.5
    space = gymnasium.spaces.Box(-np.inf, np.inf, (42,), np.float32)
    found = TargetFeatures(space, Measure())(torch.as_tensor(seen)).numpy()[0]
    assert np.array_equal(found[:42], seen[0]) and len(found) == 47
    far, moving = 2.4 / 2.5, 0.8 / 0.9
    assert found[45:] == pytest.approx([far * moving, 0.0], abs=1e-6)


def test_a_network_with_averages_is_sb3_s_too(tmp_path):
    run = RunConfig(FISH, Path(), actions=Generator(LOW, HIGH), averages=True)
    env = FishVecEnv(FISH, 8, run.settings(0), seed=3)
    model = SAC("MlpPolicy", env, policy_kwargs={"net_arch": [32, 32], **CLOSE_UP}, device="cpu")
    rng, met = np.random.default_rng(0), [np.asarray(env.reset())]
    for _ in range(60):
        met.append(np.asarray(env.step(rng.uniform(-1, 1, (8, 6)))[0]))
    seen = np.concatenate(met)
    policy = export(model, run, seen, {}, tmp_path / "policy.onnx")
    assert np.abs(decide(policy, seen) - act_of_sb3(model, seen)).max() <= 1e-6


def test_a_thousand_recorded_steps_replay_to_the_bit(written):
    """What the env did is what a loop that knows nothing but the file would have done."""
    path, *_ = written
    env = FishEnv(FISH, seed=5)
    policy, seen = load_policy(path), env.reset(seed=5)[0]
    record = []
    for _ in range(1000):
        action = decide(policy, seen[None])
        record.append((seen, action, env.world.simulator.ctrl))
        seen, _, over, cut, _ = env.step(action[0])
        record[-1] = (*record[-1][:2], env.world.simulator.ctrl[0, 0].copy())
        if over or cut:
            break
    alone = load_policy(path)
    space = alone.contract.actions
    state = act.reset(space, 1)
    for seen, action, sent in record:
        again = decide(alone, seen[None])
        assert np.array_equal(again, action)
        state = act.step(space, state, again.astype(float), alone.contract.period)
        assert act.setpoint(space, state)[0] == sent


def test_a_floor_travels_in_the_contract(tmp_path):
    space = Generator(LOW, HIGH, floor=1.0)
    export(untrained(space), run_of(space), sights(64), {"stage": "x"}, tmp_path / "floor.onnx")
    found = load_policy(str(tmp_path / "floor.onnx")).contract.actions
    assert isinstance(found, Generator) and found.floor == 1.0


# ---- the verbs ----------------------------------------------------------------------------------


@pytest.mark.thorough
def test_show_diff_and_try_from_the_command_line(written, tmp_path):
    shown = tailbeat_process("policy", "show", written[0], "--json", tmp_path / "show.json")
    assert shown.returncode == 0 and "16 golden pairs agree" in shown.stdout
    assert json.loads((tmp_path / "show.json").read_text())["fish"] == FISH.name
    same = tailbeat("policy", "diff", written[0], written[0])
    assert same.returncode == 0 and "equal" in same.stdout
    space = Direct(LOW, HIGH)
    export(untrained(space), run_of(space), sights(64), {"stage": "x"}, tmp_path / "direct.onnx")
    other = tailbeat("policy", "diff", written[0], tmp_path / "direct.onnx")
    assert other.returncode == 1 and "actions.kind" in other.stdout
    args = ("--targets", 8, "--exact", "--farthest", 4, "--json", tmp_path / "try.json")
    tried = tailbeat("policy", "try", written[0], "--fish", FISH.name, *args)
    assert tried.returncode == 0, tried.stderr
    found = json.loads((tmp_path / "try.json").read_text())
    assert found["targets"] == 8 and 0 <= found["reached"] <= 1
    assert found["least_arc_deg"] == 0 and found["farthest_m"] == 4 and found["nearest_m"] is None
    assert found["slowest_seconds"] is None  # it misses some


def test_bad_input_is_one_sentence_and_exit_code_2(written, tmp_path):
    for words, refusal in (
        (("policy", "show", tmp_path / "none.onnx"), "no such file"),
        (("policy", "try", written[0], "--fish", "crank-fish"), "here crank-fish"),
        (("policy", "try", written[0], "--fish", FISH.name, "--arc", 999), "--arc 999"),
        (("policy", "try", written[0], "--fish", FISH.name, "--least-arc", 130), "--least-arc 130"),
        (("policy", "try", written[0], "--fish", FISH.name, "--farthest", 7), "--farthest 7"),
        (("policy", "try", written[0], "--fish", FISH.name, "--nearest", 3), "--nearest 3"),
        (("train", "--fish", FISH.name, "--out", tmp_path, "--recipe", "soup"), "--recipe soup"),
        (("train", "--fish", FISH.name, "--out", tmp_path, "--actions", "fins"), "--actions fins"),
        (("train", "--fish", FISH.name, "--out", tmp_path / "a", "--resume"), "no run to resume"),
    ):
        assert refusal in complaint(*words)
    assert not (tmp_path / "a").exists()
