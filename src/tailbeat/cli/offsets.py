"""Tell from a robot's logs what is constant and wrong, and how it is built."""

from collections.abc import Sequence
from dataclasses import asdict
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tailbeat.cli import output, progress
from tailbeat.cli.options import FishOption, JsonOption
from tailbeat.files import check_json, put_json

if TYPE_CHECKING:
    from tailbeat.identify.offsets import Offset
    from tailbeat.robot.refit import Refitted


def offsets(
    logs: Annotated[list[Path], typer.Argument(help="Logs of swims of one robot, .mcap.")],
    json: JsonOption = None,
) -> None:
    """Tell from swims alone what is wrong on a robot: tag, shaft, gyro, current. It must be the
    same in all swims. Three of a minute with turns to both sides tell most of it; what they cannot
    tell is said."""
    check_json(json)
    from tailbeat.robot.logged import offsets_of

    done = offsets_of(logs)
    output.warn(done.damage)
    say_swims(done.seconds, [_row(one) for one in done.offsets], done.untold)
    rows = [{**asdict(one), "told": one.told} for one in done.offsets]
    put_json(json, {**asdict(done), "offsets": rows})


def identify_logs(
    logs: Annotated[list[Path], typer.Argument(help="Logs of swims of one robot, .mcap.")],
    fish: FishOption,
    out: Annotated[Path, typer.Option("--out", help="Fish to write, .toml.")],
    policy: Annotated[
        str | None,
        typer.Option(help="Refined policy, whose corrections free the logs; default: none."),
    ] = None,
) -> None:
    """Fit servo, tail and water of a fish to logged swims of one robot. Writes the fish and, beside
    it, a report (.json). Numbers that the swims do not tell are marked: do not rely on them. Exit
    code 1 if the new twin is no better in pieces that were not fitted."""
    from tailbeat.control.policy import load_policy
    from tailbeat.fish.store import load_fish
    from tailbeat.robot.refit import refit

    known = None if policy is None else load_policy(policy).contract.corrections
    with progress.counting() as told:
        done = refit(fish, load_fish(fish), logs, out, known, told)
    output.warn(done.damage)
    say_built(done)
    if not done.built.better:
        raise typer.Exit(1)


def say_built(done: "Refitted") -> None:
    """Print how a robot is built, by its swims, and how much nearer the new twin is."""
    built = done.built
    old, new = built.described, built.refitted
    if not built.better:
        output.say("not to be trusted: in pieces that were not fitted it is no better.")
    rows = [
        {
            "what": one.name,
            "unit": "times the fish's" if one.unit == "1" else one.unit,
            "value": f"{one.value:.3g}",
            "95 %": f"{one.interval[0]:.3g} to {one.interval[1]:.3g}",
            "told by the swims": "yes" if one.told else "cannot tell",
        }
        for one in built.numbers
    ]
    output.tables({f"{built.fitted} pieces of swims": rows})
    output.say(
        f"in {built.held_out} pieces that were not fitted the shaft errs by"
        f" {degrees(new.shaft):.2f} deg instead of {degrees(old.shaft):.2f}, the place by"
        f" {1e3 * new.place:.0f} mm instead of {1e3 * old.place:.0f}, as the fish was described"
    )
    output.say(f"refitted fish: {done.fish}")


def say_swims(seconds: float, rows: list[dict[str, Any]], untold: Sequence[str]) -> None:
    """Print what so many seconds of swimming tell, and what no swim alone tells."""
    output.tables({f"{seconds:.0f} s of swimming": rows})
    for sentence in untold:
        output.say(f"not told by swims alone: {sentence}")


def _row(one: "Offset") -> dict[str, Any]:
    low, high = one.interval
    return {
        "what": one.name,
        "unit": one.unit,
        "value": f"{one.value:.2g}" if one.told else "cannot tell",
        "95 %": f"{low:.2g} to {high:.2g}",
        "meaning": one.what,
    }
