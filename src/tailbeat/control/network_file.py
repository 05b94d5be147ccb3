"""What an ONNX file may hold before anything runs it: its size, its operators, and how many numbers
its layers make.

A policy is a few layers. A loop that never ends, a constant of gigabytes or a network that is not
ours must not reach the robot, so the file's own list of operators is read first, and the shape of
everything that they make is followed. That needs only the wire format of protocol buffers (a key
and a length before each part), so the robot does not install the package `onnx`.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path

from tailbeat.files import BadInput

Shape = tuple[int, ...]
LARGEST = 32 << 20  # bytes; a policy has 0.7 MB
ROWS = 100  # observations at once; a policy has 16 golden pairs
NUMBERS = 1 << 23  # in all tensors together, for so many observations; a policy has 0.4 million
LAYERS, DESCRIBED = 1000, 1 << 20  # nodes; bytes of all of them, their names and attributes
PARTS, TENSOR_PARTS, RANK = 10_000, 100, 8  # of a message; of a weight; dimensions
# Layers and what may stand between them. None holds a graph of its own.
OPERATORS = frozenset({
    "Add", "Clip", "Concat", "Div", "Elu", "Flatten", "Gemm", "Identity", "LayerNormalization",
    "LeakyRelu", "MatMul", "Mul", "Relu", "Sigmoid", "Softplus", "Sqrt", "Sub", "Tanh",
})  # fmt: skip
# Fields of the messages of ONNX. A sparse tensor may be small here and huge there.
GRAPH, TRAINING, FUNCTIONS = 7, 20, 25  # of ModelProto
NODE, INITIALIZER, INPUT, SPARSE = 1, 5, 11, 15  # of GraphProto
FROM, TO, OPERATOR, ATTRIBUTE, DOMAIN = 1, 2, 4, 5, 7  # of NodeProto
ATTRIBUTE_NAME, INTEGER, HELD = 1, 3, {5, 6, 10, 11, 22, 23}  # of AttributeProto
DIMS, TENSOR_NAME, EXTERNAL, LOCATION = 1, 8, 13, 14  # of TensorProto
TYPE, TENSOR, SHAPE, DIM, SIZE = 2, 1, 2, 1, 1  # of ValueInfoProto and what it holds
VARINT, FIXED64, BYTES, FIXED32 = 0, 1, 2, 5  # kinds of a field


@dataclass(frozen=True)
class Node:
    """A layer: its operator, the tensors that it takes and makes, and its whole numbers."""

    operator: str
    takes: tuple[str, ...]
    makes: tuple[str, ...]
    numbers: dict[str, int]


@dataclass(frozen=True)
class Network:
    """The layers of a file in their order, the shapes of what it brings and of what it is given (an
    open dimension is 0), and what no policy needs."""

    nodes: tuple[Node, ...]
    weights: dict[str, Shape]
    inputs: dict[str, Shape]
    strange: frozenset[str]


def check_network(path: Path) -> bytes:
    """The file's bytes, to be run as they are. Raises BadInput for a file that is too large, has an
    operator that no policy needs, or makes too many numbers."""
    if path.stat().st_size > LARGEST:
        raise BadInput(
            f"{path}: {path.stat().st_size / 1e6:.0f} MB; a policy has less than"
            f" {LARGEST / 1e6:.0f}. Give a policy that tailbeat exported."
        )
    data = path.read_bytes()
    try:
        network = read_network(data)
        strange = network.strange
        numbers = 0 if strange else numbers_of(network, ROWS)
    except (IndexError, KeyError, TypeError, ValueError):
        raise BadInput(f"{path}: not a readable ONNX file; export the policy again.") from None
    if strange:
        raise BadInput(
            f"{path}: the network has {', '.join(sorted(strange)[:5])}, which no policy of tailbeat"
            f" needs; export it again, or put the operator among those allowed."
        )
    if numbers > NUMBERS:
        raise BadInput(
            f"{path}: the network makes {numbers / 1e6:.3g} million numbers of {ROWS} observations;"
            f" at most {NUMBERS / 1e6:.3g} are allowed. Give a policy that tailbeat exported."
        )
    return data


# ---- shapes -------------------------------------------------------------------------------------


def numbers_of(network: Network, rows: int) -> int:
    """How many numbers all tensors have together where an open dimension is `rows`; no fewer than
    there are. Counts no further than `NUMBERS`. Raises IndexError, KeyError, TypeError or
    ValueError for a network that does not fit itself."""
    shapes = {name: tuple(one or rows for one in dims) for name, dims in network.inputs.items()}
    shapes |= network.weights
    total = sum(map(math.prod, shapes.values()))
    for node in network.nodes:
        if total > NUMBERS:
            break
        made = made_by(node, [shapes[name] for name in node.takes if name])
        shapes |= dict.fromkeys(node.makes, made)
        total += len(node.makes) * math.prod(made)
    return total


def made_by(node: Node, taken: list[Shape]) -> Shape:
    """The shape that a node makes, or a larger one. Operators that are not named here go over their
    inputs element by element."""
    match node.operator:
        case "MatMul":
            return _product(*taken)
        case "Gemm":
            (m, k), (n, o) = taken[:2]
            left, right = node.numbers.get("transA"), node.numbers.get("transB")
            return (k if left else m, n if right else o)
        case "Concat":
            axis = range(len(taken[0]))[node.numbers["axis"]]
            most = [max(sizes) for sizes in zip(*taken, strict=True)]
            return (*most[:axis], sum(one[axis] for one in taken), *most[axis + 1 :])
        case "Flatten":
            axis = node.numbers.get("axis", 1)
            return (math.prod(taken[0][:axis]), math.prod(taken[0][axis:]))
    return _broadcast(*taken)


def _product(a: Shape, b: Shape) -> Shape:
    rows, columns = a[-2:-1], b[-1:] if len(b) > 1 else ()
    return (*_broadcast(a[:-2], b[:-2]), *rows, *columns)


def _broadcast(*shapes: Shape) -> Shape:
    columns = zip_longest(*(one[::-1] for one in shapes), fillvalue=1)
    return tuple(max(sizes) for sizes in columns)[::-1]


# ---- the file -----------------------------------------------------------------------------------


def read_network(model: bytes) -> Network:
    """What a model's bytes say. A part that is there twice counts as both. Raises IndexError or
    ValueError for bytes that are no model."""
    top = list(_fields(model))
    strange = {name for at, name in ((FUNCTIONS, "a function"), (TRAINING, "a training"))
               if any(number == at for number, _ in top)}  # fmt: skip
    graph = [one for number, part in top if number == GRAPH for one in _fields(_bytes(part))]
    layers = [_bytes(part) for number, part in graph if number == NODE]
    if len(layers) > LAYERS or sum(map(len, layers)) > DESCRIBED:
        return Network((), {}, {}, frozenset({f"{len(layers)} layers"}))
    nodes = [_node(part, strange) for part in layers]
    tensors = [_tensor(_bytes(part), strange) for number, part in graph if number == INITIALIZER]
    inputs = [_input(_bytes(part)) for number, part in graph if number == INPUT]
    if any(number == SPARSE for number, _ in graph):
        strange.add("a sparse tensor")
    return Network(tuple(nodes), dict(tensors), dict(inputs), frozenset(strange))


def _node(data: bytes, strange: set[str]) -> Node:
    """A node. What is odd in it goes to `strange`."""
    parts = [(number, part) for number, part in _fields(data) if isinstance(part, bytes)]
    last = {number: part.decode() for number, part in parts if number in (OPERATOR, DOMAIN)}
    operator, domain = last.get(OPERATOR, "an operator without a name"), last.get(DOMAIN, "")
    if domain not in ("", "ai.onnx"):
        strange.add(f"{domain}.{operator}")
    elif operator not in OPERATORS:
        strange.add(operator)
    takes, makes = (
        tuple(part.decode() for number, part in parts if number == side) for side in (FROM, TO)
    )
    attributes = [list(_fields(part)) for number, part in parts if number == ATTRIBUTE]
    if any(number in HELD for one in attributes for number, _ in one):
        strange.add(f"a tensor or graph inside {operator}")
    return Node(operator, takes, makes, dict(map(_whole, attributes)))


def _whole(attribute: list[tuple[int, bytes | int]]) -> tuple[str, int]:
    """An attribute's name and whole number; 0 where it has none."""
    last = dict(attribute)
    number = last.get(INTEGER, 0)
    if not isinstance(number, int):
        raise ValueError("a number that is none")
    return _bytes(last[ATTRIBUTE_NAME]).decode(), number - (1 << 64 if number >> 63 else 0)


