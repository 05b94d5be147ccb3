"""Swim in the virtual pool."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tailbeat.cli import output, progress, results
from tailbeat.cli.extras import need_camera, need_robot
from tailbeat.cli.options import (
    FOLLOWS,
    SHIPPED,
    JsonOption,
    MessOption,
    PathLaps,
    PathOption,
    PathSeconds,
    PathSpeed,
    SeedOption,
    TwinOption,
    path_asked,
)
from tailbeat.files import BadInput, check_folder, check_json, put_json

if TYPE_CHECKING:
    from tailbeat.evaluate.following import FollowConfig
    from tailbeat.evaluate.swim import Swum

Asked = tuple[str, str, str | None, int, int, str]  # policy, pool's fish, twin, targets, seed, mess


OwnPage = Annotated[
    str, typer.Option("--page", help="host:port of the operator page; not used by a tour.")
]
SwimPolicy = Annotated[
    str | None,
    typer.Option(
        "--policy",
        help=f"A policy, .onnx, or a shipped name. Default: {FOLLOWS} on a --path and"
        f" on the operator page, {SHIPPED} for a tour.",
    ),
]


def swim(
    fish: Annotated[
        str | None, typer.Option("--fish", help="Swim this fish open-loop, without a policy.")
    ] = None,
    policy: SwimPolicy = None,
    pool_fish: Annotated[
        str, typer.Option(help="Fish in the virtual pool: a TOML file or a shipped fish's name.")
    ] = "pulley-fish",
    twin: TwinOption = None,
    headless: Annotated[
        bool, typer.Option("--headless", help="Swim to random targets, then write a report.")
    ] = False,
    direct: Annotated[
        bool,
        typer.Option(
            "--direct",
            help="As --headless, but faster: simulate in process, without emulated devices.",
        ),
    ] = False,
    page: OwnPage = "127.0.0.1:8080",
    targets: Annotated[int, typer.Option(help="Number of random targets of a tour.")] = 8,
    path: PathOption = None,
    speed: PathSpeed = None,
    laps: PathLaps = None,
    seconds: PathSeconds = None,
    mess: MessOption = "clean",
    seed: SeedOption = 0,
    out: Annotated[Path, typer.Option(help="Folder of the report, film, log and summary.")] = Path(
        "runs"
    ),
    json: JsonOption = None,
) -> None:
    """Swim to targets in the virtual pool, in real time. Fish, camera and station run as on a
    robot. Drag the target on the operator page. With --headless, or without a terminal: a tour of
    random targets, then a report; exit code 1 if a target was missed by more than 20 cm
    (for another fish, in its measure). With --path the target moves by the clock; exit code 1 if
    the fish held, or was more than 60 cm from the target after the first 5 s."""
    check_json(json)
    check_folder(out)
    asked = path_asked(path, speed, laps, seconds)
    if asked is not None and fish is not None:
        raise BadInput("--fish: without a policy it follows no --path; leave --fish out.")
    if mess != "clean" and (asked is not None or fish is not None):
        raise BadInput(f"--mess {mess}: only tours and the page swim in a messy lab; leave it out.")
    if fish is not None:
        _open_loop(fish, out, json)
    elif asked is not None:
        from tailbeat.evaluate.following import FollowConfig

        _follow(FollowConfig(policy or FOLLOWS, asked, pool_fish, twin, seed), direct, out, json)
    elif headless or direct or not sys.stdout.isatty():
        swum = (_direct if direct else _live)(
            (policy or SHIPPED, pool_fish, twin, targets, seed, mess), out
        )
        _tour(swum, out, json)
    elif json is None:
        _attend((policy or FOLLOWS, pool_fish, twin, 1, seed, mess), page, out)
    else:
        raise BadInput("--json: without --headless a swim has no result; add --headless.")


def _open_loop(fish: str, out: Path, json: Path | None) -> None:
    """Swim a fish open-loop; picture, film and summary in `out`."""
    from tailbeat.fish.store import load_fish
    from tailbeat.report.open_loop import open_loop

    done = open_loop(load_fish(fish), out)
    results.open_loop(done)
    put_json(json, done)


def _attend(asked: Asked, page: str, out: Path) -> None:
    """Follow the target that the operator drags, until Ctrl-C. Only a log is written."""
    need_robot()
    need_camera()
    from tailbeat.evaluate.swim import SwimConfig, attended

    log = attended(SwimConfig(*asked), page, out, output.say)
    output.say(f"log: {log}; `tailbeat export {log} --out swim.csv` makes a recording of it")


def _direct(asked: Asked, out: Path) -> "Swum":
    """Swim to random targets in process, faster than real time; writes nothing to `out`."""
    from tailbeat.evaluate import swim as swims

    return swims.direct(swims.SwimConfig(*asked), progress.counting)


def _live(asked: Asked, out: Path) -> "Swum":
    """Swim to random targets in real time, through emulated devices; the logs are in `out`."""
    need_robot()
    need_camera()
    from tailbeat.evaluate import swim as swims

    return swims.live(swims.SwimConfig(*asked), out, output.say)


def _tour(swum: "Swum", out: Path, json: Path | None) -> None:
    """Write a tour's report and print its result; exit code 1 if a target was missed."""
    from tailbeat.control.measure import centimetres
    from tailbeat.report import tour

    done = tour.write(swum, out, progress.counting)
    output.tables({f"{done.fish} in the virtual pool, {done.policy}": tour.rows(done.targets)})
    of = len(done.targets)
    close = centimetres(done.arrival_m)
    output.say(f"{done.arrived} of {of} within {close}; page: {out / 'report.html'}")
    put_json(json, done)
    if done.near < of:
        raise typer.Exit(1)


def _follow(config: "FollowConfig", direct: bool, out: Path, json: Path | None) -> None:
    """Swim after a target by the clock and report; exit code 1 if it was not kept."""
    from tailbeat.evaluate import following as swims
    from tailbeat.report import following as report

    if direct:
        swum = swims.direct(config, progress.counting, output.say)
    else:
        need_robot()
        need_camera()
        swum = swims.live(config, out, output.say)
    done = report.write(swum, out, progress.counting)
    output.tables({f"{done.fish} after a moving target, {done.policy}": [report.row(done.result)]})
    for fault in done.result.faults:
        output.say(fault)
    output.say(f"page: {out / 'report.html'}")
    put_json(json, done)
    if done.result.faults:
        raise typer.Exit(1)
