"""A policy refined from its robot's logs: corrections undo what is wrong, robot and environment
apply them alike, and labs that nobody tuned for are swum better after it."""

import hashlib
import json
import re
from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest

from support import complaint, tailbeat
from written_logs import write_logs

pytest.importorskip("gymnasium", reason="the train extra is not installed")
pytest.importorskip("onnx", reason="the train extra is not installed")

from tailbeat.control.corrections import Corrections, corrected_frames
from tailbeat.control.policy import as_text, contract_digest, decide, load_policy, shipped
from tailbeat.control.runner import Readings, begin, steer
from tailbeat.env.errors import NONE, Errors
from tailbeat.env.task import Task, settings_for
from tailbeat.env.world import World
from tailbeat.evaluate.logged_swims import LogConfig, swims
from tailbeat.evaluate.refinement import RefinementConfig, over_labs, refinement
from tailbeat.files import BadInput
from tailbeat.fish.store import load_fish
from tailbeat.identify.offsets import offsets
from tailbeat.pool import mess
from tailbeat.pool.plant import Surroundings
from tailbeat.pool.simulator import PoolSimulator
from tailbeat.pool.water import ensemble
from tailbeat.train.refine import corrected, write

NAME = "pulley-fish-pool-generator"
FISH, POLICY = load_fish("pulley-fish"), load_policy(NAME)
WRONG = Errors(horn=0.2, encoder=-0.1, left=0.03, askew=-0.3, yaw_rate_bias=0.4)
KNOWN = Corrections(askew=-0.3, left=0.03, shaft=-0.3, setpoint=-0.2, yaw_rate=0.4)


def world(corrections, wrong, seeds=(5,)):
    pool = PoolSimulator(FISH, ensemble(len(seeds), 0), [Surroundings()] * len(seeds))
    settings = replace(settings_for(POLICY.contract), task=Task(seconds=9), corrections=corrections)
    return World(FISH, settings, list(seeds), simulator=pool, wrong=[wrong] * len(seeds))


def swum(own):
    """Poses (k, n, 3) and actions of a closed loop of four seconds."""
    seen, poses, actions = own.reset(), [], []
    for _ in range(200):
        actions.append(decide(POLICY, seen))
        seen = own.step(np.asarray(actions[-1], float)).observation
        poses.append(own.pose.copy())
    return np.array(poses), np.array(actions)


def test_a_robot_whose_errors_are_all_corrected_swims_as_one_without_errors():
    """In the unsteady water, with all noise. Uncorrected it ends somewhere else."""
    (right, _), (mended, _), (wrong, _) = map(
        swum, (world(None, NONE), world(KNOWN, WRONG), world(None, WRONG))
    )
    assert np.abs(mended - right).max() < 2e-3  # frames are kept in single precision
    assert np.abs(wrong - right).max() > 0.1


def test_mirrored_corrections_correct_a_mirrored_frame():
    """The tag's place is turned with the fish's heading, not with the tag's own."""
    frames = np.array([[[1.0, 2.0, 0.7, 0.0, 0.0, 0.04]]])
    mirror = np.array([1, -1, -1, 1, -1, 1.0])
    known = Corrections(askew=0.3, left=0.02)
    other = Corrections(askew=-0.3, left=-0.02)
    found = corrected_frames(known, frames)
    np.testing.assert_allclose(corrected_frames(other, frames * mirror), found * mirror)
    heading = 0.7 - 0.3
    left = 0.02 * np.array([-np.sin(heading), np.cos(heading)])
    np.testing.assert_allclose(found[0, 0, :3], [*(frames[0, 0, :2] - left), heading])
    assert frames[0, 0, 2] == 0.7  # what was read stays


def test_the_robot_corrects_as_the_environment_does_to_the_bit(monkeypatch):
    policy = replace(POLICY, contract=replace(POLICY.contract, corrections=KNOWN))
    own, sent = world(KNOWN, WRONG), []
    advance = own.simulator.advance

    def keep(wanted, pushes):
        sent.append(float(wanted[0]))
        return advance(wanted, pushes)

    monkeypatch.setattr(own.simulator, "advance", keep)
    seen, kept = own.reset(), [deepcopy(own.read)]
    for _ in range(150):
        seen = own.step(np.asarray(decide(policy, seen), float)).observation
        kept.append(deepcopy(own.read))
    course = begin(policy)
    for read, setpoint in zip(kept, sent, strict=False):
        own_readings = Readings(
            float(read.motor_angle[0]),
            float(read.motor_velocity[0]),
            float(read.yaw_rate[0]),
            read.frames[0],
        )
        course, decision = steer(policy, course, own_readings)
        assert decision.setpoint + WRONG.horn == setpoint
    assert np.ptp(sent) > 0.5


