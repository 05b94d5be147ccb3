"""Measure what a fish can do at all, without a policy."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tailbeat.cli import output, progress
from tailbeat.cli.options import JsonOption, PoolFish, SeedOption
from tailbeat.files import put_json, refuse_existing, write_json
from tailbeat.report.tables import as_cell, as_rows

if TYPE_CHECKING:
    from tailbeat.evaluate.limit_rows import Spread
    from tailbeat.evaluate.limits import SwimLimits

FIGURE, NUMBERS = "limits.png", "limits.json"  # in the folder --out


def limits(
    fish: PoolFish = "pulley-fish",
    twin: Annotated[
        str | None,
        typer.Option("--twin", help="Fish whose twin swims the same commands beside the pool."),
    ] = None,
    waters: Annotated[
        int, typer.Option(help="Number of waters, 1 to 100; the first is the default.")
    ] = 4,
    grid: Annotated[str, typer.Option(help="Commands: full, or coarse for a first look.")] = "full",
    out: Annotated[
        Path | None, typer.Option("--out", help=f"Folder for {FIGURE} and {NUMBERS}.")
    ] = None,
    seed: SeedOption = 0,
    json: JsonOption = None,
) -> None:
    """Measure how slowly and tightly a fish can be steered, and how it stops. It swims in the
    virtual pool under constant commands of the generator, without a policy. The last table says
    which closed paths any policy can be asked to follow at a fixed speed."""
    files = [] if out is None else [out / FIGURE, out / NUMBERS]
    for path in filter(None, (*files, json)):
        refuse_existing(path)
    from tailbeat.evaluate.limits import LimitsConfig, limits_of

    with progress.counting() as count:
        found = limits_of(LimitsConfig(fish, twin, waters, grid, seed), count)
    put_json(json, found)
    if out is not None:
        _files(found, out)
    output.tables(_tables(found))
    if out is not None:
        output.say(f"written: {', '.join(map(str, files))}")


def _files(found: "SwimLimits", out: Path) -> None:
    from tailbeat.report.limits_figures import limits_figure

    write_json(out / NUMBERS, found)
    limits_figure(found, out / FIGURE)


def _tables(found: "SwimLimits") -> dict[str, list[dict[str, Any]]]:
    """The tables by title. A spread is the default water's number and the range over all."""
    where = f"waters: {found.waters} ({found.water})"
    steers = f"circle of at most {found.radius:.3g} m, at {found.rate:.2g} rad/s or faster"
    return {
        f"slowest swims [m/s], {where}; steerable: {steers}": [
            {"swims": f"{row.where}, {row.beats}",
             **_row(row, "where", "beats", circle="circle [m]", frequency="f [Hz]",
                    amplitude="stroke [rad]", centre="centre [rad]", in_turn="in the turn",
                    straight="not steered")}
            for row in found.slowest
        ],
        "tightest circle [m] by speed [m/s]": [
            _row(row, above="speed from", below="to", band="in the band", all="all beats")
            for row in found.circles
        ],
        "stops: until a tenth of the speed": [
            _row(row, start="start [m/s]", distance="distance [m]", seconds="time [s]")
            for row in found.stops
        ],
        "burst and rest": [
            _row(row, burst="burst [s]", rest="rest [s]", straight="speed [m/s]",
                 circle="circle [m]", in_turn="speed in it [m/s]")
            for row in found.bursts
        ],
        "closed paths: in how many waters they may be asked of any policy": [
            _row(row, radius="radius [m]", speed="speed [m/s]", slowest="slowest so tight [m/s]",
                 tightest="tightest so slow [m]", bursts="+ bursts")
            for row in found.paths
        ],
    }  # fmt: skip


def _row(record: Any, *left_out: str, **heads: str) -> dict[str, Any]:
    """A record as a row under these heads, by default its fields' names."""
    (row,) = as_rows([record], *left_out)
    return {heads.get(name, name): _cell(value) for name, value in row.items()}


def _cell(value: Any) -> Any:
    return _spread(value) if hasattr(value, "default") else value


def _spread(one: "Spread") -> str:
    """`0.1` of one water, `0.1 (0.09 … 0.12)` of several, a dash where there is none."""
    from math import isfinite

    default, low, high = (as_cell(v if isfinite(v) else None, 3) for v in vars(one).values())
    return default if low == high == default else f"{default} ({low} … {high})"
