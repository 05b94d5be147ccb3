"""How much of each nuisance a policy stands: `tailbeat margins`.

For every nuisance of `pool.mess`, the size at which success at 5 cm, and at 20 cm, falls below 75 %
of the targets: alone, and with all others at their everyday sizes.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tailbeat.control.policy import Policy, contract_digest
from tailbeat.evaluate import store
from tailbeat.evaluate.evaluation import EvaluationConfig, pool_of
from tailbeat.evaluate.margin_cells import (
    BASES,
    ENOUGH,
    FEW,
    RESTS,
    RINGS,
    Cell,
    Hits,
    Rest,
    Ring,
    Table,
    bracket,
    keep_cells,
    largest,
    next_cells,
    read_cells,
    reported,
    swum,
    tried_of,
)
from tailbeat.evaluate.rates import SuccessRates, success
from tailbeat.evaluate.trial import Pool
from tailbeat.files import BadInput, write_json
from tailbeat.fish.description import Fish
from tailbeat.fish.store import digest
from tailbeat.pool import mess
from tailbeat.pool.mess import BY_NAME

BATCH = 60  # cells in one batch
DRAWS = 1000  # of the bootstrap over targets
MOST = 1000  # targets of a cell; all nuisances take hours then
RUN, FOUND = "margins-run.json", "margins.json"
Report = Callable[[str, int, int], None]  # what, cells done, cells known of
Swim = Callable[[Sequence[Cell], Table], dict[Cell, Hits]]  # cells, and what was swum of all


@dataclass(frozen=True)
class MarginsConfig:
    """The pool's `fish`; the `twin` that the policy was trained in (None: the one that it names);
    how many `targets` a cell has at most; the `nuisances` (none: all); the seed."""

    fish: str = "pulley-fish"
    twin: str | None = None
    targets: int = 40
    nuisances: tuple[str, ...] = ()
    seed: int = 0


@dataclass(frozen=True)
class MarginsRun:
    """What a folder's cells were swum with: digests of the policy, of the pool's fish and of the
    mess; the number of targets and the seed."""

    policy: str
    fish: str
    fish_digest: str
    mess: str
    targets: int
    seed: int


@dataclass(frozen=True, kw_only=True)
class Margin:
    """How much of a nuisance is stood, in `unit`.

    `rest`: what all others are; `ring`: arrived (5 cm) or near (20 cm). `size` at which success
    falls below 75 %, with a 95 % interval over targets; None: more than `most`, the largest that
    can be simulated. `safety` is the size (or `most`) over the lab's own figure, or over the
    everyday size where the lab gives none.
    """

    nuisance: str
    unit: str
    what: str
    everyday: float
    most: float
    rest: Rest
    ring: Ring
    size: float | None
    interval: tuple[float, float | None]
    lab: float | None
    safety: float


@dataclass(frozen=True, kw_only=True)
class Margins:
    """All margins of a policy; success in the clean pool, and with everything everyday; the
    `thinnest` three, arriving among everyday nuisances; cells and swims that it took."""

    run: MarginsRun
    clean: SuccessRates
    everyday: SuccessRates
    margins: tuple[Margin, ...]
    thinnest: tuple[str, ...]
    cells: int
    swims: int


def margins(
    policy: Policy,
    config: MarginsConfig,
    out: Path,
    report: Report,
    swim: Swim | None = None,
    batch: int = BATCH,
) -> Margins:
    """Swim what is missing, then read the margins; a run that was stopped continues.

    `swim` swims at most `batch` cells on; None: here. Nuisances that the folder has from earlier
    calls are read too. Raises BadInput if the policy does not fit, the folder has other cells, a
    nuisance is unknown, or a figure of the lab is too large.
    """
    names, pool = _names(config), pool_for(policy, config)
    wanted, lab = _described(policy, pool), lab_of(pool.fish, config.fish)
    _begin(out, wanted)
    table = read_cells(out)
    while todo := next_cells(names, table, pool.count):
        for first in range(0, len(todo), batch):
            own = todo[first : first + batch]
            table |= swim(own, table) if swim else swum(policy, pool, own, table)
            keep_cells(out, table)
            left = next_cells(names, table, pool.count)
            report("cells", len(table), len(table) + len(left))
    done = numbers(table, reported(names, table, pool.count), wanted, lab)
    write_json(out / FOUND, done, overwrite=True)
    return done


def read_margins(out: Path) -> Margins:
    """Read the margins of a folder. Raises BadInput."""
    if not (out / FOUND).is_file():
        raise BadInput(
            f"{out}: no margins in it ({FOUND} is missing); run `tailbeat margins` to its end."
        )
    return store.read_record(Margins, out / FOUND)


def pool_for(policy: Policy, config: MarginsConfig) -> Pool:
    """The pool that the cells are swum in. Raises BadInput if the policy does not fit."""
    given = EvaluationConfig(config.fish, config.twin, episodes=config.targets, seed=config.seed)
    return pool_of(policy, given)


def _names(config: MarginsConfig) -> tuple[str, ...]:
    if not FEW <= config.targets <= MOST:
        raise BadInput(f"--targets {config.targets}: give {FEW} to {MOST}.")
    mess.check(dict.fromkeys(config.nuisances, 0.0))
    return tuple(dict.fromkeys(config.nuisances)) or tuple(BY_NAME)


def _described(policy: Policy, pool: Pool) -> MarginsRun:
    own, fish = contract_digest(policy.contract), pool.fish
    return MarginsRun(own, fish.name, digest(fish), mess.fingerprint(), pool.count, pool.seed)


def _begin(out: Path, wanted: MarginsRun) -> None:
    """Write what the cells are swum with. Raises BadInput if the folder has others."""
    path = out / RUN
    if not path.is_file():
        if out.exists() and any(out.iterdir()):
            raise BadInput(f"{out}: contains other files; choose a new folder.")
        write_json(path, wanted)
        return
    held = store.read_record(MarginsRun, path)
    for name, value in vars(wanted).items():
        if getattr(held, name) != value:
            raise BadInput(
                f"{out}: its cells have {name} {getattr(held, name)}, not {value}. Use the same"
                f" policy and options, or a new folder."
            )


# ---- numbers ------------------------------------------------------------------------------------


def lab_of(fish: Fish, where: str) -> Mapping[str, float]:
    """The lab's own figures, by nuisance, each in the nuisance's unit, of a fish from the file or
    of the shipped name `where`. Raises BadInput for one that is larger than what can be simulated,
    as a number without a unit may be."""
    return {} if fish.lab is None else mess.of_figures(fish.lab, where)


def numbers(
    table: Table, names: Sequence[str], run: MarginsRun, lab: Mapping[str, float]
) -> Margins:
    """Margins from the cells."""
    rows = [
        _margin(name, rest, ring, table, lab.get(name))
        for name in names
        for rest in RESTS
        for ring in RINGS
    ]
    return Margins(
        run=run,
        clean=_base("alone", table),
        everyday=_base("everyday", table),
        margins=tuple(rows),
        thinnest=tuple(row.nuisance for row in by_safety(rows)[:3]),
        cells=len(table),
        swims=sum(len(hits.arrived) for hits in table.values()),
    )


def by_safety(rows: Sequence[Margin]) -> list[Margin]:
    """The margins of arriving among everyday nuisances, the thinnest first."""
    own = (row for row in rows if (row.rest, row.ring) == ("everyday", "arrived"))
    return sorted(own, key=lambda row: row.safety)


def _base(rest: Rest, table: Table) -> SuccessRates:
    hits = table[BASES[rest]]
    return success(np.array(hits.arrived), np.array(hits.near))


def _margin(name: str, rest: Rest, ring: Ring, table: Table, lab: float | None) -> Margin:
    one = BY_NAME[name]
    tried = {f: getattr(h, ring) for f, h in tried_of(name, rest, table).items()}
    size = crossing({factor: float(np.mean(hits)) for factor, hits in tried.items()})
    low, high = _interval(tried)
    low = min(low, largest(name))
    found = None if size is None else size * one.everyday
    return Margin(
        nuisance=name, unit=one.unit, what=one.what, everyday=one.everyday, most=one.most,
        rest=rest, ring=ring, size=found, lab=lab,
        interval=(low * one.everyday, None if high is None else high * one.everyday),
        safety=(one.most if found is None else found) / (lab or one.everyday),
    )  # fmt: skip


def crossing(rates: Mapping[float, float]) -> float | None:
    """Factor at which success falls below `ENOUGH`: interpolated, in the logarithm, between the
    largest that is stood and the smallest that is not. None: all are stood."""
    low, high = bracket(rates)
    if np.isinf(high):
        return None
    if low not in rates:  # not even the smallest that was tried
        return high
    if low == 0:
        return high * (1 - (ENOUGH - rates[high]) / max(rates[0.0] - rates[high], 1e-9))
    share = (rates[low] - ENOUGH) / (rates[low] - rates[high])
    return float(low * (high / low) ** share)


def _interval(tried: Mapping[float, tuple[bool, ...]]) -> tuple[float, float | None]:
    """95 % interval of `crossing`, by a bootstrap over the targets that all cells share."""
    count = max(map(len, tried.values()))
    rng = np.random.default_rng(0)
    found, hit = [], {factor: np.array(hits) for factor, hits in tried.items()}
    for _ in range(DRAWS):
        drawn = rng.integers(count, size=count)
        rates = {factor: _rate(hits, drawn) for factor, hits in hit.items()}
        one = crossing(rates)
        found.append(np.inf if one is None else one)
    low, high = np.quantile(found, [0.025, 0.975], method="inverted_cdf")
    return float(low), None if np.isinf(high) else float(high)


def _rate(hits: NDArray[np.bool_], drawn: NDArray[np.int64]) -> float:
    own = drawn[drawn < len(hits)]
    return float(hits[own].mean()) if own.size else float(hits.mean())
