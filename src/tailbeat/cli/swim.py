"""Swim in the virtual pool or with the robot; run the poolside station."""

import sys
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Annotated, Any

import typer

from tailbeat.cli import output, progress, results
from tailbeat.cli.extras import need_camera, need_robot
from tailbeat.cli.options import (
    SHIPPED,
    JsonOption,
    PageOption,
    PoolFish,
    SeedOption,
    TwinOption,
)
from tailbeat.files import BadInput, refuse_existing, write_json
from tailbeat.link.addresses import address
from tailbeat.link.places import TARGET, place
from tailbeat.robot.ports import Ports


def swim(
    fish: Annotated[
        str | None, typer.Option("--fish", help="Beat this fish open-loop instead, no policy.")
    ] = None,
    policy: Annotated[str, typer.Option(help="A policy's file or a shipped one's name.")] = SHIPPED,
    pool_fish: Annotated[str, typer.Option(help="The pool's fish.")] = "pulley-fish",
    twin: TwinOption = None,
    headless: Annotated[
        bool, typer.Option("--headless", help="Swim to drawn targets and end, with a page.")
    ] = False,
    direct: Annotated[
        bool, typer.Option("--direct", help="The same without bytes, faster than real time.")
    ] = False,
    page: Annotated[
        str, typer.Option("--page", help="host:port of the operator's page; a tour takes any.")
    ] = "127.0.0.1:8080",
    targets: Annotated[int, typer.Option(help="Of a tour: how many, one after the other.")] = 8,
    seed: SeedOption = 0,
    out: Annotated[Path, typer.Option(help="Folder for page, film, log, summary.")] = Path("runs"),
    json: JsonOption = None,
) -> None:
    """Swim to targets in the virtual pool, in real time. Fish, camera and station run as on a
    robot. Drag the target on the operator page. With --headless, or without a terminal: a tour of
    drawn targets, then a report; exit code 1 if a target was missed by more than 20 cm."""
    if json is not None:
        refuse_existing(json)
    if fish is not None:
        from tailbeat.fish.store import load_fish
        from tailbeat.report.open_loop import open_loop

        done = open_loop(load_fish(fish), out)
        results.summary(done)
    elif not (headless or direct) and sys.stdout.isatty():
        if json is not None:
            raise BadInput("--json: a swim that you attend has no result; add --headless.")
        _attend(policy, pool_fish, twin, seed, page, out)
        return
    else:
        done = _tour(policy, pool_fish, twin, targets, seed, out, direct)
    if json is not None:
        write_json(json, done)
    if fish is None and done["within_20cm"] < targets:
        raise typer.Exit(1)


def _attend(policy: str, fish: str, twin: str | None, seed: int, page: str, out: Path) -> None:
    """Swim after the target that the operator drags, until Ctrl-C."""
    need_robot()
    need_camera()
    from tailbeat.evaluate.swim import attended

    log = attended(policy, fish, twin, seed, page, out, output.say)
    output.say(f"log: {log}; `tailbeat export {log} --out swim.csv` makes a recording of it")


def _tour(
    policy: str, fish: str, twin: str | None, targets: int, seed: int, out: Path, direct: bool
) -> dict[str, Any]:
    """Swim to drawn targets, draw the page, say what came of it."""
    from tailbeat.evaluate import swim as swims
    from tailbeat.report import tour

    if direct:
        swum = swims.direct(policy, fish, twin, targets, seed, progress.counting)
    else:
        need_robot()
        need_camera()
        swum = swims.live(policy, fish, twin, targets, seed, out, output.say)
    done = tour.write(swum, out, progress.counting)
    output.tables({f"{done['fish']} in the virtual pool, {done['policy']}": done["targets"]})
    output.say(f"{done['within_5cm']} of {targets} within 5 cm; page: {out / 'report.html'}")
    return done


