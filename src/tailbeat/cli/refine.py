"""Correct a policy from the logs of its own swims, and train it again."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from tailbeat.cli import output, progress
from tailbeat.cli.extras import need_training
from tailbeat.cli.learn import expect_or_say
from tailbeat.cli.offsets import say_built, say_swims
from tailbeat.cli.options import JsonOption, PolicyFile
from tailbeat.cli.training import StartOption
from tailbeat.files import BadInput, check_json, put_json

if TYPE_CHECKING:
    from tailbeat.robot.refit import Refitted
    from tailbeat.train.again import Again
    from tailbeat.train.config import RunConfig
    from tailbeat.train.refine import Change


OWN = ("policy.onnx", "refined.json", "retrained.onnx", "train")  # in its folder


def _folder(text: str) -> Path:
    """The folder of --out: an empty name would be the current folder."""
    if not text.strip():
        raise typer.BadParameter("the name is empty; give a folder.")
    return Path(text)


def refine(
    policy: PolicyFile,
    logs: Annotated[
        list[Path], typer.Option("--log", help="Logs of its swims on one robot, .mcap.")
    ],
    out: Annotated[
        Path, typer.Option("--out", parser=_folder, help="Folder of the corrected policy.")
    ],
    retrain: Annotated[
        bool, typer.Option(help="Also refit the twin to the logs, and train again in it.")
    ] = False,
    fish: Annotated[
        str | None,
        typer.Option(help="With --retrain: the fish it was trained on, a TOML file or a name."),
    ] = None,
    start: StartOption = None,
    hours: Annotated[
        float | None,
        typer.Option(help="With --retrain: longest training time [h]; default: 0.5."),
    ] = None,
    json: JsonOption = None,
) -> None:
    """Correct a policy by what its robot's swims show to be constant and wrong. These are the
    tag, the shaft and the gyro. The network stays; the new file corrects readings and setpoints, on
    this robot alone. Of what the swims do not tell well, a part is corrected, and said. With
    --retrain a second policy is trained in a twin that is refitted to the logs. Exit code 1 if that
    one is no better."""
    check_json(json, out, *OWN)
    if (fish is None) == retrain or (not retrain and (start, hours) != (None, None)):
        raise BadInput("--retrain and --fish go together, and --start and --hours only with them.")
    need_training()
    from tailbeat.train.again import AgainConfig, planned
    from tailbeat.train.refine import refine as make

    plan = None
    if fish is not None:
        asked = AgainConfig(fish, out, start, 0.5 if hours is None else hours)
        plan = fish, planned(policy, logs, asked)
        twin = f"{plan[1].fish.name}-refitted"
        check_json(json, out, f"{twin}.toml", f"{twin}.json")
    done = make(policy, logs, out)
    output.warn(done.damage)
    say_swims(done.seconds, [_row(one) for one in done.changes], done.untold)
    output.say(f"policy for this robot alone: {done.policy}")
    more: dict[str, Any] = {}
    if plan is not None:
        more["refitted"], more["retrained"] = _retrained(done.policy, logs, *plan)
    put_json(json, asdict(done) | more)
    if plan is not None and not (more["retrained"] and more["retrained"].better):
        raise typer.Exit(1)


def _retrained(
    policy: str, logs: list[Path], fish: str, run: "RunConfig"
) -> "tuple[Refitted, Again | None]":
    """Refit the twin and train in it; no training where the new twin is no better."""
    from tailbeat.control.policy import load_policy
    from tailbeat.train.again import refitted, train_again

    parent = load_policy(policy)
    with progress.counting() as told:
        found, run = refitted(parent, run, logs, fish, told)
    say_built(found)
    if not found.built.better:
        output.say("nothing was trained.")
        return found, None
    with progress.training() as report:
        trained = train_again(parent, run, report)
    _say_trained(trained, run.recipe.name)
    return found, trained


def _say_trained(trained: "Again", recipe: str) -> None:
    rows = [
        {"policy": name, "reached [%]": 100 * one.reached, "median time [s]": one.median_seconds}
        for name, one in (("as corrected", trained.before), ("trained again", trained.after))
    ]
    output.tables({"in the refitted twin, same targets": rows})
    expect_or_say(trained.policy, recipe)
    keep = "drive with it" if trained.better else "it is no better: keep the corrected one"
    output.say(f"trained again: {trained.policy}; {keep}")


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
