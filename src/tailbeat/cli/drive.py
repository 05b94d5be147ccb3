"""Run the fish's control loop."""

import math
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Annotated, Any

import typer

from tailbeat.cli import output
from tailbeat.cli.extras import need_robot
from tailbeat.cli.options import (
    DrivenFish,
    ForceCamera,
    ImuPort,
    JsonOption,
    PageOption,
    PolicyFile,
    SeedOption,
)
from tailbeat.files import BadInput, put_json, refuse_existing
from tailbeat.link.addresses import address
from tailbeat.link.places import ANY_POOL, place, room
from tailbeat.robot.ports import Ports

EMULATED = "pulley-fish"  # fish of emulated devices, unless another is given
Devices = AbstractContextManager[tuple[Ports, Path]]  # where the devices are, and the key's file

SkipOption = Annotated[
    bool,
    typer.Option(
        "--skip-sign-test",
        help="Swim without comparing servo, IMU and camera first. The log says so.",
    ),
]


def drive(
    policy: PolicyFile,
    log: Annotated[Path, typer.Option("--log", help="Log to write: .mcap, or an existing folder.")],
    emulated: Annotated[
        bool, typer.Option("--emulated", help="Start emulated devices and drive them.")
    ] = False,
    servo: Annotated[str, typer.Option(help="Serial port of the servo.")] = "",
    imu: ImuPort = "",
    force_camera: ForceCamera = False,
    listen: Annotated[str, typer.Option(help="host:port on which to listen for poses.")] = "",
    station: Annotated[str, typer.Option(help="host:port of the station.")] = "",
    key: Annotated[Path | None, typer.Option("--key", help="File of the shared key.")] = None,
    fish: DrivenFish = None,
    target: Annotated[
        str | None, typer.Option("--target", help="Target x,y [m], instead of the target's tag.")
    ] = None,
    seconds: Annotated[
        float | None,
        typer.Option(help="Duration [s]; default: 30, or until Ctrl-C with --wait or --page."),
    ] = None,
    wait: Annotated[
        bool, typer.Option("--wait", help="Stay disarmed until the operator page arms the fish.")
    ] = False,
    skip_sign_test: SkipOption = False,
    page: PageOption = "",
    seed: SeedOption = 0,
    json: JsonOption = None,
) -> None:
    """Run the fish's control loop at 50 Hz: arm, swim, turn torque off. Exit code 1 if the loop
    stopped by itself."""
    need_robot()
    _hurry()
    from tailbeat.control.policy import measure_in
    from tailbeat.link.reasons import Reason
    from tailbeat.robot import session
    from tailbeat.robot.fits import check_named
    from tailbeat.robot.results import drive_json

    log = session.log_in(log)
    for path in filter(None, (log, json)):
        refuse_existing(path)
    pool = room(measure_in(policy).reach) if emulated else ANY_POOL
    aim, stay = None if target is None else place(target, pool=pool), wait or bool(page)
    lasts = _duration(seconds, stay)
    fish = fish or (EMULATED if emulated else None)
    if fish is not None:
        check_named(policy, fish)
    if emulated:
        devices = _emulated(str(fish), seed, target or "", page, imu, pool)
        aim = None if stay else aim  # the target's tag floats there; the operator may drag it
    else:
        devices = _given(servo, imu, listen, station, key, page)
    with devices as (ports, secret):
        asked = policy, ports, secret, log, aim, lasts, not wait, stay, not skip_sign_test
        config = session.DriveConfig(*asked, fish=fish, force_camera=force_camera)
        done = session.drive(config, output.say)
    _show(drive_json(done), json)
    if done.reason is not Reason.SWIMMING and not (stay and done.by_hand):
        raise typer.Exit(1)


def _show(row: dict[str, Any], json: Path | None) -> None:
    """Print what came of the drive, and write it."""
    output.tables({"drive": [row]})
    put_json(json, row)


def _hurry() -> None:
    """Take real-time priority before the imports: they take a second, and ten beside other
    programs."""
    from tailbeat.robot import timing

    timing.claim()


def _duration(seconds: float | None, stay: bool) -> float:
    """Duration of a drive [s]: as given, else infinite if it waits for orders, else 30."""
    if seconds is None:
        return math.inf if stay else 30.0
    if not seconds > 0:
        raise BadInput(f"--seconds {seconds:g}: give a time above 0.")
    return seconds


def _emulated(
    fish: str, seed: int, target: str, page: str, imu: str, pool: tuple[float, float]
) -> Devices:
    """Ports and key of emulated devices that are started for the drive."""
    from tailbeat.emulators.own_devices import own_devices

    return own_devices(fish, seed, target, page, imu, output.say, pool)


def _given(servo: str, imu: str, listen: str, station: str, key: Path | None, page: str) -> Devices:
    """The fish's own ports and key, as given."""
    if not (servo and imu and listen and station and key):
        raise BadInput("drive: give --servo, --imu, --listen, --station and --key, or --emulated.")
    if page:
        raise BadInput("--page: the station shows it; see `tailbeat station --page`.")
    ends = address(listen, "--listen"), address(station, "--station")
    return nullcontext((Ports(servo, imu, *ends), key))
