"""Results of a comparison: its cells on disk, and tables of them."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tailbeat.evaluate import store
from tailbeat.evaluate.provenance import Provenance, provenance
from tailbeat.evaluate.rates import Difference, SuccessRates, apart, of_kind, over_seeds, paired
from tailbeat.files import BadInput

TWIN = "twin"  # the condition that the others are compared with
REFERENCE = ("generator", "identified")  # kind that the others are compared with, if it swam
AVERAGED = (
    "near", "share_below", "share_below_floor", "share_inside", "share_above",
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
    """A `Manner` on disk, with the pool's fish, number of targets and seed (`field`), which targets
    were reached within 5 and 20 cm, and digests of the policy's contract and of the `pool` (both
    None in cells of releases up to 0.2.0)."""

    field: tuple[str, int, int]
    hits_arrived: tuple[bool, ...]
    hits_near: tuple[bool, ...]
    digest: str | None = None
    pool: str | None = None


@dataclass(frozen=True, kw_only=True)
class Row(Manner):
    """A `Manner` with the success rates in the twin minus those here, over the same targets; None
    if the twin was not swum."""

    arrived_gap: Difference | None
    near_gap: Difference | None


@dataclass(frozen=True, kw_only=True)
class Kind:
    """Means over the policies (seeds) of one kind under one condition, NaN where no policy has the
    number; units as in `Manner`.

    Intervals are over seeds and targets, with one policy over targets alone. `gap` is the rate of
    arrivals in the twin minus that here; `lead` is the rate minus that of the reference kind, NaN
    if that did not swim, and of that kind itself. `seeds_spread` is the standard deviation of the
    seeds' rates, NaN for one.
    """

    actions: str
    servo: str
    condition: str
    policies: int
    arrived: float
    arrived_interval: tuple[float, float]
    gap: float
    gap_interval: tuple[float, float]
    lead: float
    lead_interval: tuple[float, float]
    seeds_spread: float
    near: float
    share_below: float
    share_below_floor: float
    share_inside: float
    share_above: float
    actuator_watts: float
    reversals_per_minute: float
    speed: float
    speed_in_twin: float


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
    cells = [one for _, one in cells_in(out)]
    if not cells:
        raise BadInput(f"{out}: no cells of a comparison in it; `tailbeat compare` makes them.")
    if len({one.field for one in cells}) > 1:
        raise BadInput(f"{out}: cells of several comparisons; use one folder for each.")
    twins = {one.policy: one for one in cells if one.condition == TWIN}
    rows = tuple(_row(one, twins.get(one.policy)) for one in cells)
    return Comparison(rows, _kinds(cells), provenance())


def cells_in(out: Path) -> list[tuple[Path, Cell]]:
    """The cells of a folder, with their paths. Raises BadInput."""
    return [(path, _read_cell(path)) for path in sorted((out / "cells").glob("*.json"))]


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


def _kinds(cells: Sequence[Cell]) -> tuple[Kind, ...]:
    groups: dict[tuple[str, str, str], list[Cell]] = {}
    for one in cells:
        groups.setdefault((one.actions, one.servo, one.condition), []).append(one)
    return tuple(
        _kind(key, own, groups.get((*key[:2], TWIN), []), groups.get((*REFERENCE, key[2]), []))
        for key, own in groups.items()
        if key[2] != TWIN
    )


def _kind(
    key: tuple[str, str, str], own: Sequence[Cell], twins: Sequence[Cell], others: Sequence[Cell]
) -> Kind:
    hits, unknown = _hits(own), Difference(float("nan"), (float("nan"), float("nan")))
    rate = of_kind(hits)
    in_twin = _hits([one for one in twins if one.policy in {cell.policy for cell in own}])
    gap = over_seeds(in_twin * 1.0 - hits) if in_twin.shape == hits.shape else unknown
    compared = bool(others) and key[:2] != REFERENCE
    lead = apart(hits * 1.0, _hits(others) * 1.0) if compared else unknown
    return Kind(
        actions=key[0],
        servo=key[1],
        condition=key[2],
        policies=len(own),
        arrived=rate.difference,
        arrived_interval=rate.interval,
        gap=gap.difference,
        gap_interval=gap.interval,
        lead=lead.difference,
        lead_interval=lead.interval,
        seeds_spread=float(hits.mean(axis=1).std(ddof=1)) if len(own) > 1 else float("nan"),
        **{name: _mean([getattr(one, name) for one in own]) for name in AVERAGED},
    )


def _hits(cells: Sequence[Cell]) -> NDArray[np.bool_]:
    """Which targets the policies of these cells arrived at (policies, targets)."""
    return np.array([one.hits_arrived for one in sorted(cells, key=lambda one: one.policy)], bool)


def _mean(values: Sequence[float | None]) -> float:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else float("nan")
