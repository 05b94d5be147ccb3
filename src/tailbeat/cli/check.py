"""Check devices, faults and timing; keys, logs, films and the service."""

from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Literal

import typer

from tailbeat.cli import output, progress
from tailbeat.cli.extras import need_camera, need_robot
from tailbeat.cli.options import (
    SHIPPED,
    DrivenFish,
    ForceCamera,
    ImuPort,
    JsonOption,
    PolicyOption,
    PoolFish,
    SeedOption,
    ServoPort,
)
from tailbeat.files import BadInput, check_json, need, new_file, put_json, refuse_existing
from tailbeat.link.places import LENGTH, WIDTH, pool_size

SAFE_AFTER_KILL = 0.5  # s, required


def faults(
    policy: PolicyOption = SHIPPED,
    fish: PoolFish = "pulley-fish",
    only: Annotated[list[str] | None, typer.Option(help="Names of faults; default: all.")] = None,
    kills: Annotated[int, typer.Option(help="How often to kill the loop, at random moments.")] = 0,
    repeat: Annotated[
        int, typer.Option(help="How often to make each fault; above 1, each is counted.")
    ] = 1,
    table: Annotated[
        Path | None, typer.Option("--table", help="Markdown file to write the table to.")
    ] = None,
    seed: SeedOption = 0,
    json: JsonOption = None,
) -> None:
    """Inject faults into emulated devices and measure the time to a safe state. It runs in real
    time. Exit code 1 if a fault does not lead to a safe state."""
    if kills < 0:
        raise BadInput(f"--kills {kills}: give 0 or more.")
    if repeat < 1:
        raise BadInput(f"--repeat {repeat}: give 1 or more.")
    for path in filter(None, (table, json)):
        refuse_existing(path)
    need_robot()
    from tailbeat.evaluate import fault_table
    from tailbeat.report.fault_table import markdown

    done = fault_table.faults(policy, fish, only or [], kills, seed, output.say, repeat)
    found = asdict(done)
    output.tables(found)
    if table is not None:
        with new_file(table) as beside:
            beside.write_text(markdown(done.faults), encoding="utf-8")
    put_json(json, found)
    torque_off = all(one.off_s < SAFE_AFTER_KILL for one in done.killed)  # False for NaN
    if not (torque_off and all(one.ok for one in done.faults)):
        raise typer.Exit(1)


def latency(
    policy: PolicyOption = SHIPPED,
    fish: PoolFish = "pulley-fish",
    minutes: Annotated[float, typer.Option(help="Duration of the measurement [min].")] = 10.0,
    allowed: Annotated[
        float, typer.Option(help="Largest allowed lateness, 99.9th percentile [ms].")
    ] = 2.0,
    seed: SeedOption = 0,
    json: JsonOption = None,
) -> None:
    """Measure the timing of the control loop on this machine. It drives emulated devices and
    reports lateness, work, latency and drift. Exit code 1 if the 99.9th percentile of the lateness
    exceeds --allowed."""
    check_json(json)
    if not minutes > 0:
        raise BadInput(f"--minutes {minutes:g}: give a time above 0.")
    need_robot()
    from tailbeat.benchmarks import loop
    from tailbeat.robot.results import drive_json

    found = loop.latency(policy, fish, minutes, seed, output.say)
    done = drive_json(found.drive) | {"armed_anew": found.armed_anew, "drift_ms": found.drift_ms}
    output.tables({"latency": [done]})
    put_json(json, done)
    if not done["late_p99.9_ms"] <= allowed:
        raise typer.Exit(1)


def torque_off(
    servo: ServoPort,
    ident: Annotated[int, typer.Option("--id", help="Id of the servo on its bus.")] = 1,
    baud: Annotated[int, typer.Option(help="Baud rate of the bus.")] = 1_000_000,
) -> None:
    """Turn the servo's torque off. Exit code 2 if the servo does not confirm it."""
    need_robot()
    from tailbeat.robot.watchdog import torque_off

    torque_off(servo, ident, baud)
    output.say(f"{servo}: torque is off")


def doctor(
    emulated: Annotated[
        bool, typer.Option("--emulated", help="Start emulated devices and check them.")
    ] = False,
    policy: PolicyOption = SHIPPED,
    fish: PoolFish = "pulley-fish",
    servo: Annotated[str, typer.Option("--servo", help="Serial port of the servo.")] = "",
    imu: ImuPort = "",
    listen: Annotated[str, typer.Option(help="host:port on which to listen for poses.")] = "",
    station: Annotated[str, typer.Option(help="host:port of the station.")] = "",
    key: Annotated[Path | None, typer.Option("--key", help="File of the shared key.")] = None,
    camera: Annotated[
        str, typer.Option(help="Camera of the station: /dev/video0 or unix:/path.")
    ] = "",
    calibration: Annotated[
        Path | None, typer.Option(help="Calibration of the camera, by `tailbeat calibrate`.")
    ] = None,
    logs: Annotated[Path, typer.Option(help="Folder of the logs.")] = Path(),
    seed: SeedOption = 0,
    json: JsonOption = None,
) -> None:
    """List what prevents the fish from swimming, and what to do about it. Nothing moves. Exit code
    1 if something is bad."""
    check_json(json)
    if not emulated and not any((servo, imu, listen, key, camera)):
        raise BadInput(
            "doctor: give --servo, --imu, --listen with --station, --key, --camera, or --emulated."
        )
    need_robot()
    from tailbeat.emulators.own_devices import own_devices
    from tailbeat.link.addresses import address
    from tailbeat.robot.doctor import Parts, examine, of_camera

    ends = [
        address(text, option) if text else None
        for text, option in ((listen, "--listen"), (station, "--station"))
    ]
    if camera:
        need_camera()
    cameras = of_camera(camera, calibration, fish)
    with ExitStack() as stack:
        parts = Parts(servo, imu, ends[0], ends[1], key)
        if emulated:
            parts = Parts.of(*stack.enter_context(own_devices(fish, seed, imu=imu)))
        found = examine(policy, fish, parts, logs, cameras)
    rows = [vars(finding) for finding in found]
    output.tables({"doctor": rows})
    put_json(json, {"findings": rows})
    if any(finding.verdict == "bad" for finding in found):
        raise typer.Exit(1)


