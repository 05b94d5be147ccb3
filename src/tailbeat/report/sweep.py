"""The page of a sweep: what it chose and by which rule, kinds over their seeds, all trials."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tailbeat.cluster.summary import GroupRow, SweepResult, TrialRow
from tailbeat.report import html
from tailbeat.report.html import Section
from tailbeat.report.tables import percent


def write(out: Path, result: SweepResult, config: Mapping[str, Any]) -> Path:
    """Write `report.html` and `report.json` into a folder; returns the page's path."""
    chosen = {"rule": result.rule, "trial": result.chosen or "none is done"}
    if result.chosen:
        chosen["policy"] = f"trials/{result.chosen}/run/policy.onnx"
    sections = [
        Section("Chosen", (html.values(chosen),)),
        Section("Kinds, over their seeds", (html.table(kinds(result)),)),
        Section("Trials", (html.table(trials(result)),)),
    ]
    return html.write(out, sections, {"result": result, "sweep": config}, "Sweep")


def kinds(result: SweepResult) -> list[dict[str, Any]]:
    """A row per kind: success rates in percent with their 95 % intervals."""
    return _filled([_kind(one) for one in result.groups])


def trials(result: SweepResult) -> list[dict[str, Any]]:
    """A row per trial; None where nothing is known."""
    return _filled([_trial(one) for one in result.trials])


def _filled(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The columns that have a value in some row."""
    kept = [name for name in rows[0] if any(row[name] is not None for row in rows)] if rows else []
    return [{name: row[name] for name in kept} for row in rows]


def _kind(row: GroupRow) -> dict[str, Any]:
    return {
        "kind": row.group,
        "seeds done": row.seeds,
        "twin [%]": _rate(row.twin, row.twin_interval),
        "pool, open [%]": _rate(row.open, row.open_interval),
        "everyday [%]": _rate(row.everyday, row.everyday_interval),
        "rough [%]": _rate(row.rough, row.rough_interval),
        "wrecked [%]": _rate(row.wrecked, row.wrecked_interval),
    }


def _trial(row: TrialRow) -> dict[str, Any]:
    stages = None if np.isnan(row.passed) else f"{row.passed:.0f} of {row.stages:.0f}"
    return {
        "trial": row.name,
        "state": row.state,
        "stages": stages,
        "updates": _known(row.updates),
        "training [h]": _known(row.hours),
        "twin [%]": _known(100 * row.twin),
        "pool, open [%]": _known(100 * row.open),
        "pool, walls [%]": _known(100 * row.walled),
        "everyday [%]": _known(100 * row.everyday),
        "rough [%]": _known(100 * row.rough),
        "wrecked [%]": _known(100 * row.wrecked),
        "why": row.why or None,
    }


def _known(value: float) -> float | None:
    return None if np.isnan(value) else float(value)


def _rate(value: float, interval: tuple[float, float]) -> str | None:
    if np.isnan(value):
        return None
    return f"{100 * value:.1f}" if np.isnan(interval[0]) else percent(value, interval)