# ---- from logs ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def made():
    """A rough lab and two swims in it, in open water."""
    lab, water = mess.draw(mess.level("rough"), [2026, 4]), ensemble(16, 0)[3]
    return lab, swims(POLICY, FISH, [(lab, water)] * 2, LogConfig(40.0, 11)).logged


@pytest.fixture
def logs(made, tmp_path):
    sha = hashlib.sha256(shipped()[NAME].read_bytes()).hexdigest()
    digest = POLICY.contract.fish_digest
    return write_logs(made[1], tmp_path, policy_sha256=sha, fish_digest=digest)


@pytest.mark.thorough
def test_a_refined_file_has_the_same_network_and_signals_and_names_its_parent(logs, tmp_path):
    out = tmp_path / "refined"
    done = tailbeat("refine", NAME, "--log", *logs, "--out", out, "--json", tmp_path / "r.json")
    assert done.returncode == 0, done.stderr
    new = load_policy(out / "policy.onnx")
    assert new.contract.corrections is not None
    assert new.contract.corrections.parent == contract_digest(POLICY.contract)
    assert replace(new.contract, corrections=None) == POLICY.contract
    assert new.expected == POLICY.expected
    said = json.loads((out / "refined.json").read_text())
    assert said == json.loads((tmp_path / "r.json").read_text())
    assert [row["name"] for row in said["changes"]] == [
        "tag askew", "tag sideways", "shaft at straight", "command at straight", "gyro bias",
    ]  # fmt: skip
    assert "not told by swims alone: tag ahead" in done.stdout
    assert "exists" in complaint("refine", NAME, "--log", *logs, "--out", out)


@pytest.mark.thorough
def test_a_second_refining_goes_on_from_the_first(made):
    """A log has the readings as they came, whatever corrected them: what is told replaces an
    earlier correction. What is in doubt changes it little, and does not undo it."""
    found = offsets(made[1])
    first, before = corrected(POLICY.contract, found)
    held = replace(POLICY.contract, corrections=first)
    again, changes = corrected(held, found)
    for one, own in zip(changes, before, strict=True):
        assert own.after == pytest.approx(one.before, rel=1e-9) and own.found == one.found
        assert abs(one.after - one.found) <= abs(one.before - one.found)
    assert again.parent != first.parent
    _, kept = corrected(held, doubted(found))
    assert all(one.after == pytest.approx(one.before, rel=0.05, abs=0.05) for one in kept)
    assert max(abs(one.before) for one in kept) > 5


def doubted(found):
    """Offsets of which the swims tell nothing."""
    rows = tuple(replace(row, interval=(-900.0, 900.0)) for row in found.offsets)
    return replace(found, offsets=rows)


def test_a_lab_whose_fish_is_seen_too_little_keeps_its_corrections(monkeypatch):
    """One such lab ended the measure, after all its swims."""
    config = RefinementConfig(mess="wrecked", labs=3, targets=1, swims=1, seconds=31.0, seed=7)
    done = refinement(POLICY, config, lambda *_: None)
    unseen = [lab for lab in done.labs if not lab.estimates]
    assert 0 < len(unseen) < 3 and all(one.after == (one.before,) for one in unseen)


def test_a_value_in_doubt_is_believed_in_part(made):
    found = offsets(made[1])
    rows = {row.name: row for row in found.offsets}
    _, changes = corrected(POLICY.contract, found)
    for one in changes:
        assert abs(one.after) <= abs(rows[one.name].value)
        if not rows[one.name].told:
            assert "in doubt" in one.why
    _, changes = corrected(POLICY.contract, doubted(found))
    assert all(abs(one.after) < 0.05 * abs(one.found) + 1e-9 for one in changes)


def test_a_policy_without_a_gyro_keeps_its_rates(made):
    blind = replace(POLICY.contract, yaw_rate="camera")
    assert corrected(blind, offsets(made[1]))[0].yaw_rate == 0.0


