"""A policy trained again for one robot: it begins with its parent's networks in a newer twin, keeps
its corrections, and says whether it got better; what does not fit is refused."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from support import complaint

pytest.importorskip("gymnasium", reason="the train extra is not installed")
pytest.importorskip("torch", reason="the train extra is not installed")

from tailbeat.control.corrections import Corrections
from tailbeat.control.policy import decide, load_policy
from tailbeat.files import BadInput
from tailbeat.fish.store import load_fish, with_values
from tailbeat.pool import mess
from tailbeat.train import checkpoint
from tailbeat.train.again import run_again, surely_less, train_again
from tailbeat.train.config import RunConfig
from tailbeat.train.recipes import paper, recipe_of, smoke
from tailbeat.train.train import train

FISH = load_fish("pulley-fish-pool")
WEAK = with_values(FISH, {f"servos.{FISH.servo}.force_limit": 1.5})
TINY = replace(
    smoke(), fish=4, updates=1, batch=16, starts=40, buffer=40_000, window=4, polish=6, width=32
)  # fmt: skip


@pytest.fixture(scope="module")
def parent(tmp_path_factory):
    """A training that stopped after a second, with a checkpoint."""
    out = tmp_path_factory.mktemp("parent") / "run"
    train(RunConfig(FISH, out, TINY, hours=1 / 3600))
    return out


def test_a_run_begins_with_the_networks_of_another_in_the_last_stage(parent, tmp_path):
    run = RunConfig(WEAK, tmp_path / "run", TINY, start=parent)
    done = train(run)
    assert done.finished and done.stage == len(TINY.stages) - 1 == done.passed() - 1
    kept = load_policy(next(run.out.glob("stage-*.onnx")))  # the networks before the polish
    before = load_policy(parent / "policy.onnx")
    seen = np.array(before.contract.golden[0], np.float32)
    np.testing.assert_array_equal(decide(kept, seen), decide(before, seen))
    assert kept.contract.fish_digest != before.contract.fish_digest
    assert kept.contract.measure == before.contract.measure  # by which its networks see
    assert json.loads((run.out / "run.json").read_text())["start"] == str(parent)
    place = checkpoint.find(run.out)
    assert place is not None and checkpoint.read_state(place).updates >= TINY.polish


@pytest.mark.thorough
def test_the_new_policy_keeps_its_parents_corrections(parent, tmp_path):
    own = load_policy(parent / "policy.onnx")
    known = Corrections(askew=0.1, shaft=-0.2, parent="abc")
    own = replace(own, contract=replace(own.contract, corrections=known))
    run = RunConfig(WEAK, tmp_path / "train", TINY, start=parent)
    done = train_again(own, run)
    new = load_policy(tmp_path / "retrained.onnx")
    assert new.contract.corrections == known
    assert new.contract.description == WEAK.model_dump(mode="json")
    assert done.before.targets == done.after.targets == 250


def test_noise_is_called_better_as_rarely_as_it_says():
    """Two policies that are equally late, 1,000 times: 5 % of the time the first is called sooner.
    A policy that is two seconds sooner is always found with 250 targets."""
    rng = np.random.default_rng(3)
    pairs = rng.normal(10.0, 5.0, (1000, 2, 250))
    assert 25 <= sum(surely_less(*pair) for pair in pairs) <= 75
    assert all(surely_less(a - 2.0, b) for a, b in pairs[:100])


def test_a_training_is_read_from_its_contract(tmp_path):
    contract = load_policy("pulley-fish-pool-reach").contract
    run = run_again(contract, WEAK, tmp_path / "run", None)
    wrong, build = mess.widths(mess.level("wrecked")), mess.build(mess.level("rough"))
    for name in vars(wrong):
        assert getattr(run.errors, name) == pytest.approx(getattr(wrong, name), rel=5e-3)
    for name in vars(build):
        assert getattr(run.build, name) == pytest.approx(getattr(build, name), rel=5e-3)
    assert run.averages and run.actions == contract.actions and run.recipe.name == "quick"
    plain = run_again(load_policy("pulley-fish-pool-generator").contract, WEAK, tmp_path, None)
    assert plain.errors is None and plain.build is None and not plain.averages
    assert run.measured and run.measure == contract.measure  # the same task for the same robot
    far = replace(contract, training={**contract.training, "horizon": 8.0})
    assert run_again(far, WEAK, tmp_path, None).recipe == recipe_of("quick", horizon=8.0)
    odd = replace(contract, training={**contract.training, "errors": "horn much"})
    with pytest.raises(BadInput, match="which this tailbeat cannot read"):
        run_again(odd, WEAK, tmp_path, None)
    drawn = replace(contract, training={**contract.training, "physics": "posterior abc"})
    with pytest.raises(BadInput, match="only a policy trained with ranges"):
        run_again(drawn, WEAK, tmp_path, None)


def test_what_cannot_be_started_from_is_refused(parent, tmp_path):
    run = RunConfig(WEAK, tmp_path / "run", TINY, start=tmp_path / "nothing")
    with pytest.raises(BadInput, match=r"run\.json: missing or unreadable; give the folder"):
        train(run)
    (tmp_path / "bare").mkdir()
    (tmp_path / "bare" / "run.json").write_text("{}")
    with pytest.raises(BadInput, match="no checkpoint to start from"):
        train(replace(run, start=tmp_path / "bare"))
    with pytest.raises(BadInput, match="do not fit this run"):
        train(replace(run, start=parent, averages=True))
    broken = tmp_path / "broken"
    shutil.copytree(parent, broken)
    (broken / "checkpoint" / "networks.pt").write_bytes(b"no archive")
    with pytest.raises(BadInput, match="or are damaged"):
        train(replace(run, start=broken))
    slow = replace(paper(), fish=4, buffer=40_000)
    with pytest.raises(BadInput, match="recipe paper has no warm start"):
        train(replace(run, start=parent, recipe=slow))
    assert not (tmp_path / "run").exists()


def test_options_that_go_together_are_asked_for(tmp_path):
    words = ("refine", "pulley-fish-pool-reach", "--log", tmp_path / "no.mcap", "--out", tmp_path)
    assert "--retrain and --fish go together" in complaint(*words, "--retrain")
    assert "--retrain and --fish go together" in complaint(*words, "--fish", FISH.name)
    assert "--start and --hours only with them" in complaint(*words, "--start", tmp_path)
