"""Take a zoo of fish from a first guess to targets in the pool."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tailbeat.cli import output
from tailbeat.cli.extras import need_training
from tailbeat.cli.options import JsonOption, SeedOption
from tailbeat.files import check_json, put_json

if TYPE_CHECKING:
    from tailbeat.evaluate.zoo_run import Outcome

WANTED = 0.95  # of the targets


def zoo(
    out: Annotated[Path, typer.Option("--out", help="Folder of all fish.")],
    only: Annotated[list[int] | None, typer.Option(help="Numbers of fish; default: all.")] = None,
    seed: SeedOption = 0,
    targets: Annotated[int, typer.Option(help="Number of targets of every fish.")] = 100,
    quick: Annotated[
        bool,
        typer.Option("--quick", help="See that every step runs; trains for seconds only."),
    ] = False,
    json: JsonOption = None,
) -> None:
    """Take eight fish of all sizes from a wrong first guess to targets in the pool.

    Each is recorded, identified, trained and evaluated, and swims through emulated devices. A
    hand-made steering rule swims to the same targets. The same command resumes. Exit code 1 if a
    fish missed."""
    check_json(json)
    need_training()
    from tailbeat.evaluate.zoo_run import ZooConfig
    from tailbeat.evaluate.zoo_run import zoo as take

    config = ZooConfig(out, seed, tuple(only) if only else None, targets, quick)
    found = take(config, output.say)
    output.tables({f"zoo, seed {seed}": [_row(one) for one in found]})
    put_json(json, {"fish": found})
    if any(one.reached is None or one.reached < WANTED for one in found):
        raise typer.Exit(1)


def _row(one: "Outcome") -> dict[str, Any]:
    from tailbeat.evaluate.zoo_run import TOUR

    minutes = {f"{name} [min]": step.seconds / 60 for name, step in one.steps.items()}
    last = list(one.steps.values())[-1]
    return {
        "fish": one.name,
        "mass [kg]": one.mass,
        "hinges": one.hinges,
        "servo": one.servo,
        "decided": one.decided,
        "in their intervals": one.held,
        "identify [min]": minutes.get("identify [min]"),
        "train [min]": minutes.get("train [min]"),
        "stages": one.stages,
        "updates": one.updates,
        "reached [%]": None if one.reached is None else 100 * one.reached,
        "lost": one.lost,
        "by the rule [%]": None if one.ruled is None else 100 * one.ruled,
        "through camera and servo": None if one.toured is None else f"{one.toured} of {TOUR}",
        "within [cm]": None if one.arrival_m is None else 100 * one.arrival_m,
        "said": "" if last.code == 0 else last.said,
    }
