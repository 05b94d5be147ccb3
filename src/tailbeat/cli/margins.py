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
from tailbeat.files import need, refuse_existing, write_json

if TYPE_CHECKING:
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
    targets: Annotated[int, typer.Option(help="Most targets of a cell, 16 or more.")] = 40,
    address: AddressOption = None,
    seed: SeedOption = 0,
    json: JsonOption = None,
) -> None:
    """Measure how much of each thing that labs get wrong a policy stands. For every nuisance of
    the messy pool, alone and with all others at their everyday sizes: the size at which it reaches
    fewer than three quarters of its targets. The same command resumes an interrupted run."""
    if json is not None:
        refuse_existing(json)
    if address is not None:
        need("a cluster", "ray")
    from tailbeat.cluster.margins import margins_on
    from tailbeat.control.policy import load_policy
    from tailbeat.evaluate.margins import MarginsConfig
    from tailbeat.evaluate.margins import margins as measure
    from tailbeat.report.margins import margins_figure

    config = MarginsConfig(fish, twin, targets, tuple(nuisance or ()), seed)
    with progress.counting() as count:
        if address is None:
            done = measure(load_policy(policy), config, out, count)
        else:
            done = margins_on(address, policy, config, out, count)
    margins_figure(done, out / "margins.png", overwrite=True)
    _print(done)
    output.say(f"figure: {out / 'margins.png'}")
    if json is not None:
        write_json(json, done)


def _print(done: "Margins") -> None:
    """A row per nuisance, the thinnest first; then the three that matter most."""
    from tailbeat.evaluate.advice import ADVICE
    from tailbeat.evaluate.margins import by_safety

    rows = by_safety(done.margins)
    output.tables({"margins: sizes with fewer than 75 % reached": [_row(done, r) for r in rows]})
    rate = f"{100 * done.clean.arrived:.0f} and {100 * done.everyday.arrived:.0f} %"
    output.say(f"reached in the clean pool, and with everything everyday: {rate} at 5 cm")
    for name in done.thinnest:
        output.say(f"{name}: {ADVICE[name]}")


def _row(done: "Margins", row: "Margin") -> dict[str, Any]:
    """A nuisance: its everyday size, the lab's figure, and the four margins."""
    own = {(one.rest, one.ring): one for one in done.margins if one.nuisance == row.nuisance}
    return {
        "nuisance": row.nuisance,
        "unit": row.unit,
        "everyday": row.everyday,
        "lab": row.lab,
        "alone, 5 cm": _size(own["alone", "arrived"]),
        "alone, 20 cm": _size(own["alone", "near"]),
        "among others, 5 cm": _size(row),
        "among others, 20 cm": _size(own["everyday", "near"]),
        "safety": f"{row.safety:.1f}" if row.size is not None else f"> {row.safety:.1f}",
    }


def _size(row: "Margin") -> str:
    """A size with its interval."""
    low, high = row.interval
    if row.size is None:
        return f"> {row.most:.3g}"
    end = f"{high:.3g}" if high is not None else f"> {row.most:.3g}"
    return f"{row.size:.3g} ({low:.3g} to {end})"
