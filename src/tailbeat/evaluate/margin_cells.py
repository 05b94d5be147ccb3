"""Cells of the margins: a nuisance at one size, swum to paired targets; which cell comes next.

Every cell has the same targets, waters, noise, sides and directions. Sizes double until fewer than
`ENOUGH` of the targets are reached; then the gap is halved, in its logarithm.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tailbeat.control.policy import Policy, decide
from tailbeat.env.task import Scene
from tailbeat.env.world import seeds_from
from tailbeat.evaluate import store
from tailbeat.evaluate.scenes import grid
from tailbeat.evaluate.trial import Condition, Pool, in_labs, swim
from tailbeat.files import write_json
from tailbeat.pool import mess

Array = NDArray[np.float64]
Rest = Literal["alone", "everyday"]  # what all other nuisances are
Ring = Literal["arrived", "near"]  # 5 cm and 20 cm, of the paper's fish
RESTS: tuple[Rest, ...] = ("alone", "everyday")
RINGS: tuple[Ring, ...] = ("arrived", "near")
CELLS = "cells.json"
ENOUGH = 0.75  # success rate below which a size is too much (an outside audit's)
FIRST, LEAST = 2.0, 0.25  # times the everyday size: the first and the smallest that are tried
CLOSE = 2**0.25 + 1e-6  # the last bracket's ends, one over the other
FEW = 16  # targets after which a clear cell is not swum on
CLEAR = (8, 15)  # of the first targets: this or fewer, or this or more, is clear


@dataclass(frozen=True, order=True)
class Cell:
    """A nuisance at `factor` times its everyday size."""

    nuisance: str
    rest: Rest
    factor: float


@dataclass(frozen=True)
class Hits:
    """Which of a cell's targets were `arrived` at, and which came `near`, in the targets' order."""

    arrived: tuple[bool, ...] = ()
    near: tuple[bool, ...] = ()

    def rate(self, ring: Ring) -> float:
        """Success rate."""
        return float(np.mean(getattr(self, ring)))

    def clear(self, ring: Ring) -> bool:
        """Whether the targets so far tell the rate from `ENOUGH`."""
        hits = sum(getattr(self, ring)[:FEW])
        return len(self.arrived) > FEW or not CLEAR[0] < hits < CLEAR[1]


Table = Mapping[Cell, Hits]
EVERYTHING = "everything"  # in the place of a nuisance
BASES: Mapping[Rest, Cell] = {
    "alone": Cell(EVERYTHING, "alone", 0.0),
    "everyday": Cell(EVERYTHING, "everyday", 1.0),
}


def sizes(cell: Cell) -> mess.Sizes:
    """Sizes of all nuisances in a cell, each in its own unit."""
    rest = mess.times(0.0 if cell.rest == "alone" else 1.0)
    if cell.nuisance == EVERYTHING:
        return rest
    one = mess.BY_NAME[cell.nuisance]
    return {**rest, cell.nuisance: min(cell.factor * one.everyday, one.most)}


def largest(nuisance: str) -> float:
    """The largest size that can be simulated, over the everyday one."""
    one = mess.BY_NAME[nuisance]
    return one.most / one.everyday


# ---- which cell is next -------------------------------------------------------------------------


def following(nuisance: str, rest: Rest, ring: Ring, table: Table, count: int) -> Cell | None:
    """The cell that a search over `count` targets needs next; None once it is over."""
    tried = tried_of(nuisance, rest, table)
    low, high = bracket({factor: hits.rate(ring) for factor, hits in tried.items()})
    for edge in (low, high):
        hits = tried.get(edge)
        if hits is not None and len(hits.arrived) < count and not hits.clear(ring):
            return Cell(nuisance, rest, edge)
    factor = _inside(low, high, largest(nuisance))
    return None if factor is None else Cell(nuisance, rest, factor)


def next_cells(names: Sequence[str], table: Table, count: int) -> list[Cell]:
    """The cells that the searches of some nuisances need next."""
    bases = [base for base in BASES.values() if len(table.get(base, Hits()).arrived) < count]
    if bases:
        return bases
    found = (
        following(name, rest, ring, table, count)
        for name in names
        for rest in RESTS
        for ring in RINGS
    )
    return list(dict.fromkeys(cell for cell in found if cell is not None))


def reported(names: Sequence[str], table: Table, count: int) -> tuple[str, ...]:
    """The nuisances of `names`, and all others whose searches are over; in the usual order."""
    return tuple(
        name for name in mess.BY_NAME if name in names or not next_cells([name], table, count)
    )


def tried_of(nuisance: str, rest: Rest, table: Table) -> dict[float, Hits]:
    """Results of a nuisance by factor. Where all others are everyday, factor 1 is everything
    everyday; where they are none, factor 0 is the clean pool."""
    own = {cell.factor: hits for cell, hits in table.items() if _about(cell) == (nuisance, rest)}
    base = BASES[rest]
    return own | ({base.factor: table[base]} if base in table else {})


def _about(cell: Cell) -> tuple[str, Rest]:
    return cell.nuisance, cell.rest


def bracket(rates: Mapping[float, float]) -> tuple[float, float]:
    """The largest factor that is stood, 0 if none, and the smallest that is not, inf if none."""
    high = min((f for f, rate in rates.items() if rate < ENOUGH), default=np.inf)
    low = max((f for f, rate in rates.items() if rate >= ENOUGH and f < high), default=0.0)
    return low, high


def _inside(low: float, high: float, most: float) -> float | None:
    """The next factor to try between two; None if they are close enough."""
    if high == 0:  # not even in a clean pool
        return None
    if np.isinf(high):
        return None if low >= most else _rounded(min(max(FIRST, 2 * low), most))
    if low == 0:
        return None if high <= LEAST else _rounded(high / 2)
    return None if high / low <= CLOSE else _rounded(float(np.sqrt(low * high)))


def _rounded(factor: float) -> float:
    """A factor with six digits, as it is kept in a file."""
    return float(f"{factor:.6g}")


# ---- swimming -----------------------------------------------------------------------------------


def swum(policy: Policy, pool: Pool, cells: Sequence[Cell], table: Table) -> dict[Cell, Hits]:
    """Swim the next targets of some cells together: the first `FEW`, then all others."""
    held = [table.get(cell, Hits()) for cell in cells]
    which = [_next_targets(len(hits.arrived), pool.count) for hits in held]
    labs = [
        mess.draw(sizes(cell), [pool.seed, int(i)])
        for cell, own in zip(cells, which, strict=True)
        for i in own
    ]
    every, seeds = np.concatenate(which), seeds_from(pool.seed, pool.count)
    condition = in_labs(_condition(pool, every), labs)
    runs = swim(partial(decide, policy), condition, [seeds[i] for i in every])
    ends = np.cumsum([len(own) for own in which])[:-1]
    arrived, near = np.split(runs.reached, ends), np.split(runs.reached | runs.near, ends)
    return {
        cell: Hits((*hits.arrived, *a.tolist()), (*hits.near, *n.tolist()))
        for cell, hits, a, n in zip(cells, held, arrived, near, strict=True)
    }


def _next_targets(done: int, count: int) -> NDArray[np.int64]:
    return np.arange(done, min(FEW, count) if done < FEW else count)


def _condition(pool: Pool, which: NDArray[np.int64]) -> Condition:
    """Swims to some of the targets, within +-180 deg and 0.5-2.5 m, of the paper's fish."""
    near, far = 0.5 * pool.measure.reach, 2.5 * pool.measure.reach
    scene = grid(pool.fish, pool.count, pool.seed + 4, near, far, np.pi)
    chosen = Scene(*(values[which] for values in vars(scene).values()))
    water = tuple(pool.waters[i % len(pool.waters)] for i in which)
    return pool.condition("margins", chosen, water=water)


# ---- on disk ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Row:
    """A cell on disk."""

    cell: Cell
    hits: Hits


def keep_cells(out: Path, table: Table) -> None:
    """Write all cells, in one file."""
    rows = [Row(cell, hits) for cell, hits in sorted(table.items(), key=lambda item: item[0])]
    write_json(out / CELLS, rows, overwrite=True)


def read_cells(out: Path) -> dict[Cell, Hits]:
    """The cells of a folder; none if it has none. Raises BadInput."""
    if not (out / CELLS).is_file():
        return {}
    rows = store.read_record(list[Row], out / CELLS)
    return {row.cell: row.hits for row in rows}
