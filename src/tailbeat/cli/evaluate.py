"""Evaluate and compare policies, map speeds, write the page."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tailbeat.cli import output, progress, results
from tailbeat.cli.options import (
    AddressOption,
    FishOption,
    JsonOption,
    PolicyFile,
    PoolFish,
    SeedOption,
    TwinOption,
)
from tailbeat.evaluate.names import NAMES
from tailbeat.files import BadInput, check_json, need, put_json, refuse_existing
from tailbeat.link.places import LARGEST, SMALLEST, is_pool
from tailbeat.report.tables import as_rows

if TYPE_CHECKING:
    from tailbeat.evaluate.comparison import Comparison
    from tailbeat.evaluate.evaluation import Evaluation

# What an evaluation, and the page of any folder, writes into its folder.
SWUM = ("run.json", "trained-on.json", "runs", "twin", "identification.json", "evaluation.json")
PAGE = ("report.html", "report.json", "figures")


def evaluate(
    policy: PolicyFile,
    out: Annotated[
        Path, typer.Option("--out", help="Folder of the runs; an existing one is continued.")
    ],
    fish: PoolFish = "pulley-fish",
    twin: TwinOption = None,
    pool: Annotated[
        str, typer.Option(help="Water: ensemble, full, no lag, no stall or no added inertia.")
    ] = "ensemble",
    task: Annotated[
        list[str] | None, typer.Option("--tasks", help=f"Tasks: {', '.join(NAMES)}; default: all.")
    ] = None,
    episodes: Annotated[
        int, typer.Option(help="Number of swims under each condition of a task.")
    ] = 250,
    walls: Annotated[
        str | None,
        typer.Option(
            help="Size of the pool in trials with walls: length x width [m]; default: the paper's"
            " 5.5x2.7, in the fish's measure."
        ),
    ] = None,
    mess: Annotated[
        str,
        typer.Option(
            help="What the lab of every swim of the task track gets wrong: clean, everyday, rough"
            " or wrecked, or a TOML file with a table [lab]. The task messy swims in this lab too."
        ),
    ] = "clean",
    address: AddressOption = None,
    seed: SeedOption = 0,
    json: JsonOption = None,
) -> None:
    """Evaluate a policy in the virtual pool: targets, disturbances, tracks, messy labs. The same
    command resumes an interrupted evaluation."""
    check_json(json, out, *SWUM, *PAGE)
    if address is not None:
        need("a cluster", "ray")
    from tailbeat.cluster.evaluation import evaluate_on
    from tailbeat.control.policy import load_policy
    from tailbeat.evaluate.evaluation import EvaluationConfig
    from tailbeat.evaluate.evaluation import evaluate as swim_all

    tasks = tuple(task or NAMES)
    config = EvaluationConfig(fish, twin, pool, tasks, episodes, _walls(walls), seed, mess)
    with progress.counting() as count:
        if address is None:
            done = swim_all(load_policy(policy), config, out, count)
        else:
            done = evaluate_on(address, policy, config, out, count)
    results.evaluated(done)
    _page(out, fish, twin, done, json)


def _walls(text: str | None) -> tuple[float, float] | None:
    """`length x width` in metres."""
    if text is None:
        return None
    try:
        length, width = map(float, text.split("x"))
    except ValueError:
        raise BadInput(f"--walls {text!r}: give length x width in metres, as 5.5x2.7.") from None
    if not is_pool(length, width):
        raise BadInput(f"--walls {text}: each side must be {SMALLEST:g} to {LARGEST:g} m.")
    return length, width


def compare(
    policies: Annotated[list[str], typer.Argument(help="Policies of several kinds and seeds.")],
    out: Annotated[
        Path,
        typer.Option(
            "--out",
            help="Folder of the cells (a policy in one water each); an existing one is continued.",
        ),
    ],
    fish: PoolFish = "pulley-fish",
    twin: TwinOption = None,
    targets: Annotated[int, typer.Option(help="Number of targets in each cell.")] = 100,
    only: Annotated[
        list[str] | None,
        typer.Option(help="Conditions to swim, such as twin or 'rough labs'; default: all."),
    ] = None,
    address: AddressOption = None,
    seed: SeedOption = 0,
    json: JsonOption = None,
) -> None:
    """Compare policies in their twins and in the pool, with parts of its physics off. Each core
    swims a cell. The same command resumes an interrupted comparison."""
    check_json(json, out, "cells", "comparison.json", *PAGE)
    if address is not None:
        need("a cluster", "ray")
    from tailbeat.cluster.comparison import compare as swim_cells
    from tailbeat.evaluate.compare import ComparisonConfig

    config = ComparisonConfig(tuple(policies), fish, twin, targets, seed, tuple(only or ()))
    with progress.counting() as count:
        done = swim_cells(config, out, count, address)
    results.compared(done)
    _page(out, fish, twin, done, json)


def speed_map(
    fish: FishOption,
    out: Annotated[Path, typer.Option("--out", help="Figure to write, .png.")],
    servo: Annotated[
        list[str] | None, typer.Option(help="Servos of the fish to map; default: its own.")
    ] = None,
    json: JsonOption = None,
) -> None:
    """Compare the speeds of twin and virtual pool over frequency and stroke. The map reaches far
    beyond the identified band."""
    from tailbeat.evaluate.speed_map import speed_map_of
    from tailbeat.report import figures
    from tailbeat.report.pictures import check_picture

    check_picture(out)
    for path in filter(None, (out, json)):
        refuse_existing(path)
    report = speed_map_of(fish, servo or [])
    figures.speed_map(report, out)
    put_json(json, report)
    output.tables({f"speed [m/s], water {report.water}": as_rows(report.rows)})


def report(
    folder: Annotated[Path, typer.Argument(help="Folder of an evaluation or a comparison.")],
    fish: PoolFish = "pulley-fish",
    twin: TwinOption = None,
    json: JsonOption = None,
) -> None:
    """Write a page of a folder's numbers and figures, with the paper's for comparison."""
    check_json(json, folder, *PAGE)
    from tailbeat.report.page import of_folder

    path, data = of_folder(folder, fish, twin)
    output.say(f"page: {path}")
    put_json(json, data)


def _page(
    out: Path, fish: str, twin: str | None, done: "Evaluation | Comparison", json: Path | None
) -> None:
    """Write the page of these numbers, and the numbers to `json` if it is given."""
    from tailbeat.report.page import of_folder

    path, _ = of_folder(out, fish, twin, done)
    output.say(f"page: {path}")
    put_json(json, done)
