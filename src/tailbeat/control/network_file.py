"""What an ONNX file may hold before anything runs it: its size, and which operators.

A policy is a few layers. A loop that never ends, a constant of gigabytes or a network that is not
ours must not reach the robot, so the file's own list of operators is read first. That needs only
the wire format of protocol buffers (a key and a length before each part), so the robot does not
install the package `onnx`.
"""

from collections.abc import Iterator
from pathlib import Path

from tailbeat.files import BadInput

LARGEST = 32 << 20  # bytes; a policy has 0.7 MB
# Layers and what may stand between them. None makes data larger than its inputs by much, and none
# holds a graph of its own.
OPERATORS = frozenset({
    "Add", "Clip", "Concat", "Div", "Elu", "Flatten", "Gemm", "Identity", "LayerNormalization",
    "LeakyRelu", "MatMul", "Mul", "Relu", "Sigmoid", "Softplus", "Sub", "Tanh",
})  # fmt: skip
# Fields of ModelProto, GraphProto and NodeProto. A sparse tensor may be small here and huge there.
GRAPH, FUNCTIONS, NODE, SPARSE, OPERATOR = 7, 25, 1, 15, 4
VARINT, FIXED64, BYTES, FIXED32 = 0, 1, 2, 5  # kinds of a field


def check_network(path: Path) -> None:
    """Raises BadInput for a file that is too large, or has an operator that no policy needs."""
    if path.stat().st_size > LARGEST:
        raise BadInput(
            f"{path}: {path.stat().st_size / 1e6:.0f} MB; a policy has less than"
            f" {LARGEST / 1e6:.0f}. Give a policy that tailbeat exported."
        )
    try:
        names = set(_operators(path.read_bytes()))
    except (IndexError, ValueError):
        raise BadInput(f"{path}: not a readable ONNX file; export the policy again.") from None
    if strange := sorted(names - OPERATORS):
        raise BadInput(
            f"{path}: the network has {', '.join(strange[:5])}, which no policy of tailbeat needs;"
            f" export it again, or put the operator among those allowed."
        )


def _operators(model: bytes) -> Iterator[str]:
    """The operators of a model; a function of its own counts as one."""
    for number, graph in _fields(model):
        if number == FUNCTIONS:
            yield "a function"
        for inner, node in _fields(graph) if number == GRAPH else ():
            if inner == SPARSE:
                yield "a sparse tensor"
            if inner == NODE:
                named = [text.decode() for field, text in _fields(node) if field == OPERATOR]
                yield named[0] if named else "an operator without a name"


def _fields(data: bytes) -> Iterator[tuple[int, bytes]]:
    """The numbers and bytes of a message's parts that have a length. Raises ValueError."""
    at = 0
    while at < len(data):
        key, at = _varint(data, at)
        kind = key & 7
        if kind == BYTES:
            length, at = _varint(data, at)
            if at + length > len(data):
                raise ValueError("a part is longer than the file")
            yield key >> 3, data[at : at + length]
            at += length
        elif kind == VARINT:
            _, at = _varint(data, at)
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
        if byte < 0x80 or shift > 63:
            return value, at
