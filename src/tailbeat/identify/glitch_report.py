"""The JSON rows of a report that list its glitches."""

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # the module would import numba
    from tailbeat.identify.glitches import Glitch


def as_rows(found: Iterable["Glitch"]) -> list[dict[str, Any]]:
    """Glitches as JSON rows: recording, column, kind, count and times [s]."""
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
