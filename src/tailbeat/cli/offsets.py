"""Tell from a robot's logs what is constant and wrong."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tailbeat.cli import output
from tailbeat.cli.options import JsonOption
from tailbeat.files import refuse_existing, write_json

if TYPE_CHECKING:
    from tailbeat.identify.offsets import Offset


def offsets(
    logs: Annotated[list[Path], typer.Argument(help="Logs of swims of one robot, .mcap.")],
    json: JsonOption = None,
) -> None:
    """Tell from swims alone what is wrong on a robot: tag, shaft, gyro, current. It must be the
    same in all swims. Three of a minute with turns to both sides tell most of it; what they cannot
    tell is said."""
    if json is not None:
        refuse_existing(json)
    from tailbeat.robot.logged import offsets_of

    done = offsets_of(logs)
    say_swims(done.seconds, [_row(one) for one in done.offsets], done.untold)
    if json is not None:
        write_json(json, done)


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
