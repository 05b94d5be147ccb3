"""Correct a policy from the logs of its own swims."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tailbeat.cli import output
from tailbeat.cli.extras import need_training
from tailbeat.cli.offsets import say_swims
from tailbeat.cli.options import JsonOption, PolicyFile
from tailbeat.files import refuse_existing, write_json

if TYPE_CHECKING:
    from tailbeat.train.refine import Change


def refine(
    policy: PolicyFile,
    logs: Annotated[
        list[Path], typer.Option("--log", help="Logs of its swims on one robot, .mcap.")
    ],
    out: Annotated[Path, typer.Option("--out", help="Folder of the corrected policy.")],
    json: JsonOption = None,
) -> None:
    """Correct a policy by what its robot's swims show to be constant and wrong. These are the
    tag, the shaft and the gyro. The network stays; the new file corrects readings and setpoints, on
    this robot alone. Of what the swims do not tell well, a part is corrected, and said."""
    if json is not None:
        refuse_existing(json)
    need_training()
    from tailbeat.train.refine import refine as make

    done = make(policy, logs, out)
    say_swims(done.seconds, [_row(one) for one in done.changes], done.untold)
    output.say(f"policy for this robot alone: {done.policy}")
    if json is not None:
        write_json(json, done)


def _row(one: "Change") -> dict[str, Any]:
    low, high = one.interval
    return {
        "what": one.name,
        "unit": one.unit,
        "before": f"{one.before:.2g}",
        "now": f"{one.after:.2g}",
        "swims' 95 %": f"{low:.2g} to {high:.2g}",
        "why": one.why,
    }
