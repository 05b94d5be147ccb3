"""The laptop's verb: `laptop`. Parse, call, print."""

from pathlib import Path
from typing import Annotated

import typer

from tailbeat import console, laptop_tasks, robot_tasks
from tailbeat.files import BadInput, refuse_existing, write_json


def laptop(
    robot: Annotated[str, typer.Option("--robot", help="host:port where the fish listens.")],
    key: Annotated[Path, typer.Option("--key", help="The shared key.")],
    listen: Annotated[str, typer.Option("--listen", help="host:port of ours, as the fish has it.")],
    console_at: Annotated[
        str, typer.Option("--console", help="host:port to show the operator's page at.")
    ] = "127.0.0.1:8080",
    camera: Annotated[
        str, typer.Option("--camera", help="Where pictures come from: /dev/video0, unix:/path.")
    ] = "",
    calibration: Annotated[
        Path | None, typer.Option("--calibration", help="A file of `tailbeat calibrate`.")
    ] = None,
    fish_tag: Annotated[int, typer.Option(help="Id of the fish's tag, 36h11.")] = 0,
    target_tag: Annotated[int, typer.Option(help="Id of the target's tag.")] = 1,
    exposure: Annotated[float, typer.Option(help="Of the camera [s].")] = 0.002,
    latency: Annotated[
        float, typer.Option(help="From the exposure's end to the frame's stamp [s].")
    ] = 0.0,
    fish: Annotated[
        str, typer.Option("--fish", help="The fish as drawn: a file or a name.")
    ] = "pulley-fish",
    targets: Annotated[
        int, typer.Option("--tour", help="Lead the fish to so many drawn targets, then stop it.")
    ] = 0,
    begin: Annotated[
        str | None,
        typer.Option("--begin", help="Arm the fish once; x,y [m] of a target to drag from there."),
    ] = None,
    seed: Annotated[int, typer.Option("--seed", help="Seed of those targets.")] = 0,
    json: Annotated[
        Path | None, typer.Option("--json", help="Write what became of the tour here as JSON.")
    ] = None,
) -> None:
    """Stand above the pool: find the fish, send its pose, and show the operator's page."""
    robot_tasks.need_extra()
    if json is not None:
        refuse_existing(json)
    there = robot_tasks.address(robot, "--robot")
    ours = robot_tasks.address(listen, "--listen")
    ids = fish_tag, target_tag
    tour = laptop_tasks.drawn_tour(targets, seed)
    if tour is not None and not camera:
        raise BadInput("--tour: needs the fish's poses; give --camera and its --calibration.")
    aim = None if begin is None else robot_tasks.place(begin, "--begin")
    leader = laptop_tasks.Leader(tour, aim) if tour or aim else None
    with laptop_tasks.open_tracker(camera, calibration, ids, exposure, latency) as tracker:
        laptop_tasks.laptop(there, ours, key, console_at, tracker, fish, console.say, leader)
    if json is not None:
        rows = tour.rows if tour else []
        write_json(json, {"targets": rows, "armed_anew": leader.rearmed if leader else 0})
    if tour is not None and tour.target is not None:
        raise typer.Exit(1)
