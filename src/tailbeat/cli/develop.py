"""Emulate devices and a camera, measure speed."""

from pathlib import Path
from typing import Annotated

import typer

from tailbeat.cli import output, results
from tailbeat.cli.extras import need_camera, need_robot, need_training
from tailbeat.cli.options import (
    JsonOption,
    MessOption,
    PageOption,
    PoolFish,
    PoolOption,
    SeedOption,
    TargetOption,
)
from tailbeat.files import BadInput, check_json, need, put_json
from tailbeat.link.places import LENGTH, TARGET, WIDTH, pool_size, within


def emulate(
    key: Annotated[Path | None, typer.Option("--key", help="File of the shared key.")] = None,
    robot: Annotated[
        str, typer.Option("--robot", help="host:port on which the loop listens.")
    ] = "",
    camera: Annotated[
        Path | None,
        typer.Option("--camera", help="Socket to create: send pictures instead of poses."),
    ] = None,
    fish: PoolFish = "pulley-fish",
    target: TargetOption = "",
    start: Annotated[
        str,
        typer.Option(
            "--start",
            help="Start of the fish's tag: x,y,heading [m, m, deg]. Default: the pool's middle.",
        ),
    ] = "",
    imu: Annotated[str, typer.Option("--imu", help="IMU: bno055 or bno085.")] = "bno055",
    pool: PoolOption = f"{LENGTH:g},{WIDTH:g}",
    page: PageOption = "",
    mess: MessOption = "clean",
    seed: SeedOption = 0,
) -> None:
    """Emulate servo, IMU and camera of a fish in real time. Servo and IMU are on pseudo-terminals.
    Poses are sent over the network, or `tailbeat station --camera` finds them in pictures. Pictures
    are true: a messy lab's scale, rotation and lens are errors of its calibration."""
    if camera is None and (key is None or not robot):
        raise BadInput("emulate: give --key and --robot for poses, or --camera for pictures.")
    if camera is not None and (key or robot or page):
        raise BadInput("emulate: --camera sends pictures; leave --key, --robot and --page out.")
    need_robot()
    from tailbeat.emulators import serve

    say = lambda line: print(line, flush=True)  # noqa: E731
    room = pool_size(pool)
    aim = target or within(TARGET, room)
    devices = serve.Emulated(fish, aim, seed, imu, start, mess, room)
    if camera is not None:
        serve.filmed_rig(devices, camera, say)
    elif key is not None:
        serve.rig(devices, key, robot, page, say)


def camera(
    socket: Annotated[Path | None, typer.Option(help="Socket to create: frames of a swim.")] = None,
    pictures: Annotated[
        Path | None,
        typer.Option(help="Folder to create: the pictures that `tailbeat calibrate` needs."),
    ] = None,
    fish: Annotated[
        str, typer.Option("--fish", help="A TOML file or a shipped fish's name.")
    ] = "pulley-fish",
    pool: PoolOption = f"{LENGTH:g},{WIDTH:g}",
    seconds: Annotated[float, typer.Option(help="Duration [s]; 0: until Ctrl-C.")] = 0.0,
    count: Annotated[int, typer.Option(help="Number of views of the board.")] = 20,
    seed: SeedOption = 0,
) -> None:
    """Emulate a camera above the pool: frames at a socket, or pictures to calibrate with."""
    if (socket is None) == (pictures is None):
        raise BadInput("camera: give either --socket or --pictures.")
    need_camera()
    from tailbeat.emulators import lab, scripted
    from tailbeat.emulators.film import filming_of
    from tailbeat.fish.store import load_fish

    room = pool_size(pool)
    if pictures is not None:
        lab.pictures(pictures, count, seed, filming_of(load_fish(fish), room))
        output.say(f"wrote {pictures}: views/, pool.png, survey.csv")
    if socket is not None:
        scripted.film(socket, fish, room, seconds, seed, lambda line: print(line, flush=True))


def benchmark(
    env: Annotated[
        bool, typer.Option(help="Also measure environment and updates, and compare with SB3.")
    ] = True,
    sweep: Annotated[
        bool,
        typer.Option("--sweep", help="Measure a sweep of eight short trainings alone."),
    ] = False,
    json: JsonOption = None,
) -> None:
    """Measure speed and accuracy on this machine. It measures step, pool, environment, updates,
    camera and control loop, and compares the step with a bare engine loop."""
    check_json(json)
    if sweep:
        need_training()
        need("sweeps", "ray")
    from tailbeat.benchmarks import suite

    result = suite.sweep_benchmark() if sweep else suite.benchmark(env)
    results.benched(result)
    put_json(json, result)
