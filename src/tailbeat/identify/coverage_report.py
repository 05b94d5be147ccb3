"""The JSON of `tailbeat coverage`."""

from dataclasses import asdict
from typing import Any

from tailbeat.identify.coverage import LIMIT, Coverage, Quantity
from tailbeat.identify.glitch_report import as_rows


def as_json(found: Coverage) -> dict[str, Any]:
    """The result of `tailbeat coverage`: SI, fractions from 0 to 1."""
    return {
        "covered": found.covered,
        "limit": LIMIT,
        "quantities": [_row(one) for one in found.quantities],
        "bands": [asdict(band) for band in found.bands],
        "missing": list(found.missing),
        "advice": found.advice,
        "glitches": as_rows(found.glitches),
    }


def _row(one: Quantity) -> dict[str, Any]:
    numbers = {name: value for name, value in asdict(one).items() if name != "term"}
    named = {"quantity": one.term.name, "unit": one.term.unit, "covered": one.covered}
    return {**named, "outside": one.outside, **numbers}
