"""Policies made to harm: each is refused with one sentence, before or within seconds."""

import json
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("onnx", reason="the train extra is not installed")

import onnx

from tailbeat.control import policy_checks
from tailbeat.control.network_file import LARGEST, _fields, check_network
from tailbeat.control.policy import KEY, _digests, as_text, load_policy, shipped
from tailbeat.files import BadInput
from tailbeat.robot.fits import carried

PATH = shipped()["pulley-fish-pool-generator"]
CONTRACT = load_policy(PATH).contract
ENDLESS = """
  <ir_version: 8, opset_import: ["" : 17]> attack (float[n,24] observation) => (float[n,6] action)
  { limit = Constant <value: tensor = int64 {9223372036854775807}> ()
    go = Constant <value: tensor = bool {1}> ()
    action = Loop (limit, go, observation) <body = inside (int64 i, bool c, float[n,24] x)
      => (bool d, float[n,24] y) { d = Identity(c) y = Identity(x) }> }
"""
HUGE = """
  <ir_version: 8, opset_import: ["" : 17]> attack (float[n,24] observation) => (float[n] action)
  { shape = Constant <value: tensor = int64[1] {1600000000}> ()
    action = ConstantOfShape (shape) }
"""
FUNCTION = """
  <ir_version: 8, opset_import: ["" : 17, "own" : 1]>
  attack (float[n,24] observation) => (float[n,24] action) { action = own.twice(observation) }
  <domain: "own", opset_import: ["" : 17]> twice (x) => (y) { y = Add(x, x) }
"""


def saved(tmp_path: Path, model: onnx.ModelProto) -> Path:
    entry = model.metadata_props.add()
    entry.key, entry.value = KEY, as_text(CONTRACT)
    onnx.save(model, str(tmp_path / "attack.onnx"))
    return tmp_path / "attack.onnx"


def altered(tmp_path: Path, **fields: object) -> Path:
    """The shipped policy with other fields in its contract, signed anew."""
    model = onnx.load(str(PATH))
    content = {**json.loads(as_text(CONTRACT))["contract"], **fields}
    text = json.dumps({"contract": content, "digests": _digests(content)})
    model.metadata_props[0].value = text
    onnx.save(model, str(tmp_path / "altered.onnx"))
    return tmp_path / "altered.onnx"


@pytest.mark.parametrize(
    ("text", "named"),
    [(ENDLESS, "Constant, Loop"), (HUGE, "Constant, ConstantOfShape"), (FUNCTION, "a function")],
    ids=["endless", "huge", "function"],
)
def test_operators_that_no_policy_needs_are_refused_unrun(tmp_path, text, named):
    path = saved(tmp_path, onnx.parser.parse_model(text))
    began = time.monotonic()
    with pytest.raises(BadInput, match=f"the network has {named}.*, which no policy"):
        load_policy(path)
    assert time.monotonic() - began < 5


def test_every_kind_of_part_of_a_file_is_passed_over():
    """A number, eight bytes, four bytes; then text in field 2. Kind 3 is of no file of today."""
    parts = bytes([8, 0x96, 1, 9, *range(8), 13, *range(4), 18, 2, *b"ab"])
    assert list(_fields(parts)) == [(2, b"ab")]
    for wrong in (bytes([11]), parts[:-1]):
        with pytest.raises(ValueError, match=r"unknown kind 3|longer than the file"):
            list(_fields(wrong))


def test_the_shipped_policies_pass_and_a_file_of_megabytes_does_not(tmp_path):
    check_network(PATH)
    (tmp_path / "large.onnx").write_bytes(bytes(LARGEST + 1))
    with pytest.raises(BadInput, match="34 MB; a policy has less than 34"):
        load_policy(tmp_path / "large.onnx")


@pytest.mark.parametrize("seed", range(40))
def test_damaged_bytes_are_one_sentence(tmp_path, seed):
    rng, data = np.random.default_rng(seed), bytearray(PATH.read_bytes())
    for _ in range(20):
        data[rng.integers(len(data))] ^= 1 << rng.integers(8)
    (tmp_path / "bad.onnx").write_bytes(data[: rng.integers(1, len(data))])
    with pytest.raises(BadInput):
        load_policy(tmp_path / "bad.onnx")


