"""What an ONNX file may hold: shapes followed, numbers counted, odd parts seen. Nothing is run."""

import numpy as np
import pytest

pytest.importorskip("onnx", reason="the train extra is not installed")

import onnx

from tailbeat.control.network_file import Node, check_network, made_by, read_network
from tailbeat.control.policy import load_policy, shipped
from tailbeat.files import BadInput
from test_policy_attacks import saved

PATH = shipped()["pulley-fish-pool-generator"]
GROWING = {
    "a product": "x = MatMul(c, r) action = Mul(x, c)",
    "a turned product": "x = Gemm <transA = 1> (r, r) action = MatMul(observation, x)",
    "doubling": "d0 = Concat <axis = 0> (observation, observation)"
    + "".join(f" d{k + 1} = Concat <axis = -2> (d{k}, d{k})" for k in range(20))
    + " action = Tanh(d20)",
    "flattened": "f = Flatten <axis = 2> (c) action = Mul(f, r)",
}


@pytest.mark.parametrize("layers", GROWING.values(), ids=GROWING)
def test_a_small_file_that_makes_many_numbers_is_refused_before_it_runs(tmp_path, layers):
    model = onnx.parser.parse_model(
        '<ir_version: 8, opset_import: ["" : 17]> big (float[n,24] observation)'
        f" => (float[n,6] action) {{ {layers} }}"
    )
    for name, shape in (("c", (6000, 1)), ("r", (1, 6000))):
        weights = onnx.numpy_helper.from_array(np.ones(shape, np.float32), name)
        model.graph.initializer.append(weights)
    with pytest.raises(BadInput, match=r"million numbers of 100 observations; at most 8.39"):
        check_network(saved(tmp_path, model))


def test_shapes_are_those_that_the_engine_infers():
    model = onnx.load(str(PATH))
    known = onnx.shape_inference.infer_shapes(model).graph.value_info
    network = read_network(PATH.read_bytes())
    shapes = {**network.inputs, **network.weights}
    for node in network.nodes:
        shapes[node.makes[0]] = made_by(node, [shapes[name] for name in node.takes])
    for one in known:
        dims = tuple(dim.dim_value for dim in one.type.tensor_type.shape.dim)
        assert shapes[one.name] == dims
    assert shapes["action"] == (0, 6) and len(known) > 10


@pytest.mark.parametrize(
    ("name", "taken", "numbers", "made"),
    [
        ("MatMul", [(5,), (5, 3)], {}, (3,)),
        ("MatMul", [(2, 5), (5,)], {}, (2,)),
        ("MatMul", [(7, 1, 2, 5), (4, 5, 3)], {}, (7, 4, 2, 3)),
        ("Gemm", [(2, 5), (3, 5), (3,)], {"transB": 1}, (2, 3)),
        ("Concat", [(2, 5), (2, 3)], {"axis": 1}, (2, 8)),
        ("Flatten", [(2, 3, 4)], {"axis": 2}, (6, 4)),
        ("Sub", [(4, 1), (3,)], {}, (4, 3)),
        ("Relu", [(4, 1)], {}, (4, 1)),
    ],
)
def test_the_shape_that_a_layer_makes(name, taken, numbers, made):
    assert made_by(Node(name, (), (), numbers), taken) == made


def test_weights_in_another_file_are_refused(tmp_path):
    model = onnx.load(str(PATH))
    (tmp_path / "secret.bin").write_bytes(bytes(4 << 20))
    onnx.external_data_helper.convert_model_to_external_data(model, True, "weights.bin", 0)
    onnx.save(model, str(tmp_path / "p.onnx"))
    with pytest.raises(BadInput, match="weights in another file"):
        load_policy(tmp_path / "p.onnx")


def message(field: int, *parts: bytes) -> bytes:
    """A part of a protocol buffer: its field, its length, what it holds."""
    held = b"".join(parts)
    return bytes([field << 3 | 2, len(held)]) + held


LOOP = message(4, b"Relu") + message(4, b"Loop")  # two operators in a node: the last one counts


@pytest.mark.parametrize(
    ("part", "named"),
    [
        (message(7, message(1, LOOP)), "Loop"),
        (message(7, message(1, message(4, b"Relu"), message(7, b"own"))), "own.Relu"),
        (message(7, message(1, message(4, b"Relu"), message(5, message(1, b"a"), message(5)))),
         "a tensor or graph inside Relu"),
        (b"\xa2\x01\x00", "a training"),
        (message(7, *[message(1, message(4, b"Relu"))] * 10) * 101, "1022 layers"),
    ],
)  # fmt: skip
def test_parts_that_are_added_to_a_file_are_seen(part, named):
    """The format joins a message that comes twice."""
    assert read_network(PATH.read_bytes() + part).strange == {named}


@pytest.mark.parametrize(
    "part",
    [
        b"\xba\x80\x80\x80\x10\x00",  # the graph's field, and bits that other readers drop
        message(7, message(5, message(8, b"w"), b"\x08\x01" * 20)),  # twenty dimensions
        message(7, message(5, message(8, b"w"), b"\x10\x01" * 40)) + b"\x08\x01" * 11_000,
        message(7, message(5, b"\x08" + b"\xff" * 9 + b"\x7f")),
    ],
)
def test_bytes_that_readers_take_differently_are_refused(part):
    with pytest.raises((IndexError, ValueError)):
        read_network(PATH.read_bytes() + part)