def _tensor(data: bytes, strange: set[str]) -> tuple[str, Shape]:
    """A weight's name and shape. One that lies in another file goes to `strange`."""
    parts = list(_fields(data, TENSOR_PARTS))
    if any(number == EXTERNAL or (number == LOCATION and part) for number, part in parts):
        strange.add("weights in another file")
    dims = [one for number, part in parts if number == DIMS for one in _numbers(part)]
    names = [_bytes(part).decode() for number, part in parts if number == TENSOR_NAME]
    return names[-1], _ranked(dims)


def _input(data: bytes) -> tuple[str, Shape]:
    """An input's name and shape; an open dimension is 0."""
    names = [_bytes(part).decode() for number, part in _fields(data) if number == 1]
    dims = _inside(_inside(_inside([data], TYPE), TENSOR), SHAPE)
    sizes = [dict(_fields(one)).get(SIZE, 0) for one in _inside(dims, DIM)]
    return names[-1], _ranked([one for one in sizes if isinstance(one, int)])


def _ranked(dims: list[int]) -> Shape:
    if len(dims) > RANK:
        raise ValueError(f"{len(dims)} dimensions")
    return tuple(dims)


def _inside(messages: list[bytes], field: int) -> list[bytes]:
    found = [part for one in messages for number, part in _fields(one) if number == field]
    return [_bytes(part) for part in found]


def _bytes(part: bytes | int) -> bytes:
    if isinstance(part, int):
        raise ValueError("a number in place of a message")
    return part


def _numbers(part: bytes | int) -> list[int]:
    """One whole number, or all that are packed together."""
    if isinstance(part, int):
        return [part]
    found, at = [], 0
    while at < len(part):
        value, at = _varint(part, at)
        found.append(value)
    return found


def _fields(data: bytes, most: int = PARTS) -> Iterator[tuple[int, bytes | int]]:
    """The parts of a message that are bytes or a whole number, with their fields' numbers. Raises
    IndexError or ValueError."""
    at = count = 0
    while at < len(data):
        key, at = _varint(data, at)
        if (count := count + 1) > most or key >> 32:
            raise ValueError(f"more than {most} parts, or a field of too large a number")
        kind = key & 7
        if kind == BYTES:
            length, at = _varint(data, at)
            if at + length > len(data):
                raise ValueError("a part is longer than the file")
            yield key >> 3, data[at : at + length]
            at += length
        elif kind == VARINT:
            value, at = _varint(data, at)
            yield key >> 3, value
        elif kind in (FIXED64, FIXED32):
            at += 8 if kind == FIXED64 else 4
        else:
            raise ValueError(f"unknown kind {kind}")


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = data[at]
        value |= (byte & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if value >> 64 or shift > 70:
            raise ValueError("a number of more than 64 bits")
        if byte < 0x80:
            return value, at