def test_a_network_of_double_precision_is_refused(tmp_path):
    model = onnx.parser.parse_model(
        '<ir_version: 8, opset_import: ["" : 17]> d (double[n,24] observation)'
        " => (double[n,24] action) { action = Tanh(observation) }"
    )
    with pytest.raises(BadInput, match="does not run on observations of single precision"):
        load_policy(saved(tmp_path, model))


def test_a_network_that_takes_too_long_is_given_up(tmp_path, monkeypatch):
    wide = np.full((24, 100_000), 1e-6, np.float32)
    model = onnx.parser.parse_model(
        '<ir_version: 8, opset_import: ["" : 17]> slow (float[n,24] observation)'
        " => (float[n,24] action) { a = MatMul(observation, w) action = MatMul(a, v) }"
    )
    for name, weights in (("w", wide), ("v", wide.T.copy())):
        model.graph.initializer.append(onnx.numpy_helper.from_array(weights, name))
    monkeypatch.setattr(policy_checks, "PATIENCE", 0.0)
    with pytest.raises(BadInput, match="does not run"):
        load_policy(saved(tmp_path, model))


@pytest.mark.parametrize(
    ("fields", "refusal"),
    [
        ({"period": 0.5}, "its period is 0.5 s; this tailbeat decides every 0.02 s"),
        ({"band": [float("nan"), 4.0]}, "band is nan to 4 Hz"),
        ({"band": [4.0, 1.0]}, "band is 4 to 1 Hz"),
        ({"band": [1.0, float("inf")]}, "band is 1 to inf Hz"),
        ({"band": "wide"}, "a field of its contract is not what it should be"),
        ({"actions": {"kind": "magic"}}, "a field of its contract is not what it should be"),
        ({"actions": ["generator"]}, "a field of its contract is not what it should be"),
        ({"golden": [[], []]}, "its golden pairs are not 24 observations and 6 actions each"),
        ({"golden": [[[0.0] * 24] * 2, [[0.0] * 6]]}, "its golden pairs are not"),
        ({"golden": [[[0.0] * 23], [[0.0] * 6]]}, "its golden pairs are not"),
    ],
)
def test_contracts_that_were_signed_anew_are_refused(tmp_path, fields, refusal):
    with pytest.raises(BadInput, match=refusal):
        load_policy(altered(tmp_path, **fields))


@pytest.mark.parametrize("constant", [0.0, -0.1, 1000.0, float("nan"), True, "a"])
def test_a_filter_of_impossible_constants_is_refused(tmp_path, constant):
    following = load_policy("pulley-fish-pool-follow").contract
    assert following.motion is not None
    held = {**vars(following.motion), "noise": constant}
    with pytest.raises(ValueError, match="in version 2"):
        policy_checks.filter_from(2, held)
    assert policy_checks.filter_from(2, {**held, "noise": 999.0}) is not None


def test_one_golden_pair_is_enough(tmp_path):
    seen, done = CONTRACT.golden
    assert load_policy(altered(tmp_path, golden=[seen[:1], done[:1]])).contract.golden[0] == (
        list(seen[0]),
    )


def test_digests_that_are_a_list_are_refused(tmp_path):
    model = onnx.load(str(PATH))
    content = json.loads(as_text(CONTRACT))["contract"]
    model.metadata_props[0].value = json.dumps({"contract": content, "digests": [1]})
    onnx.save(model, str(tmp_path / "p.onnx"))
    with pytest.raises(BadInput, match="cannot be read"):
        load_policy(tmp_path / "p.onnx")


def test_a_fish_inside_that_is_not_the_contract_s_is_refused(tmp_path):
    inside = carried(CONTRACT).model_copy(update={"added_inertia": 0.5}).model_dump(mode="json")
    other = load_policy(altered(tmp_path, description=inside)).contract
    with pytest.raises(BadInput, match="description has changed since the training"):
        carried(other)
