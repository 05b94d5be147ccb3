"""Run the poolside station."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tailbeat.cli import output
from tailbeat.cli.extras import need_camera
from tailbeat.cli.options import (
    DrawnFish,
    PageOption,
    PathLaps,
    PathOption,
    PathSeconds,
    PathSpeed,
    ReplayOption,
    ReplayPool,
    TourBegin,
    TourJson,
    TourPolicy,
    path_asked,
)
from tailbeat.files import BadInput, check_json, need, put_json, write_json
from tailbeat.link.addresses import address
from tailbeat.link.places import LENGTH, WIDTH, pool_size

if TYPE_CHECKING:
    from tailbeat.operator.leader import Leader


def station(
    robot: Annotated[str, typer.Option("--robot", help="host:port where the fish listens.")] = "",
    key: Annotated[Path | None, typer.Option("--key", help="File of the shared key.")] = None,
    listen: Annotated[
        str, typer.Option("--listen", help="host:port on which to listen to the fish.")
    ] = "",
    page: PageOption = "127.0.0.1:8080",
    camera: Annotated[
        str, typer.Option("--camera", help="Camera: /dev/video0 or unix:/path.")
    ] = "",
    calibration: Annotated[
        Path | None, typer.Option("--calibration", help="Calibration made by `tailbeat calibrate`.")
    ] = None,
    fish_tag: Annotated[int, typer.Option(help="Id of the fish's tag (family 36h11).")] = 0,
    target_tag: Annotated[int, typer.Option(help="Id of the target's tag.")] = 1,
    exposure: Annotated[float, typer.Option(help="Exposure time of the camera [s].")] = 0.002,
    latency: Annotated[
        float, typer.Option(help="Time from the end of the exposure to the time stamp [s].")
    ] = 0.0,
    fish: DrawnFish = None,
    targets: Annotated[
        int, typer.Option("--tour", help="Number of random targets to lead the fish to.")
    ] = 0,
    begin: TourBegin = None,
    path: PathOption = None,
    speed: PathSpeed = None,
    laps: PathLaps = None,
    seconds: PathSeconds = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Seed of the random targets.")] = 0,
    policy: TourPolicy = None,
    json: TourJson = None,
    replay: ReplayOption = None,
    pool: ReplayPool = f"{LENGTH:g},{WIDTH:g}",
) -> None:
    """Run the poolside station: find the fish, send its pose, show the operator page. Exit code 1
    if a tour or a --path was not finished. With --replay: play a finished run from its log on the
    page."""
    given = {"--robot": robot, "--key": key, "--listen": listen, "--camera": camera,
             "--tour": targets, "--begin": begin, "--path": path, "--json": json}  # fmt: skip
    if replay is not None:
        return _replay(replay, page, fish, pool, [name for name, value in given.items() if value])
    if key is None or not (robot and listen):
        raise BadInput("station: give --robot, --key and --listen, or a log to --replay.")
    from tailbeat.control.policy import measure_in
    from tailbeat.fish.store import PAPER
    from tailbeat.operator import station as work
    from tailbeat.operator.leader import chosen_leader

    check_json(json)
    ends = address(robot, "--robot"), address(listen, "--listen")
    asked = path_asked(path, speed, laps, seconds)
    _check_camera(camera, {"--tour": targets, "--path": path})
    eye = camera, calibration, (fish_tag, target_tag), exposure, latency
    with work.open_tracker(*eye) as tracker:
        room = work.pool_of(tracker, lambda _: None)
        leader = chosen_leader(targets, seed, begin, room, measure_in(policy), asked)
        work.work(work.StationConfig(*ends, key, page, fish or PAPER), tracker, leader, output.say)
    _end_of_tour(leader, json)


def _check_camera(camera: str, leads: dict[str, object]) -> None:
    """Raises BadInput if one of the options that lead the fish is given without a camera, or if its
    packages are not installed."""
    for option, wanted in leads.items():
        if wanted and not camera:
            raise BadInput(f"{option}: needs the fish's poses; give --camera and --calibration.")
    if camera:
        need_camera()


def _end_of_tour(leader: "Leader | None", json: Path | None) -> None:
    """Write what came of a tour or a path; exit code 1 if it was not finished."""
    tour, follow = (leader.tour, leader.follow) if leader else (None, None)
    if follow is not None:
        record = follow.record()
        put_json(json, record)
        if not record.finished:
            raise typer.Exit(1)
    elif json is not None:
        rows = tour.rows if tour else []
        write_json(json, {"targets": rows, "armed_anew": leader.rearmed if leader else 0})
    if tour is not None and tour.target is not None:
        raise typer.Exit(1)


def _replay(log: Path, page: str, fish: str | None, pool: str, given: list[str]) -> None:
    """Serve the operator page with a log behind it; `given` are options that need a fish."""
    if given:
        raise BadInput(f"{given[0]}: a replay has no fish and no camera; leave it out.")
    need("a replay", "mcap", "fastapi", "uvicorn", "websockets")
    from tailbeat.operator.replay_server import ReplayConfig, replay

    replay(ReplayConfig(log, page, fish, pool_size(pool)), output.say)
