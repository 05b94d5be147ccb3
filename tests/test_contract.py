"""A policy's contract: what does not hold is refused by name; and the runner that obeys it."""

import json
import math
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("onnx", reason="the train extra is not installed")

import onnx

from policies import EARLIER, POLICIES
from tailbeat.control import actions as act
from tailbeat.control.actions import PERIOD, Direct, Generator
from tailbeat.control.contract_diff import differences
from tailbeat.control.measure import PAPER
from tailbeat.control.observation import TABLE, Samples, observe, scales
from tailbeat.control.policy import (
    KEY,
    _digests,
    as_text,
    check_fits,
    decide,
    load_policy,
    measure_in,
    shipped,
)
from tailbeat.control.runner import Readings, begin, steer
from tailbeat.files import BadInput
from tailbeat.fish.store import digest, load_fish

FISH, NAME = load_fish("pulley-fish-pool"), "pulley-fish-pool-generator"
LOW, HIGH = FISH.motor.range or (-1.0, 1.0)
SCALES = scales(PAPER)
PATH, POLICY = shipped()[NAME], load_policy(NAME)
CONTRACT = POLICY.contract


def changed(path: Path, to: Path, **fields: object) -> Path:
    """A copy of a policy with other contract fields, digests left alone."""
    model = onnx.load(str(path))
    held = json.loads(model.metadata_props[0].value)
    held["contract"].update(fields)
    model.metadata_props[0].value = json.dumps(held)
    onnx.save(model, str(to))
    return to


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
def test_a_tampered_field_is_named(tmp_path, field, value):
    with pytest.raises(BadInput, match=f"{field} changed after"):
        load_policy(changed(PATH, tmp_path / "p.onnx", **{field: value}))


@pytest.mark.parametrize(
    ("row", "other"),
    [
        (9, replace(TABLE[9], scale=2.7 * TABLE[9].scale)),
        (14, replace(TABLE[14], unit="km")),
        (12, TABLE[13]),
    ],
)
def test_a_policy_of_other_scales_units_or_order_is_refused(tmp_path, row, other):
    """The paper's own accident: signed anew, so that the digests agree, and wrong all the same."""
    table = [*TABLE[:row], other, *TABLE[row + 1 :]]
    model = onnx.load(str(PATH))
    model.metadata_props[0].value = as_text(replace(CONTRACT, observation=tuple(table)))
    onnx.save(model, str(tmp_path / "p.onnx"))
    with pytest.raises(BadInput, match=f"observation {row} is"):
        load_policy(tmp_path / "p.onnx")


def test_unknown_versions_and_strangers_are_refused(tmp_path):
    with pytest.raises(BadInput, match="contract version 7"):
        load_policy(changed(PATH, tmp_path / "p.onnx", version=7))
    (tmp_path / "text.onnx").write_text("not a network")
    with pytest.raises(BadInput, match="not a readable ONNX"):
        load_policy(tmp_path / "text.onnx")
    bare = onnx.load(str(PATH))
    del bare.metadata_props[:]
    onnx.save(bare, str(tmp_path / "bare.onnx"))
    with pytest.raises(BadInput, match="without a contract"):
        load_policy(tmp_path / "bare.onnx")
    with pytest.raises(BadInput, match="no such file"):
        load_policy(tmp_path / "none.onnx")
    for name in ("pulley-fish-pool-signal", "pulley-fish-pool-course"):  # the second was a default
        with pytest.raises(BadInput, match=r"examples/policies\*/: give") as refused:
            load_policy(name)
        told = set(re.findall(r"\S+\.onnx", str(refused.value).split("examples/policies*/")[1]))
        assert told & {path.name for path in POLICIES.values()}


def test_only_a_name_is_told_where_policies_of_the_repository_lie(tmp_path):
    for path in ("none.onnx", tmp_path / "none", tmp_path / "none.onnx"):
        with pytest.raises(BadInput, match=rf"no such file; .* one of .*{[*shipped()][-1]}\.$"):
            load_policy(path)


