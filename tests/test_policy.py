"""A policy and its contract: what it says is what runs; what does not hold is refused by name."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("stable_baselines3", reason="the train extra is not installed")

import onnx
import torch
from stable_baselines3 import SAC

from policies import POLICIES
from support import complaint, tailbeat, tailbeat_process
from tailbeat.control import actions as act
from tailbeat.control.actions import PERIOD, Direct, Generator
from tailbeat.control.observation import TABLE
from tailbeat.control.policy import (
    Policy,
    _digests,
    as_text,
    check_fits,
    decide,
    differences,
    load_policy,
    shipped,
)
from tailbeat.env.task import Settings
from tailbeat.env.vector_env import FishEnv, FishVecEnv
from tailbeat.files import BadInput
from tailbeat.fish.store import digest, load_fish
from tailbeat.train.export import Facts, export
from tailbeat.train.export import act as act_of_sb3
from tailbeat.train.features import TargetFeatures

FISH = load_fish("pulley-fish-pool")
LOW, HIGH = FISH.motor.range or (-1.0, 1.0)


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
    return path, model, export(model, FISH, space, sights(400), training, path)


def changed(path: Path, to: Path, **fields: object) -> Path:
    """A copy of a policy with other contract fields, digests left alone."""
    model = onnx.load(str(path))
    held = json.loads(model.metadata_props[0].value)
    held["contract"].update(fields)
    model.metadata_props[0].value = json.dumps(held)
    onnx.save(model, str(to))
    return to


def test_the_network_in_the_file_is_sb3_s(written):
    _, model, policy = written
    seen = sights(1000)
    assert np.abs(decide(policy, seen) - act_of_sb3(model, seen)).max() <= 1e-6


def test_a_network_with_a_close_up_is_sb3_s_too(tmp_path):
    space = Generator(LOW, HIGH)
    model = untrained(space, features_extractor_class=TargetFeatures)
    policy = export(model, FISH, space, sights(400), {}, tmp_path / "policy.onnx")
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
    found = TargetFeatures(env.observation_space)(torch.as_tensor(seen)).numpy()
    assert np.array_equal(found[:, :24], seen)
    share = away / (away + 0.1)
    wanted = np.stack([share * np.cos(angle), share * np.sin(angle), 1 - share], axis=1)
    assert found[:, 24:] == pytest.approx(wanted, abs=1e-6)


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


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("period", 0.01),
        ("fish", "herring"),
        ("band", [0.5, 9.0]),
        ("actions", {**vars(Generator(LOW, HIGH)), "first": 5.3}),
        ("training", {"stage": "arc 180"}),
    ],
)
def test_a_tampered_field_is_named(written, tmp_path, field, value):
    with pytest.raises(BadInput, match=f"{field} changed after"):
        load_policy(changed(written[0], tmp_path / "p.onnx", **{field: value}))


@pytest.mark.parametrize(
    ("row", "other"),
    [
        (9, replace(TABLE[9], scale=2.7 * TABLE[9].scale)),
        (14, replace(TABLE[14], unit="km")),
        (12, TABLE[13]),
    ],
)
def test_a_policy_of_other_scales_units_or_order_is_refused(written, tmp_path, row, other):
    """The paper's own accident: signed anew, so that the digests agree, and wrong all the same."""
    table = [*TABLE[:row], other, *TABLE[row + 1 :]]
    model = onnx.load(str(written[0]))
    model.metadata_props[0].value = as_text(replace(written[2].contract, observation=tuple(table)))
    onnx.save(model, str(tmp_path / "p.onnx"))
    with pytest.raises(BadInput, match=f"observation {row} is"):
        load_policy(tmp_path / "p.onnx")


def test_unknown_versions_and_strangers_are_refused(written, tmp_path):
    with pytest.raises(BadInput, match="contract version 7"):
        load_policy(changed(written[0], tmp_path / "p.onnx", version=7))
    (tmp_path / "text.onnx").write_text("not a network")
    with pytest.raises(BadInput, match="not a readable ONNX"):
        load_policy(tmp_path / "text.onnx")
    bare = onnx.load(str(written[0]))
    del bare.metadata_props[:]
    onnx.save(bare, str(tmp_path / "bare.onnx"))
    with pytest.raises(BadInput, match="without a contract"):
        load_policy(tmp_path / "bare.onnx")
    with pytest.raises(BadInput, match="no such file"):
        load_policy(tmp_path / "none.onnx")
    with pytest.raises(BadInput, match=r"examples/policies .* pulley-fish-pool-signal\.onnx"):
        load_policy("pulley-fish-pool-signal")


def test_one_policy_is_shipped_and_seven_are_kept_as_evidence():
    assert list(shipped()) == ["pulley-fish-pool-generator"]
    assert len(POLICIES) == 8


