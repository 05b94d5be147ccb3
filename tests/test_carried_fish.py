"""A policy carries the fish that it was trained on: nobody has to keep that file at hand."""

import json
from contextlib import contextmanager
from dataclasses import replace
from operator import attrgetter
from pathlib import Path

import numpy as np
import onnx
import pytest
from mujoco.batch import MODEL_FIELDS

pytest.importorskip("stable_baselines3", reason="the train extra is not installed")

from policies import EARLIER, POLICIES, trained_in
from support import complaint, tailbeat
from tailbeat.control.actions import Generator
from tailbeat.control.policy import KEY, Policy, _digests, as_text, load_policy, shipped
from tailbeat.env.task import settings_for
from tailbeat.env.world import World
from tailbeat.evaluate import store
from tailbeat.evaluate.evaluation import EvaluationConfig, describe, pool_of
from tailbeat.evaluate.seeded_trial import TrialConfig, try_policy
from tailbeat.files import BadInput
from tailbeat.fish.store import (
    Entries,
    Entry,
    digest,
    load_fish,
    with_values,
    write_identified,
)
from tailbeat.fish.twin import compile_twin
from tailbeat.report.page import trained_on
from tailbeat.robot.doctor import check_policy
from tailbeat.robot.fits import carried, check_swims, twin_of
from tailbeat.train.config import RunConfig
from tailbeat.train.export import export
from test_policy import sights, untrained

POOL_FISH = load_fish("pulley-fish")
# A lab's own identification of the pulley fish: no file of this name exists anywhere.
OWN = with_values(load_fish("pulley-fish-pool"), {"zones.fin.kutta": 2.0}).model_copy(
    update={"name": "mine"}
)
LOW, HIGH = OWN.motor.range or (-1.0, 1.0)


@pytest.fixture(scope="module")
def own(tmp_path_factory) -> tuple[Path, Policy]:
    path, space = tmp_path_factory.mktemp("own") / "policy.onnx", Generator(LOW, HIGH)
    run = RunConfig(OWN, path.parent, actions=space)
    return path, export(untrained(space), run, sights(100), {"stage": "exact"}, path)


def rewritten(source: Path, target: Path, changes: dict[str, object], sign: bool = True) -> Path:
    """A policy file whose contract has other values, signed anew or not."""
    model = onnx.load(str(source))
    held = json.loads(model.metadata_props[0].value)
    held["contract"].update(changes)
    held["digests"] = _digests(held["contract"]) if sign else held["digests"]
    model.metadata_props[0].value = json.dumps(held)
    onnx.save(model, str(target))
    return target


def test_the_fish_inside_is_the_one_it_was_trained_on(own):
    _, policy = own
    assert carried(policy.contract) == OWN == twin_of(policy, None)
    assert check_swims(policy, None, POOL_FISH) == OWN


def test_the_contract_has_the_digest_of_the_file_that_the_environment_swims(own, tmp_path):
    """And the fish inside compiles to the environment's model, number by number."""
    entry: Entry = {"value": 2.0, "unit": "1", "source": "a lab"}
    values: Entries = {"name": "mine", "zones.fin.kutta": entry}
    write_identified("pulley-fish-pool", tmp_path / "mine.toml", values, "")
    described, (_, policy) = load_fish(tmp_path / "mine.toml"), own
    swum = World(described, settings_for(policy.contract), [0]).simulator.physics.twin
    assert policy.contract.fish_digest == digest(described) == digest(swum.fish)
    inside = compile_twin(carried(policy.contract)).model
    for name in MODEL_FIELDS:
        a, b = (attrgetter(name)(model) for model in (inside, swum.model))
        assert np.array_equal(a, b), name


@pytest.mark.parametrize("name", POLICIES)
def test_every_policy_carries_its_fish_and_is_signed_as_it_was(name):
    text = onnx.load(str(POLICIES[name])).metadata_props[0].value
    policy = load_policy(POLICIES[name])
    inside, fish = carried(policy.contract), load_fish(trained_in(name))
    assert inside == fish.model_copy(update={"servo": inside.servo})
    assert json.loads(as_text(policy.contract)) == json.loads(text)