def signed(to: Path, content: object, of: Path = PATH) -> Path:
    """A copy of a policy with this contract, its digests made anew where there is one."""
    model = onnx.load(str(of))
    if isinstance(content, dict):
        content = json.dumps({"contract": content, "digests": _digests(content)})
    model.metadata_props[0].value = content
    onnx.save(model, str(to))
    return to


def test_without_a_policy_the_measure_is_the_paper_s_fish_s():
    assert measure_in(None) == PAPER == measure_in(NAME)


def test_a_contract_that_cannot_be_read_or_lacks_a_field_is_refused(tmp_path):
    held = json.loads(as_text(CONTRACT))["contract"]
    for text in ("words", "[1]", '{"contract": {}, "digests": {}}'):
        with pytest.raises(BadInput, match="its contract cannot be read"):
            load_policy(signed(tmp_path / "p.onnx", text))
    less = {name: value for name, value in held.items() if name != "period"}
    for odd, content in (("period", less), ("colour", {**held, "colour": "red"})):
        with pytest.raises(BadInput, match=f"missing or unknown fields .'{odd}'"):
            load_policy(signed(tmp_path / "p.onnx", content))


def test_a_contract_s_action_space_and_table_must_be_possible_ones(tmp_path):
    for other, refusal in (
        (replace(CONTRACT, actions=Direct(9.0, 1.0)), "a low below the high"),
        (replace(CONTRACT, observation=TABLE[:-1]), "23 observations; this tailbeat makes 24"),
    ):
        with pytest.raises(BadInput, match=refusal):
            load_policy(signed(tmp_path / "p.onnx", as_text(other)))


@pytest.mark.parametrize(
    ("name", "rows", "columns", "weight", "refusal"),
    [
        ("observation", 24, 6, 0.0, "golden actions are off by .*, allowed is 1e-05"),
        ("observation", 24, 6, np.nan, "golden actions are off by nan"),
        ("observation", 24, 5, 0.0, "gives 5 numbers; its action space takes 6"),
        ("observation", 23, 6, 0.0, "does not take 24 observations"),
        ("seen", 24, 6, 0.0, "does not take 24 observations"),
    ],
)
def test_a_network_that_is_not_the_contract_s_is_refused(
    tmp_path, name, rows, columns, weight, refusal
):
    """One layer of equal weights, under the shipped policy's contract."""
    model = onnx.parser.parse_model(
        f'<ir_version: 8, opset_import: ["" : 17], metadata_props: ["{KEY}": ""]> layer'
        f" (float[n,{rows}] {name}) => (float[n,{columns}] action)"
        f" {{ action = MatMul({name}, w) }}"
    )
    weights = np.full((rows, columns), weight, np.float32)
    model.graph.initializer.append(onnx.numpy_helper.from_array(weights, "w"))
    onnx.save(model, str(tmp_path / "layer.onnx"))
    with pytest.raises(BadInput, match=refusal):
        load_policy(signed(tmp_path / "p.onnx", as_text(CONTRACT), tmp_path / "layer.onnx"))


def test_four_policies_are_shipped_and_others_are_kept_as_evidence():
    names = ("follow-rule", "follow", "generator", "reach")
    assert list(shipped()) == [f"pulley-fish-pool-{one}" for one in names]
    assert len(POLICIES) == 36


def test_a_contract_from_before_the_floor_still_loads(tmp_path):
    model = onnx.load(str(PATH))
    held = json.loads(model.metadata_props[0].value)
    assert held["contract"]["actions"].pop("floor") == 0.0
    held["digests"] = _digests(held["contract"])
    model.metadata_props[0].value = json.dumps(held)
    onnx.save(model, str(tmp_path / "old.onnx"))
    old = load_policy(str(tmp_path / "old.onnx")).contract
    assert old == CONTRACT and differences(old, CONTRACT) == []


def test_other_weights_fail_the_golden_pairs(tmp_path):
    model = onnx.load(str(PATH))
    weights = onnx.numpy_helper.to_array(model.graph.initializer[0]).copy()
    weights[0, 0] += 0.5
    first = model.graph.initializer[0]
    first.CopyFrom(onnx.numpy_helper.from_array(weights, first.name))
    onnx.save(model, str(tmp_path / "p.onnx"))
    with pytest.raises(BadInput, match="golden actions are off"):
        load_policy(tmp_path / "p.onnx")


