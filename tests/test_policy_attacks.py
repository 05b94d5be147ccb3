"""Policies made to harm: each is refused with one sentence, before or within seconds."""

import json
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("onnx", reason="the train extra is not installed")

import onnx
import onnxruntime

from policies import POLICIES
from tailbeat.control import policy_checks
from tailbeat.control.motion import MotionFilter
from tailbeat.control.network_file import LARGEST, _fields, check_network
from tailbeat.control.policy import KEY, _digests, as_text, decide, load_policy, shipped
from tailbeat.files import BadInput
from tailbeat.fish.store import digest, load_fish
from tailbeat.link import datagrams as link
from tailbeat.robot import timing
from tailbeat.robot.fits import carried, check_named
from tailbeat.robot.ports import Ports
from tailbeat.robot.session import DriveConfig, drive

PATH = shipped()["pulley-fish-pool-generator"]
CONTRACT = load_policy(PATH).contract
ACTIONS = json.loads(as_text(CONTRACT))["contract"]["actions"]
BIG = 10**400  # an integer that no float holds
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
    return carrying(tmp_path, {**json.loads(as_text(CONTRACT))["contract"], **fields})


def carrying(tmp_path: Path, content: dict[str, object]) -> Path:
    """The shipped policy with this contract, signed anew."""
    model = onnx.load(str(PATH))
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
    assert list(_fields(parts)) == [(1, 150), (2, b"ab")]
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


def outer(size: int, steps: int = 0) -> onnx.ModelProto:
    """A file of 200 kB whose layers make square matrices of this size, and multiply them."""
    layers = ["m0 = Mul(a, b)", *(f"m{k + 1} = MatMul(m{k}, m{k})" for k in range(steps))]
    model = onnx.parser.parse_model(
        '<ir_version: 8, opset_import: ["" : 17]> outer (float[n,24] observation)'
        f" => (float[n,6] action) {{ {' '.join(layers)} x = MatMul(observation, l)"
        f" y = MatMul(x, m{steps}) action = MatMul(y, r) }}"
    )
    shapes = {"a": (size, 1), "b": (1, size), "l": (24, size), "r": (size, 6)}
    for name, shape in shapes.items():
        weights = np.full(shape, 1.0 if name == "a" else 1.0 / size, np.float32)
        model.graph.initializer.append(onnx.numpy_helper.from_array(weights, name))
    return model


def test_a_network_that_takes_too_long_is_given_up(tmp_path, monkeypatch):
    """Between two layers, and not after the last."""
    path = saved(tmp_path, outer(600, steps=21))

    def worked(refusal: str) -> float:
        began = time.thread_time()
        with pytest.raises(BadInput, match=refusal):
            load_policy(path)
        return time.thread_time() - began

    whole = worked("golden actions are off")
    monkeypatch.setattr(policy_checks, "PATIENCE", 0.002)
    assert worked("no answer within 0.002 s; give a smaller one") < whole / 2


def test_constant_layers_do_not_run_while_a_network_is_loaded(monkeypatch):
    """Folded, they would run where nothing gives them up."""
    options = onnxruntime.SessionOptions()
    monkeypatch.setattr(onnxruntime, "SessionOptions", lambda: options)
    load_policy(PATH)
    off = onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL
    assert options.graph_optimization_level == off


@pytest.mark.parametrize("name", POLICIES)
def test_decisions_are_those_of_an_optimised_network_to_the_last_bit(name):
    policy = load_policy(POLICIES[name])
    usual = onnxruntime.InferenceSession(str(POLICIES[name]), providers=["CPUExecutionProvider"])
    wide = len(policy.contract.observation)
    seen = np.random.default_rng(0).normal(size=(64, wide)).astype(np.float32)
    for batch in (seen, seen[:1], np.array(policy.contract.golden[0], np.float32)):
        wanted = usual.run(None, {"observation": batch})[0]
        assert np.array_equal(decide(policy, batch), wanted)


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
        ({"golden": [[["a"] * 24], [["b"] * 6]]}, "its golden pairs are not"),
        ({"golden": [["a" * 24], ["b" * 6]]}, "its golden pairs are not"),
        ({"golden": [[[[1.0], [2.0, 3.0]] * 12], [[0.0] * 6]]}, "its golden pairs are not"),
        ({"golden": [[{str(k): 0 for k in range(24)}], [[0.0] * 6]]}, "its golden pairs are not"),
        ({"golden": [[[BIG] * 24], [[0.0] * 6]]}, "its golden pairs are not"),
        ({"golden": [[[0.0] * 24] * 200, [[0.0] * 6] * 200]}, "its golden pairs are not"),
        ({"band": [0, BIG]}, "a field of its contract is not what it should be"),
        ({"actions": {**ACTIONS, "floor": BIG}}, "floor = 1000.*; give at most 25 Hz"),
        ({"description": "x"}, "not what it should be .*description is a str"),
        ({"description": [1]}, "not what it should be .*description is a list"),
        ({"training": "long"}, "not what it should be .*training is a str"),
        ({"fish": 3}, "not what it should be .*fish is a int"),
    ],
)
def test_contracts_that_were_signed_anew_are_refused(tmp_path, fields, refusal):
    with pytest.raises(BadInput, match=refusal):
        load_policy(altered(tmp_path, **fields))


