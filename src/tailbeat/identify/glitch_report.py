"""The JSON rows of a report that list its glitches."""

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # without the compiler that the search for them needs
    from tailbeat.identify.glitches import Glitch


def as_rows(found: Iterable["Glitch"]) -> list[dict[str, Any]]:
    """The JSON of a report: recording, column, kind, count and times [s]."""
    return [
        {
            "recording": one.recording,
            "column": one.column,
            "kind": one.kind,
            "count": len(one.times),
            "times": list(one.times),
        }
        for one in found
    ]
