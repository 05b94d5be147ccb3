"""Results of a comparison: its cells on disk, and tables of them."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from tailbeat.evaluate import store
from tailbeat.evaluate.provenance import Provenance, provenance
from tailbeat.evaluate.rates import Difference, SuccessRates, paired
from tailbeat.files import BadInput

TWIN = "twin"  # the condition that the others are compared with
AVERAGED = (
    "arrived", "near", "share_below", "share_below_floor", "share_inside", "share_above",
    "actuator_watts", "reversals_per_minute", "speed", "speed_in_twin",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Manner(SuccessRates):
    """A policy under one condition, and how it swam.

    Kind of its `actions`, `servo` of its twin, `seed` and `stage` of its training. Speed [m/s],
    also the twin's with the same setpoints; power of the actuator [W]; changes between forward and
    backward per minute; fractions of the motor's velocity power below its band's upper edge, below
    the lower edge, inside and above the band.
    """

    policy: str
    actions: str
    servo: str
    seed: int | None
    stage: str | None
    condition: str
    targets: int
    speed: float | None
    actuator_watts: float | None
    reversals_per_minute: float | None
    share_below: float | None
    share_below_floor: float | None = None
    share_inside: float | None = None
    share_above: float | None = None
    speed_in_twin: float | None


@dataclass(frozen=True, kw_only=True)
class Cell(Manner):
    """A `Manner` on disk, with the pool's fish, number of targets and seed (`field`), and which
    targets were reached within 5 and 20 cm."""

    field: tuple[str, int, int]
    hits_arrived: tuple[bool, ...]
    hits_near: tuple[bool, ...]


@dataclass(frozen=True, kw_only=True)
class Row(Manner):
    """A `Manner` with the success rates in the twin minus those here, over the same targets; None
    if the twin was not swum."""

    arrived_gap: Difference | None
    near_gap: Difference | None


@dataclass(frozen=True, kw_only=True)
class Kind:
    """Means over the policies (seeds) of one kind under one condition, NaN where no policy has the
    number; units as in `Manner`. The gap's interval treats targets and seeds as independent."""

    actions: str
    servo: str
    condition: str
    policies: int
    arrived: float
    near: float
    share_below: float
    share_below_floor: float
    share_inside: float
    share_above: float
    actuator_watts: float
    reversals_per_minute: float
    speed: float
    speed_in_twin: float
    near_gap: float
    gap_near_interval: tuple[float, float]


@dataclass(frozen=True)
class Comparison:
    """A row per policy and condition, and one per kind of policy and condition of the pool."""

    rows: tuple[Row, ...]
    kinds: tuple[Kind, ...]
    provenance: Provenance


def cell_path(out: Path, policy: str, condition: str) -> Path:
    """Path of a cell's file."""
    return out / "cells" / f"{policy}.{condition.replace(' ', '-')}.json"


def has_cells(out: Path) -> bool:
    """Whether a folder has cells of a comparison."""
    return any((out / "cells").glob("*.json"))


def read(out: Path) -> Comparison:
    """Read the tables of all cells. Raises BadInput if there are none, or cells of several
    comparisons."""
    cells = [_read_cell(path) for path in sorted((out / "cells").glob("*.json"))]
    if not cells:
        raise BadInput(f"{out}: no cells of a comparison in it; `tailbeat compare` makes them.")
    if len({one.field for one in cells}) > 1:
        raise BadInput(f"{out}: cells of several comparisons; use one folder for each.")
    twins = {one.policy: one for one in cells if one.condition == TWIN}
    rows = tuple(_row(one, twins.get(one.policy)) for one in cells)
    return Comparison(rows, _kinds([row for row in rows if row.condition != TWIN]), provenance())


def _read_cell(path: Path) -> Cell:
    """Read a cell; in older cells `arm` is the condition."""
    held = store.read_json(path)
    if "arm" in held:
        held["condition"] = held.pop("arm")
    return store.as_record(Cell, held, path)


def _row(one: Cell, twin: Cell | None) -> Row:
    kept = {field.name: getattr(one, field.name) for field in fields(Manner)}
    if twin is None:
        return Row(**kept, arrived_gap=None, near_gap=None)
    return Row(
        **kept,
        arrived_gap=paired(np.array(one.hits_arrived), np.array(twin.hits_arrived)),
        near_gap=paired(np.array(one.hits_near), np.array(twin.hits_near)),
    )


def _kinds(rows: Sequence[Row]) -> tuple[Kind, ...]:
    groups: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        groups.setdefault((row.actions, row.servo, row.condition), []).append(row)
    return tuple(_kind(key, own) for key, own in groups.items())


def _kind(key: tuple[str, str, str], own: Sequence[Row]) -> Kind:
    gaps = [row.near_gap for row in own if row.near_gap]
    mean = float(np.mean([gap.difference for gap in gaps])) if gaps else float("nan")
    halves = [gap.interval[1] - gap.difference for gap in gaps]
    half = float(np.sqrt(np.square(halves).sum()) / len(gaps)) if gaps else float("nan")
    return Kind(
        actions=key[0],
        servo=key[1],
        condition=key[2],
        policies=len(own),
        **{name: _mean([getattr(row, name) for row in own]) for name in AVERAGED},
        near_gap=mean,
        gap_near_interval=(mean - half, mean + half),
    )


def _mean(values: Sequence[float | None]) -> float:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else float("nan")