@pytest.mark.parametrize(
    ("fields", "refusal"),
    [
        ({"tau": 1e-9}, "tau = 1e-09 s; give 0.001 s or more"),
        ({"ceiling": 1e300}, r"ceiling = 1e\+300 Hz; give at most 25 Hz"),
        ({"high": float("inf")}, "high = inf; give at most 100"),
        ({"first": float("nan")}, "first = nan; give at most"),
        ({"offset": "wide"}, "a field of its contract is not what it should be"),
        ({"binds": "nothing"}, "binds = 'nothing'; give fundamental or signal"),
    ],
)
def test_actions_that_no_motor_can_follow_are_refused(tmp_path, fields, refusal):
    with pytest.raises(BadInput, match=refusal):
        load_policy(altered(tmp_path, actions={**ACTIONS, **fields}))


def test_actions_beyond_the_fish_s_motor_or_band_are_refused_and_all_are_named(tmp_path):
    wide = altered(tmp_path, actions={**ACTIONS, "low": -3.1, "high": 3.1, "ceiling": 9.0})
    with pytest.raises(BadInput, match=r"motor allows -1.39626 to .* reaches 9 Hz and .* 4 Hz"):
        check_named(str(wide), "pulley-fish")
    with pytest.raises(BadInput, match=r"is not the pool's: .* head, .*; band is 1-4 Hz, here .*;"):
        check_named(str(PATH), "crank-fish")
    narrow = altered(tmp_path, actions={**ACTIONS, "low": -0.5, "high": 0.5})
    check_named(str(narrow), "pulley-fish")


def test_an_old_file_signed_anew_for_another_fish_is_refused(tmp_path):
    """Without the fish inside, the shipped fish of the contract's name must match it."""
    held = json.loads(as_text(CONTRACT))["contract"]
    old = {k: one for k, one in held.items() if k not in ("description", "measure")}
    old["fish_digest"] = digest(load_fish("pulley-fish-pool"))
    contract = load_policy(carrying(tmp_path, old)).contract
    assert carried(contract).name == "pulley-fish-pool"
    other = {**old, "fish": "crank-fish", "fish_digest": "0", "band": [0.0, 99.0]}
    contract = load_policy(carrying(tmp_path, other)).contract
    with pytest.raises(BadInput, match=r"description has changed .*; band is 0-99 Hz, here"):
        carried(contract)


def test_a_drive_checks_a_policy_also_without_a_fish(tmp_path, monkeypatch):
    monkeypatch.setattr(timing, "claim", lambda: [])
    wide = altered(tmp_path, actions={**ACTIONS, "low": -3.1, "high": 3.1})
    link.make_key(tmp_path / "key")
    ends = ("127.0.0.1", 1), ("127.0.0.1", 2)
    ports = Ports(str(tmp_path / "no servo"), "none", *ends)
    config = DriveConfig(str(wide), ports, tmp_path / "key", tmp_path / "a.mcap", force_camera=True)
    with pytest.raises(BadInput, match=r"actions reach -3.1 to 3.1 rad"):
        drive(config, lambda text: None)


@pytest.mark.parametrize("text", ["[" * 200_000, '{"contract": {"training": ' + '{"a":' * 400])
def test_a_contract_that_is_nested_without_end_is_refused(tmp_path, text):
    closed = text + "1" + "}" * (text.count("{") - 1) + ', "digests": {}}'
    model = onnx.load(str(PATH))
    model.metadata_props[0].value = closed if text.startswith("{") else text
    onnx.save(model, str(tmp_path / "p.onnx"))
    with pytest.raises(BadInput, match="its contract cannot be read"):
        load_policy(tmp_path / "p.onnx")


@pytest.mark.parametrize("constant", [0.0, -0.1, 1000.0, float("nan"), True, "a"])
def test_a_filter_of_impossible_constants_is_refused(tmp_path, constant):
    following = load_policy("pulley-fish-pool-follow").contract
    assert following.motion is not None
    held = {**vars(following.motion), "noise": constant}
    with pytest.raises(ValueError, match="not as in its version"):
        policy_checks.constants_from(MotionFilter, held, True)
    good = {**held, "noise": 999.0}
    assert policy_checks.constants_from(MotionFilter, good, True) is not None


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
