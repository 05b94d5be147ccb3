"""The fields in which the contracts of two policies differ."""

from dataclasses import asdict, dataclass
from typing import Any

from tailbeat.control.policy import Contract
from tailbeat.files import leaves


@dataclass(frozen=True)
class Difference:
    """A field in which two contracts differ: its dotted name and its two values."""

    field: str
    a: Any
    b: Any


def differences(a: Contract, b: Contract) -> list[Difference]:
    """Every field in which two contracts differ, nested fields by dotted name. A field that one
    contract lacks is None there."""
    left, right = (leaves("", asdict(contract)) for contract in (a, b))
    names = sorted(set(left) | set(right))
    return [
        Difference(name, left.get(name), right.get(name))
        for name in names
        if left.get(name) != right.get(name)
    ]