def test_an_older_policy_is_read_and_signed_as_it_was(tmp_path):
    model = onnx.load(str(shipped()["pulley-fish-pool-generator"]))
    held = json.loads(model.metadata_props[0].value)
    for later in ("description", "measure"):
        del held["contract"][later], held["digests"][later]
    model.metadata_props[0].value = json.dumps(held)
    onnx.save(model, str(tmp_path / "older.onnx"))
    policy = load_policy(tmp_path / "older.onnx")
    assert policy.contract.description is None
    assert twin_of(policy, str(EARLIER)) == load_fish(str(EARLIER))
    with pytest.raises(BadInput, match="description has changed"):
        carried(policy.contract)  # the shipped fish was identified anew since
    assert json.loads(as_text(policy.contract)) == held


def test_an_older_policy_of_ones_own_fish_asks_for_its_file(own):
    _, policy = own
    older = replace(policy, contract=replace(policy.contract, description=None))
    with pytest.raises(BadInput, match=r"trained on mine, which is not shipped.*--twin"):
        twin_of(older, None)


def test_a_fish_that_was_changed_inside_is_refused(own, tmp_path):
    path, policy = own
    other = with_values(OWN, {"zones.fin.kutta": 2.5}).model_dump(mode="json")
    unsigned = rewritten(path, tmp_path / "a.onnx", {"description": other}, sign=False)
    with pytest.raises(BadInput, match="description changed after the policy was exported"):
        load_policy(unsigned)
    signed = load_policy(rewritten(path, tmp_path / "b.onnx", {"description": other}))
    with pytest.raises(BadInput, match="mine's description has changed since the training"):
        twin_of(signed, None)
    assert policy.contract.fish == "mine"


def test_evaluate_and_its_page_need_no_file_of_the_twin(own, tmp_path):
    _, policy = own
    config = EvaluationConfig("pulley-fish", None, "full", ("reach",), 2)
    pool = pool_of(policy, config)
    assert pool.twin == OWN and pool.draws is None
    store.begin(tmp_path / "trial", describe(policy, pool))
    store.keep_fish(tmp_path / "trial", pool.twin)  # as `evaluate` does
    assert trained_on(tmp_path / "trial", "pulley-fish", None) == OWN
    other = trained_on(tmp_path / "trial", "pulley-fish", "pulley-fish-pool")
    assert other.name == "pulley-fish-pool"


def test_doctor_accepts_the_policy_of_ones_own_fish(own, tmp_path):
    path, _ = own
    good = check_policy(str(path), "pulley-fish")
    assert [one.verdict for one in good] == ["ok", "ok"]
    wrong = check_policy(str(path), "crank-fish")[-1]
    assert wrong.verdict == "bad" and "the policy's fish is not the pool's" in wrong.found


def test_show_says_that_it_carries_its_fish(own):
    shown = tailbeat("policy", "show", own[0])
    assert "carries its fish: yes" in shown.stdout and "zones" not in shown.stdout


def test_a_drive_with_the_wrong_fish_never_starts(tmp_path):
    """An audit found that it armed and swam, with exit code 0."""
    said = complaint(
        "drive", "pulley-fish-pool-generator", "--emulated", "--fish", "crank-fish",
        "--log", tmp_path / "a.mcap",
    )  # fmt: skip
    assert "the policy's fish is not the pool's" in said
    assert not list(tmp_path.iterdir())


def test_golden_pairs_still_hold_for_a_policy_that_carries_its_fish(own):
    path, policy = own
    seen = np.array(policy.contract.golden[0], np.float32)
    assert np.isfinite(seen).all() and KEY in {p.key for p in onnx.load(str(path)).metadata_props}


@pytest.mark.thorough
def test_a_newer_identification_can_be_tried_and_another_body_cannot(own):
    """The same policy in the fish as it was identified later, and in one of another mass."""
    path, _ = own
    later = with_values(OWN, {"zones.fin.kutta": 2.4})
    config = TrialConfig(targets=4, exact=True)
    with patched_fish(later), pytest.raises(BadInput, match="description has changed since"):
        try_policy(str(path), "later.toml", config)
    with patched_fish(later):
        assert try_policy(str(path), "later.toml", replace(config, newer=True)).targets == 4
    heavier = with_values(later, {"motor.mass": 0.3})
    with patched_fish(heavier), pytest.raises(BadInput, match=r"motor\.mass is"):
        try_policy(str(path), "later.toml", replace(config, newer=True))
    with pytest.raises(BadInput, match="omit --pools"):
        try_policy(str(path), "later.toml", replace(config, newer=True, pools=2))


@contextmanager
def patched_fish(fish):
    """Read this fish instead of a file."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tailbeat.evaluate.seeded_trial.load_fish", lambda name: fish)
        yield
