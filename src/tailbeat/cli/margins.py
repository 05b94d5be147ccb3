"""Measure how much of each nuisance a policy stands."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tailbeat.cli import output, progress
from tailbeat.cli.options import (
    AddressOption,
    JsonOption,
    PolicyFile,
    PoolFish,
    SeedOption,
    TwinOption,
)
from tailbeat.files import check_json, need, put_json

if TYPE_CHECKING:
    from tailbeat.control.measure import Measure
    from tailbeat.evaluate.margins import Margin, Margins


def margins(
    policy: PolicyFile,
    out: Annotated[
        Path, typer.Option("--out", help="Folder of the cells; an existing one is continued.")
    ],
    fish: PoolFish = "pulley-fish",
    twin: TwinOption = None,
    nuisance: Annotated[
        list[str] | None, typer.Option("--nuisances", help="Nuisances; default: all.")
    ] = None,
    targets: Annotated[int, typer.Option(help="Most targets of a cell, 16 to 1000.")] = 40,
    address: AddressOption = None,
    seed: SeedOption = 0,
    json: JsonOption = None,
) -> None:
    """Measure how much of each thing that labs get wrong a policy stands. For every nuisance of
    the messy pool, alone and with all others at their everyday sizes: the size at which it reaches
    fewer than three quarters of its targets. The same command resumes an interrupted run."""
    check_json(json, out, "margins-run.json", "cells.json", "margins.json", "margins.png")
    if address is not None:
        need("a cluster", "ray")
    from tailbeat.cluster.margins import margins_on
    from tailbeat.control.policy import load_policy
    from tailbeat.evaluate.margins import MarginsConfig
    from tailbeat.evaluate.margins import margins as measure
    from tailbeat.report.margins import margins_figure

    config = MarginsConfig(fish, twin, targets, tuple(nuisance or ()), seed)
    loaded = load_policy(policy)
    with progress.counting() as count:
        if address is None:
            done = measure(loaded, config, out, count)
        else:
            done = margins_on(address, policy, config, out, count)
    own = loaded.contract.measure
    margins_figure(done, own, out / "margins.png", overwrite=True)
    _print(done, own)
    output.say(f"figure: {out / 'margins.png'}")
    put_json(json, done)


def _print(done: "Margins", m: "Measure") -> None:
    """A row per nuisance, the thinnest first; then the three that matter most."""
    from tailbeat.control.measure import centimetres
    from tailbeat.evaluate.advice import ADVICE
    from tailbeat.evaluate.margins import by_safety

    rows = by_safety(done.margins)
    output.tables({"margins: sizes with fewer than 75 % reached": [_row(done, r, m) for r in rows]})
    rate = f"{100 * done.clean.arrived:.0f} and {100 * done.everyday.arrived:.0f} %"
    rate += f" within {centimetres(m.arrival)}"
    output.say(f"reached in the clean pool, and with everything everyday: {rate}")
    for name in done.thinnest:
        output.say(f"{name}: {ADVICE[name]}")


def _row(done: "Margins", row: "Margin", m: "Measure") -> dict[str, Any]:
    """A nuisance: its everyday size, the lab's figure, and the four margins."""
    from tailbeat.control.measure import centimetres

    close, wide = centimetres(m.arrival), centimetres(m.near)
    own = {(one.rest, one.ring): one for one in done.margins if one.nuisance == row.nuisance}
    return {
        "nuisance": row.nuisance,
        "unit": row.unit,
        "everyday": row.everyday,
        "lab": row.lab,
        f"alone, {close}": _size(own["alone", "arrived"]),
        f"alone, {wide}": _size(own["alone", "near"]),
        f"among others, {close}": _size(row),
        f"among others, {wide}": _size(own["everyday", "near"]),
        "safety": f"{row.safety:.1f}" if row.size is not None else f"> {row.safety:.1f}",
    }


def _size(row: "Margin") -> str:
    """A size with its interval."""
    low, high = row.interval
    if row.size is None:
        return f"> {row.most:.3g}"
    end = f"{high:.3g}" if high is not None else f"> {row.most:.3g}"
    return f"{row.size:.3g} ({low:.3g} to {end})"