def drive(
    policy: Annotated[str, typer.Argument(help="A policy, .onnx, or a shipped one's name.")],
    log: Annotated[Path, typer.Option("--log", help="The log to write, .mcap, or a folder.")],
    emulated: Annotated[
        bool, typer.Option("--emulated", help="Start an emulated bench and drive that.")
    ] = False,
    servo: Annotated[str, typer.Option(help="The servo's serial port.")] = "",
    imu: Annotated[str, typer.Option(help="The IMU's serial port.")] = "",
    listen: Annotated[str, typer.Option(help="host:port to listen on for poses.")] = "",
    station: Annotated[str, typer.Option(help="host:port of the station.")] = "",
    key: Annotated[Path | None, typer.Option("--key", help="The shared key.")] = None,
    fish: PoolFish = "pulley-fish",
    target: Annotated[
        str | None, typer.Option("--target", help="x,y [m] instead of the target's tag.")
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(help="How long; 30 by default, with orders until Ctrl-C.")
    ] = None,
    wait: Annotated[
        bool, typer.Option("--wait", help="Stay disarmed until ordered; else arm and swim.")
    ] = False,
    page: PageOption = "",
    seed: SeedOption = 0,
    json: JsonOption = None,
) -> None:
    """Drive the fish fifty times a second: arm, swim, turn torque off. Exit code 1 if it stopped
    itself."""
    need_robot()
    from tailbeat.emulators.own_devices import own_devices
    from tailbeat.link.reasons import Reason
    from tailbeat.robot import session
    from tailbeat.robot.results import drive_json

    log = session.log_in(log)
    for path in filter(None, (log, json)):
        refuse_existing(path)
    aim = None if target is None else place(target)
    stay = wait or bool(page)
    if seconds is None:
        seconds = float("inf") if stay else 30.0
    if not seconds > 0:
        raise BadInput(f"--seconds {seconds:g}: give a time above 0.")
    if emulated:
        bench: AbstractContextManager[tuple[Ports, Path]] = own_devices(
            fish, seed, target or TARGET, page, output.say
        )
        aim = None if stay else aim  # the tag floats there; the operator may drag it
    else:
        bench = _given(servo, imu, listen, station, key, page)
    with bench as (ports, secret):
        config = session.DriveConfig(policy, ports, secret, log, aim, seconds, not wait, stay)
        done = session.drive(config, output.say)
    output.tables({"drive": [drive_json(done)]})
    if json is not None:
        write_json(json, drive_json(done))
    if done.reason is not Reason.SWIMMING and not (stay and done.by_hand):
        raise typer.Exit(1)


def _given(
    servo: str, imu: str, listen: str, station: str, key: Path | None, page: str
) -> AbstractContextManager[tuple[Ports, Path]]:
    """The fish's own ports and key, as given."""
    if not (servo and imu and listen and station and key):
        raise BadInput("drive: give --servo, --imu, --listen, --station and --key, or --emulated.")
    if page:
        raise BadInput("--page: the station shows it; see `tailbeat station --page`.")
    ends = address(listen, "--listen"), address(station, "--station")
    return nullcontext((Ports(servo, imu, *ends), key))


def station(
    robot: Annotated[str, typer.Option("--robot", help="host:port where the fish listens.")],
    key: Annotated[Path, typer.Option("--key", help="The shared key.")],
    listen: Annotated[str, typer.Option("--listen", help="host:port of ours, as the fish has it.")],
    page: PageOption = "127.0.0.1:8080",
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
    """Run the poolside station: find the fish, send its pose, show the operator page. Exit code 1
    if a tour was not finished."""
    from tailbeat.operator import station as work

    if json is not None:
        refuse_existing(json)
    there = address(robot, "--robot")
    ours = address(listen, "--listen")
    ids = fish_tag, target_tag
    tour = work.drawn_tour(targets, seed)
    if tour is not None and not camera:
        raise BadInput("--tour: needs the fish's poses; give --camera and its --calibration.")
    aim = None if begin is None else place(begin, "--begin")
    leader = work.Leader(tour, aim) if tour or aim else None
    if camera:
        need_camera()
    with work.open_tracker(camera, calibration, ids, exposure, latency) as tracker:
        work.work(there, ours, key, page, tracker, fish, output.say, leader)
    if json is not None:
        rows = tour.rows if tour else []
        write_json(json, {"targets": rows, "armed_anew": leader.rearmed if leader else 0})
    if tour is not None and tour.target is not None:
        raise typer.Exit(1)