def test_a_contract_from_before_the_floor_still_loads(written, tmp_path):
    path, _, policy = written
    model = onnx.load(str(path))
    held = json.loads(model.metadata_props[0].value)
    assert held["contract"]["actions"].pop("floor") == 0.0
    held["digests"] = _digests(held["contract"])
    model.metadata_props[0].value = json.dumps(held)
    onnx.save(model, str(tmp_path / "old.onnx"))
    old = load_policy(str(tmp_path / "old.onnx")).contract
    assert old == policy.contract and differences(old, policy.contract) == []


def test_a_floor_travels_in_the_contract(tmp_path):
    space = Generator(LOW, HIGH, floor=1.0)
    export(untrained(space), FISH, space, sights(64), {"stage": "x"}, tmp_path / "floor.onnx")
    found = load_policy(str(tmp_path / "floor.onnx")).contract.actions
    assert isinstance(found, Generator) and found.floor == 1.0


def test_other_weights_fail_the_golden_pairs(written, tmp_path):
    model = onnx.load(str(written[0]))
    weights = onnx.numpy_helper.to_array(model.graph.initializer[0]).copy()
    weights[0, 0] += 0.5
    model.graph.initializer[0].CopyFrom(onnx.numpy_helper.from_array(weights, "w0"))
    onnx.save(model, str(tmp_path / "p.onnx"))
    with pytest.raises(BadInput, match="golden actions are off"):
        load_policy(tmp_path / "p.onnx")


def test_a_policy_for_another_fish_band_or_period_is_refused(written):
    contract = written[2].contract
    check_fits(contract, FISH.name, digest(FISH), FISH.band, PERIOD)
    with pytest.raises(BadInput, match="fish is pulley-fish-pool, here crank-fish"):
        check_fits(contract, "crank-fish", "", FISH.band, PERIOD)
    with pytest.raises(BadInput, match="description has changed"):
        check_fits(contract, FISH.name, "0", FISH.band, PERIOD)
    with pytest.raises(BadInput, match=r"band is 1-4 Hz, here 1-9 Hz; period is 20 ms, here 10 ms"):
        check_fits(contract, FISH.name, digest(FISH), (1.0, 9.0), 0.01)


def test_a_fish_is_known_by_its_physics(written):
    heavier = FISH.model_copy(update={"band": (1.0, 3.0)})
    assert digest(heavier) != digest(FISH)
    assert digest(FISH.model_copy(update={"summary": "words"})) == digest(FISH)


def test_differences_name_every_leaf(written):
    one = written[2].contract
    other = replace(one, period=0.01, actions=Direct(LOW, HIGH))
    named = {row.field for row in differences(one, other)}
    assert {"period", "actions.kind", "actions.tau"} <= named
    assert differences(one, one) == []


def test_inference_needs_neither_torch_nor_the_engine(written):
    code = (
        "import sys, numpy as np; from pathlib import Path\n"
        "from tailbeat.control.policy import decide, load_policy\n"
        "found = decide(load_policy(Path(sys.argv[1])), np.zeros((1, 24), np.float32))\n"
        "assert found.shape == (1, 6)\n"
        "assert not {'torch', 'mujoco', 'scipy', 'gymnasium'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code, str(written[0])], check=True)


# ---- the verbs ----------------------------------------------------------------------------------


def test_show_diff_and_try_from_the_command_line(written, tmp_path):
    shown = tailbeat_process("policy", "show", written[0], "--json", tmp_path / "show.json")
    assert shown.returncode == 0 and "16 golden pairs agree" in shown.stdout
    assert json.loads((tmp_path / "show.json").read_text())["fish"] == FISH.name
    same = tailbeat("policy", "diff", written[0], written[0])
    assert same.returncode == 0 and "equal" in same.stdout
    space = Direct(LOW, HIGH)
    export(untrained(space), FISH, space, sights(64), {"stage": "x"}, tmp_path / "direct.onnx")
    other = tailbeat("policy", "diff", written[0], tmp_path / "direct.onnx")
    assert other.returncode == 1 and "actions.kind" in other.stdout
    args = ("--targets", 8, "--exact", "--json", tmp_path / "try.json")
    tried = tailbeat("policy", "try", written[0], "--fish", FISH.name, *args)
    assert tried.returncode == 0, tried.stderr
    found = json.loads((tmp_path / "try.json").read_text())
    assert found["targets"] == 8 and 0 <= found["reached"] <= 1


def test_bad_input_is_one_sentence_and_exit_code_2(written, tmp_path):
    for words, refusal in (
        (("policy", "show", tmp_path / "none.onnx"), "no such file"),
        (("policy", "try", written[0], "--fish", "crank-fish"), "here crank-fish"),
        (("policy", "try", written[0], "--fish", FISH.name, "--arc", 999), "--arc 999"),
        (("train", "--fish", FISH.name, "--out", tmp_path, "--recipe", "soup"), "--recipe soup"),
        (("train", "--fish", FISH.name, "--out", tmp_path, "--actions", "fins"), "--actions fins"),
        (("train", "--fish", FISH.name, "--out", tmp_path / "a", "--resume"), "no run to resume"),
    ):
        assert refusal in complaint(*words)
    assert not (tmp_path / "a").exists()
