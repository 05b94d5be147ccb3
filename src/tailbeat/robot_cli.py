"""The robot's verbs: `key`, `rig`, `drive`, `export`. Parse, call, print."""

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from tailbeat import console, robot_tasks
from tailbeat.files import BadInput, refuse_existing, write_json
from tailbeat.robot.ports import Ports

JsonOption = Annotated[Path | None, typer.Option("--json", help="Write the result here as JSON.")]
FishOption = Annotated[str, typer.Option("--fish", help="The pool's fish: a file or a name.")]
TargetOption = Annotated[str, typer.Option("--target", help="Where the target is: x,y [m].")]
ConsoleOption = Annotated[
    str, typer.Option("--console", help="host:port to show the operator's page at.")
]
SeedOption = Annotated[int, typer.Option("--seed", help="Seed of everything random.")]


def key(path: Annotated[Path, typer.Argument(help="The key file to write.")]) -> None:
    """Write a key that laptop and fish share; copy it to both, readable by its owner alone."""
    robot_tasks.need_extra()
    from tailbeat.link.datagrams import make_key  # needs the extra

    make_key(path)
    console.say(f"wrote {path}; copy it to both machines")


def rig(
    key: Annotated[Path | None, typer.Option("--key", help="The shared key.")] = None,
    robot: Annotated[str, typer.Option("--robot", help="host:port where the loop listens.")] = "",
    camera: Annotated[
        Path | None, typer.Option("--camera", help="Film at this socket; then no poses are sent.")
    ] = None,
    fish: FishOption = "pulley-fish",
    target: TargetOption = robot_tasks.TARGET,
    console_at: ConsoleOption = "",
    seed: SeedOption = 0,
) -> None:
    """An emulated bench in real time: servo and IMU on pseudo-terminals; poses over the network, or
    pictures in which `tailbeat laptop --camera` finds them."""
    say = lambda line: print(line, flush=True)  # noqa: E731
    if camera is not None:
        robot_tasks.filmed_rig(fish, camera, target, seed, say)
    elif key is None or not robot:
        raise BadInput("rig: give --key and --robot for poses, or --camera for pictures.")
    else:
        robot_tasks.rig(fish, key, robot, target, console_at, seed, say)


def drive(
    policy: Annotated[str, typer.Argument(help="A policy, .onnx, or a shipped one's name.")],
    log: Annotated[Path, typer.Option("--log", help="The log to write, .mcap, or a folder.")],
    emulated: Annotated[
        bool, typer.Option("--rig", help="Start an emulated bench and drive that.")
    ] = False,
    servo: Annotated[str, typer.Option(help="The servo's serial port.")] = "",
    imu: Annotated[str, typer.Option(help="The IMU's serial port.")] = "",
    listen: Annotated[str, typer.Option(help="host:port to listen on for poses.")] = "",
    laptop: Annotated[str, typer.Option(help="host:port of the laptop.")] = "",
    key: Annotated[Path | None, typer.Option("--key", help="The shared key.")] = None,
    fish: FishOption = "pulley-fish",
    target: Annotated[
        str | None, typer.Option("--target", help="x,y [m] instead of the target's tag.")
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(help="How long; 30 by default, with orders until Ctrl-C.")
    ] = None,
    wait: Annotated[
        bool, typer.Option("--wait", help="Stay disarmed until ordered; else arm and swim.")
    ] = False,
    console_at: ConsoleOption = "",
    seed: SeedOption = 0,
    json: JsonOption = None,
) -> None:
    """Drive the fish fifty times a second: arm, swim, let go; exit code 1 if it stopped itself."""
    robot_tasks.need_extra()
    log = robot_tasks.log_in(log)
    for path in filter(None, (log, json)):
        refuse_existing(path)
    aim = None if target is None else robot_tasks.place(target)
    stay = wait or bool(console_at)
    if seconds is None:
        seconds = float("inf") if stay else 30.0
    if not seconds > 0:
        raise BadInput(f"--seconds {seconds:g}: give a time above 0.")
    swim = partial(robot_tasks.drive, by_itself=not wait, stay=stay)
    if emulated:
        with robot_tasks.temporary() as folder:
            floats = target or robot_tasks.TARGET
            bench = robot_tasks.own_rig(fish, floats, seed, Path(folder), console_at, console.say)
            aim = None if stay else aim  # the tag floats there; the operator may drag it
            with bench as (ports, secret):
                done = swim(policy, ports, secret, aim, seconds, log, console.say)
    else:
        if not (servo and imu and listen and laptop and key):
            raise BadInput("drive: give --servo, --imu, --listen, --laptop and --key, or --rig.")
        if console_at:
            raise BadInput("--console: the laptop shows it; see `tailbeat laptop --console`.")
        ends = robot_tasks.address(listen, "--listen"), robot_tasks.address(laptop, "--laptop")
        ports = Ports(servo, imu, *ends)
        done = swim(policy, ports, key, aim, seconds, log, console.say)
    console.tables({"drive": [done]})
    if json is not None:
        write_json(json, done)
    by_hand = done.get("swum_s", 1) > 0 and done["ended"] in robot_tasks.BY_HAND
    if done["ended"] != "swimming" and not (stay and by_hand):
        raise typer.Exit(1)


def export(
    log: Annotated[Path, typer.Argument(help="A log of `tailbeat drive`, .mcap.")],
    out: Annotated[Path, typer.Option("--out", help="The recording to write, .csv or .parquet.")],
) -> None:
    """A drive's log as a recording that identification reads; also of a log that was cut off."""
    recording = robot_tasks.export(log, out)
    console.say(f"wrote {out}: {recording.time.size} rows")