@pytest.mark.slow
def test_refining_brings_back_the_targets_of_a_rough_lab():
    """The first of ten labs in which the policy reaches fewer than half of its targets, beside
    itself and the corrections that nobody can know. The lab after it needs none."""
    config = RefinementConfig(labs=2, targets=6, walled=False, seed=26, first=9)
    done = refinement(POLICY, config, lambda *_: None)
    bad, _ = done.labs
    assert bad.after[-1] >= bad.before + 2, done
    assert bad.after[-1] >= bad.true - 1, done
    assert done.gain[1] <= done.gain[0] <= done.gain[2] and done.gain[0] > 0
    held = [one.held for lab in done.labs for one in lab.estimates]
    assert sum(held) >= 4, done


def test_intervals_over_labs_hold_the_mean_of_labs_as_often_as_they_say():
    """Labs differ: 20 of them, each all reached or none, 400 times. Counting targets as if each
    were on its own would give intervals of half the width."""
    rng, held, naive = np.random.default_rng(5), 0, 0
    for _ in range(400):
        labs = rng.choice([0.0, 0.5, 1.0], size=20, p=[0.3, 0.1, 0.6])
        value, low, high = over_labs(labs)
        held += low <= 0.65 <= high
        half = 1.96 * np.sqrt(value * (1 - value) / 80)  # 4 targets each
        naive += abs(value - 0.65) <= half
    assert 0.90 <= held / 400 <= 0.985
    assert naive / 400 < 0.8


# ---- what is refused ----------------------------------------------------------------------------


def test_logs_of_another_policy_and_offsets_beyond_a_lab_are_refused(made, logs, tmp_path):
    out = tmp_path / "refined"
    other = write_logs(made[1][:1], tmp_path / "other", policy_sha256="beef", fish_digest="x")
    said = complaint("refine", NAME, "--log", *other, "--out", out)
    assert "its policy_sha256 is beef" in said and "give the policy that swam" in said
    found = offsets(made[1])
    far = tuple(replace(row, value=400.0, interval=(399.0, 401.0)) for row in found.offsets)
    with pytest.raises(BadInput, match="tag askew is 400 deg; allowed is -60 to 60"):
        corrected(POLICY.contract, replace(found, offsets=far))
    unsure = tuple(replace(row, interval=(-401.0, 401.0)) for row in far)
    _, changes = corrected(POLICY.contract, replace(found, offsets=unsure))
    assert all("the swims are in doubt" in one.why for one in changes)
    assert not out.exists()


@pytest.mark.thorough
def test_logs_that_are_none_or_damaged_are_told(logs, tmp_path):
    """A file that is no log was called one of another policy; a damaged one passed in silence."""
    words = ("refine", NAME, "--out", tmp_path / "no", "--log")
    assert "no such file; give a log" in complaint(*words, tmp_path / "none.mcap")
    noise = tmp_path / "noise.mcap"
    noise.write_bytes(bytes(range(256)) * 40)
    assert "no row of a swim in this file" in complaint(*words, noise)
    copy = tmp_path / "copy.mcap"
    copy.write_bytes(logs[0].read_bytes())
    assert f"the same log as {logs[0]}" in complaint(*words, logs[0], copy)
    assert not (tmp_path / "no").exists()
    whole = bytearray(copy.read_bytes())
    copy.write_bytes(whole[: len(whole) * 9 // 10])
    done = tailbeat("refine", NAME, "--log", copy, logs[1], "--out", tmp_path / "cut")
    assert done.returncode == 0, done.stderr
    assert f"warning: {copy}: the log has no end" in done.stdout
    assert len(json.loads((tmp_path / "cut/refined.json").read_text())["damage"]) == 1


@pytest.mark.parametrize(
    ("changed", "said"),
    [({"askew": 3.0}, "correction askew = 3.0"), ({"left": "x"}, "correction left = 'x'"),
     ({"yaw_rate": True}, "correction yaw_rate = True"), ({"parent": 3}, "corrections {")],
)  # fmt: skip
def test_corrections_that_no_lab_has_are_refused_on_loading(changed, said, tmp_path):
    odd = replace(POLICY.contract, corrections=replace(KNOWN, **changed))
    with pytest.raises(BadInput, match=re.escape(said)):
        write(shipped()[NAME], odd, tmp_path / "odd.onnx")
    assert not list(tmp_path.iterdir())


def test_a_contract_without_corrections_is_written_as_before():
    assert "corrections" not in as_text(POLICY.contract)
    assert contract_digest(POLICY.contract) != contract_digest(
        replace(POLICY.contract, corrections=Corrections())
    )
