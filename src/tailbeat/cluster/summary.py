"""Results of a sweep: a row per trial, one per kind over its seeds, and the best trial."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from tailbeat.cluster.plan import Trial
from tailbeat.evaluate.messy import LABS, PREFIX
from tailbeat.evaluate.rates import of_kind
from tailbeat.files import new_file

RESULT = "result.json"
# Said before a sweep begins, so that nobody chooses it by what comes out.
RULE = (
    "the trial that passed most stages; of these, that which reached most targets in messy labs of"
    " every level (without evaluate.messy, in open water of the pool; without [evaluate], in the"
    " twin); of equals, that with the fewest updates"
)


@dataclass(frozen=True)
class TrialRow:
    """A trial's result. `state` is done, failed, ended early or not done; `why` it failed. Numbers
    are NaN until it is done: stages passed and in all, updates, `hours` of training, and the
    fractions of targets reached in the `twin`, and in the pool in `open` water, inside walls, and
    in the labs of each level."""

    name: str
    group: str
    seed: int
    state: str
    why: str
    folder: str
    passed: float = float("nan")
    stages: float = float("nan")
    updates: float = float("nan")
    hours: float = float("nan")
    targets: float = float("nan")
    twin: float = float("nan")
    swims: float = float("nan")
    open: float = float("nan")
    walled: float = float("nan")
    everyday: float = float("nan")
    rough: float = float("nan")
    wrecked: float = float("nan")

    @property
    def judged(self) -> float:
        """The fraction by which trials are compared: see `RULE`."""
        labs = (self.everyday + self.rough + self.wrecked) / 3
        return next((one for one in (labs, self.open) if not np.isnan(one)), self.twin)


@dataclass(frozen=True)
class GroupRow:
    """All seeds of a kind: how many are done, and the mean fraction of targets reached, in the
    twin, in open water of the pool and in the labs of each level, with its 95 % interval (low,
    high) over seeds and targets, which all seeds share (`rates.over_seeds`). NaN where none was
    swum, and the interval in a sweep of an older release."""

    group: str
    seeds: int
    twin: float
    twin_interval: tuple[float, float]
    open: float
    open_interval: tuple[float, float]
    everyday: float
    everyday_interval: tuple[float, float]
    rough: float
    rough_interval: tuple[float, float]
    wrecked: float
    wrecked_interval: tuple[float, float]


@dataclass(frozen=True)
class SweepResult:
    """Trials, kinds, and the name of the trial that `RULE` chooses, "" without a done one."""

    trials: tuple[TrialRow, ...]
    groups: tuple[GroupRow, ...]
    rule: str
    chosen: str

    @property
    def complete(self) -> bool:
        """Whether every trial has a result, or was ended early by the scheduler."""
        return all(one.state in ("done", "ended early") for one in self.trials)


def collect(
    out: Path, made: Sequence[Trial], failed: Mapping[str, str], ended: Sequence[str] = ()
) -> SweepResult:
    """Read the results in `out/trials`; `failed` says why trials failed, `ended` which the
    scheduler ended early."""
    rows = tuple(_row(out / "trials" / one.name, one, failed, ended) for one in made)
    kinds = list(dict.fromkeys(one.group for one in made))
    groups = tuple(_group(name, [row for row in rows if row.group == name]) for name in kinds)
    return SweepResult(rows, groups, RULE, _chosen(rows))


def _row(folder: Path, trial: Trial, failed: Mapping[str, str], ended: Sequence[str]) -> TrialRow:
    who = trial.name, trial.group, trial.seed
    path = folder / RESULT
    if not path.is_file():
        early = "ended early" if trial.name in ended else "not done"
        state = "failed" if trial.name in failed else early
        return TrialRow(*who, state, failed.get(trial.name, ""), str(folder))
    held = json.loads(path.read_text(encoding="utf-8"))
    trained, twin, pool = held["trained"], held["twin"], held["pool"] or {}
    swum = pool.get("reach open", {})
    return TrialRow(
        *who,
        "done",
        "",
        str(folder),
        trained["stages_passed"],
        trained["stages"],
        trained["updates"],
        trained["seconds"] / 3600,
        twin["targets"],
        twin["reached"],
        swum.get("swims", np.nan),
        swum.get("arrived", np.nan),
        pool.get("reach walled", {}).get("arrived", np.nan),
        *(pool.get(f"{PREFIX}{name}", {}).get("arrived", np.nan) for name in LABS),
    )


def _group(name: str, rows: Sequence[TrialRow]) -> GroupRow:
    done = [row for row in rows if row.state == "done"]
    pool = *_mean(done, "twin"), *_mean(done, "open")
    labs = *_mean(done, "everyday"), *_mean(done, "rough"), *_mean(done, "wrecked")
    return GroupRow(name, len(done), *pool, *labs)


def _mean(rows: Sequence[TrialRow], where: str) -> tuple[float, tuple[float, float]]:
    """Mean fraction of targets reached, and its interval; NaN without hits."""
    hits = [hits_of(Path(row.folder), where) for row in rows]
    if not hits or not all(map(len, hits)):
        unknown = [getattr(row, where) for row in rows] or [np.nan]
        return float(np.mean(unknown)), (np.nan, np.nan)
    found = of_kind(np.array(hits))
    return found.difference, found.interval


def hits_of(folder: Path, where: str) -> list[bool]:
    """Which targets a trial's policy reached, in the `twin`, in `open` water of the pool or in labs
    of a level; none where it did not swim, and in the result of an older release."""
    held = json.loads((folder / RESULT).read_text(encoding="utf-8"))
    return list(held.get("hits", {}).get(where, []))


def _chosen(rows: Sequence[TrialRow]) -> str:
    done = [row for row in rows if row.state == "done"]
    if not done:
        return ""
    return max(done, key=lambda row: (row.passed, row.judged, -row.updates)).name


def write_table(path: Path, result: SweepResult, fields: Mapping[str, Mapping[str, Any]]) -> None:
    """Write one row per trial, its results and its `fields`, as Parquet; replaces a file."""
    rows = [
        {**{k: _cell(v) for k, v in fields[one.name].items()}, **vars(one)} for one in result.trials
    ]
    with new_file(path, overwrite=True) as beside:
        pl.DataFrame(rows, infer_schema_length=None).write_parquet(beside)


def _cell(value: Any) -> Any:
    return value if isinstance(value, int | float | str | bool) else str(value)