def test_a_policy_for_another_fish_band_or_period_is_refused():
    own = digest(load_fish(str(EARLIER)))
    check_fits(CONTRACT, FISH.name, own, FISH.band, PERIOD)
    with pytest.raises(BadInput, match="fish is pulley-fish-pool, here crank-fish"):
        check_fits(CONTRACT, "crank-fish", "", FISH.band, PERIOD)
    with pytest.raises(BadInput, match="description has changed"):
        check_fits(CONTRACT, FISH.name, digest(FISH), FISH.band, PERIOD)  # identified anew since
    with pytest.raises(BadInput, match=r"band is 1-4 Hz, here 1-9 Hz; period is 20 ms, here 10 ms"):
        check_fits(CONTRACT, FISH.name, own, (1.0, 9.0), 0.01)


def test_a_fish_is_known_by_its_physics():
    heavier = FISH.model_copy(update={"band": (1.0, 3.0)})
    assert digest(heavier) != digest(FISH)
    assert digest(FISH.model_copy(update={"summary": "words"})) == digest(FISH)


def test_differences_name_every_leaf():
    one = CONTRACT
    other = replace(one, period=0.01, actions=Direct(LOW, HIGH))
    named = {row.field for row in differences(one, other)}
    assert {"period", "actions.kind", "actions.tau"} <= named
    assert differences(one, one) == []


def test_inference_needs_neither_torch_nor_the_engine():
    code = (
        "import sys, numpy as np; from pathlib import Path\n"
        "from tailbeat.control.policy import decide, load_policy\n"
        "found = decide(load_policy(Path(sys.argv[1])), np.zeros((1, 24), np.float32))\n"
        "assert found.shape == (1, 6)\n"
        "assert not {'torch', 'mujoco', 'scipy', 'gymnasium'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code, str(PATH)], check=True)


# ---- the runner ----------------------------------------------------------------------------------


def test_a_reading_that_is_no_number_gives_no_number_and_no_further_state():
    course = begin(POLICY)
    bad = Readings(float("nan"), 0.0, 0.0, np.zeros((3, 6)))
    after, decision = steer(POLICY, course, bad)
    assert math.isnan(decision.setpoint) and after is course


def test_the_runner_s_network_sees_its_last_three_commands_newest_first():
    course, given = begin(POLICY), Readings(0.1, -2.0, 0.5, np.zeros((3, 6)))
    assert course.commands.tolist() == [[[0.0, 0.0]] * 3]  # a straight tail, still
    newest: list[np.ndarray] = []
    for _ in range(5):
        before = [*newest, *[np.zeros(2)] * 3][:3]
        course, decision = steer(POLICY, course, given)
        shown = decision.observation[6:12] * SCALES[6:12]
        assert shown == pytest.approx(np.concatenate(before), rel=1e-5)
        assert decision.setpoint == act.setpoint(CONTRACT.actions, course.state)[0]
        newest.insert(0, act.command(CONTRACT.actions, course.state)[0])
    assert np.array_equal(course.commands[0], newest[:3]) and np.ptp(newest, axis=0).min() > 0


def test_the_runner_s_decision_is_the_network_s_for_what_the_sensors_said():
    frames = np.random.default_rng(0).uniform(0, 1, (3, 6))
    course, decision = steer(POLICY, begin(POLICY), Readings(0.1, -2.0, 0.5, frames))
    angle, velocity, rate, phase = (np.array([x]) for x in (0.1, -2.0, 0.5, 0.0))
    raw = Samples(angle, velocity, rate, phase, np.zeros((1, 3, 2)), frames[None])
    assert np.array_equal(decision.observation, observe(raw)[0])
    assert np.array_equal(decision.action, decide(POLICY, observe(raw))[0])
    once = act.step(
        CONTRACT.actions, act.reset(CONTRACT.actions, 1), decision.action[None].astype(float), 0.02
    )
    assert np.array_equal(course.state.u, once.u) and course.state.phase == once.phase