def unit(
    out: Annotated[Path, typer.Option("--out", help="Unit to write, .service.")],
    policy: Annotated[str, typer.Argument(help="A policy, .onnx, or a shipped one's name.")],
    servo: ServoPort,
    imu: ImuPort,
    listen: Annotated[str, typer.Option(help="host:port on which to listen for poses.")],
    station: Annotated[str, typer.Option(help="host:port of the station.")],
    key: Annotated[Path, typer.Option("--key", help="File of the shared key.")],
    logs: Annotated[Path, typer.Option(help="Folder of the logs; each start writes one.")],
    user: Annotated[str, typer.Option(help="User that runs the service, not root.")] = "fish",
    fish: DrivenFish = None,
    force_camera: ForceCamera = False,
) -> None:
    """Write a systemd unit that runs `tailbeat drive`, disarmed until the operator arms it."""
    from tailbeat.robot.systemd import write_unit

    held = Path(policy)
    words = [
        str(held.resolve()) if held.is_file() else policy,
        *("--wait", "--seconds", "inf", "--servo", servo, "--imu", imu),
    ]
    words += ["--listen", listen, "--station", station, "--key", str(key.resolve())]
    words += ["--log", str(logs.resolve())]
    if fish is not None:
        words += ["--fish", str(Path(fish).resolve()) if Path(fish).is_file() else fish]
    words += ["--force-camera-yaw-rate"] if force_camera else []
    write_unit(out, user, servo, words)
    output.say(f"wrote {out}; copy it to /etc/systemd/system, then systemctl daemon-reload")


def key(path: Annotated[Path, typer.Argument(help="The key file to write.")]) -> None:
    """Write the key that station and fish share. Copy it to both. Only its owner can read it."""
    from tailbeat.link.datagrams import make_key

    make_key(path)
    output.say(f"wrote {path}; copy it to both machines")


def export(
    log: Annotated[Path, typer.Argument(help="A log of `tailbeat drive`, .mcap.")],
    out: Annotated[Path, typer.Option("--out", help="The recording to write, .csv or .parquet.")],
) -> None:
    """Convert a drive's log to a recording that identification reads. A log that was cut off is
    read up to its end. Exit code 1 if the file is damaged: what is whole is written."""
    from tailbeat.robot.log_export import export as export_log
    from tailbeat.robot.log_losses import losses

    recording, swim = export_log(log, out)
    output.warn(losses(swim))
    output.say(f"wrote {out}: {recording.time.size} rows")
    if swim.damaged:
        raise typer.Exit(1)


def film(
    log: Annotated[Path, typer.Argument(help="A log of `tailbeat drive` or `swim`, .mcap.")],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", help="Film to write: .mp4, .webp or .gif; default: beside the log, .mp4."
        ),
    ] = None,
    view: Annotated[
        Literal["follow", "side"],
        typer.Option("--view", help="Camera: follow the fish, or see the whole pool from a side."),
    ] = "follow",
    seconds: Annotated[float, typer.Option(help="Longest duration of the film [s].")] = 20.0,
    start: Annotated[
        float | None,
        typer.Option(help="Begin this time after the log's start [s]; default: where it swims."),
    ] = None,
    fish: Annotated[
        str | None,
        typer.Option("--fish", help="Fish that swam, a TOML file or a name; default: the log's."),
    ] = None,
    pool: Annotated[
        str, typer.Option("--pool", help="Length,width of the pool [m].")
    ] = f"{LENGTH:g},{WIDTH:g}",
    json: JsonOption = None,
) -> None:
    """Render a film of a run in three dimensions from its log. A log that was cut off is filmed up
    to its end. A .webp or .gif has 5 MB at most."""
    target = out or log.with_suffix(".mp4")
    for path in filter(None, (target, json)):
        refuse_existing(path)
    need("a film", "mcap", "mujoco", "imageio")
    from tailbeat.evaluate.motion import Span
    from tailbeat.report.film import FilmConfig
    from tailbeat.report.film import film as render

    config = FilmConfig(log, target, Span(seconds, start), view, fish, pool_size(pool))
    with progress.counting() as counted:
        done = render(config, counted)
    if not done.whole:
        output.say(f"{log}: cut off; the film ends where it ends")
    output.say(
        f"wrote {target}: {done.seconds:.1f} s, {done.frames} frames, {done.bytes / 1e6:.1f} MB"
    )
    put_json(json, done)
