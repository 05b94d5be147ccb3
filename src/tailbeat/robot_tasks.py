"""What do the robot's verbs do? A key, an emulated bench, a drive, and what its log is worth."""

import contextlib
import ctypes
import gc
import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tailbeat.control.policy import load_policy
from tailbeat.files import BadInput, need, refuse_existing
from tailbeat.fish.store import load_fish
from tailbeat.pool.plant import LENGTH, WIDTH
from tailbeat.recording import Recording, write_recording
from tailbeat.robot.ports import Ports

Say = Callable[[str], None]
OPERATOR = "the operator"  # who asked to stop, where a signal did
BY_HAND = ("not armed yet", f"stop asked by {OPERATOR}", "stop asked by the console")
WAIT_TO_ARM = 10.0  # s for the first poses and the laptop's clock
TARGET = "1.5,0.5"  # x,y [m] where none is named


def need_extra() -> None:
    """Raises BadInput where the robot's packages are missing."""
    need("the robot", "robot", "serial", "mcap")


def address(text: str, option: str) -> tuple[str, int]:
    """`host:port`."""
    host, _, port = text.rpartition(":")
    if not host or not port.isdigit() or not 0 <= int(port) < 65536:
        raise BadInput(f"{option} {text!r}: give host:port, as 127.0.0.1:5151.")
    try:
        return socket.gethostbyname(host), int(port)  # once, not in every period of the loop
    except OSError as error:
        raise BadInput(f"{option} {host}: {error.strerror}; give its address.") from None


def place(text: str, option: str = "--target") -> tuple[float, float]:
    """`x,y` [m] inside the pool."""
    try:
        x, y = map(float, text.split(","))
    except ValueError:
        raise BadInput(f"{option} {text!r}: give x,y in metres, as 1.2,-0.4.") from None
    if not (abs(x) <= LENGTH / 2 and abs(y) <= WIDTH / 2):
        raise BadInput(
            f"{option} {text}: outside the pool, whose ends lie at x = {LENGTH / 2:g} and"
            f" y = {WIDTH / 2:g}."
        )
    return x, y


def open_console(console: str) -> Any:
    """The operator's page at `host:port`, or None where that is empty."""
    if not console:
        return None
    need("the console", "robot", "fastapi", "uvicorn", "websockets")
    from tailbeat.operator.page import open_desk

    return open_desk(address(console, "--console"), (LENGTH, WIDTH))


def filmed_rig(fish: str, camera: Path, target: str, seed: int, say: Say) -> None:
    """Serve an emulated bench that gives pictures at a socket instead of poses, until told to stop;
    says where it is as one line of JSON."""
    need_extra()
    from tailbeat.emulators import rig as bench  # needs the extra
    from tailbeat.emulators.film import Filming, start_camera

    described, aim = load_fish(fish), place(target)
    eye = start_camera(camera, Filming(seed=seed))
    made, ended = bench.open_filmed_rig(described, eye, aim), told_to_end()
    _hurry(made)
    say(json.dumps({"servo": made.ports[0], "imu": made.ports[1], "camera": eye.where}))
    try:
        bench.serve(made, lambda: bool(ended))
    finally:
        bench.close_rig(made)


def end_with_parent() -> None:
    """Called in a process that we start, before it is anything: it gets SIGTERM when we die (Linux,
    prctl(2), PR_SET_PDEATHSIG)."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(1, signal.SIGTERM)


def told_to_end(*numbers: signal.Signals) -> list[int]:
    """Fills with the signals that ask for the end: these, or Ctrl-C and SIGTERM."""
    ended: list[int] = []
    for number in numbers or (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda n, _: ended.append(n))
    return ended


def _hurry(made: Any) -> None:
    """Compile before anyone waits for it, and collect no more: that would hold up the bus; a bench
    that is late looks like a servo that is."""
    from tailbeat.robot import timing

    timing.claim()
    made.shaft.advance(0.0, 0.01)
    _ = made.shaft.pose
    gc.freeze()
    gc.disable()


def rig(fish: str, key: Path, robot: str, target: str, console: str, seed: int, say: Say) -> None:
    """Serve an emulated bench until told to stop; says where it is as one line of JSON."""
    need_extra()
    from tailbeat.emulators import rig as bench  # needs the extra
    from tailbeat.link.datagrams import read_key
    from tailbeat.operator.page import announce, turn

    there, aim = address(robot, "--robot"), place(target)
    described, secret = load_fish(fish), read_key(key)
    desk = open_console(console)
    made = bench.open_rig(described, secret, there, aim, seed)
    ended = told_to_end()
    _hurry(made)
    host, port = made.laptop.socket.getsockname()
    ports = {"servo": made.ports[0], "imu": made.ports[1], "laptop": f"{host}:{port}"}
    say(json.dumps({**ports, "console": announce(desk) if desk else []}))

    def over() -> bool:
        if desk is not None:
            turn(desk, made.laptop.sender, described, time.monotonic())
        return bool(ended)

    try:
        bench.serve(made, over)
    finally:
        bench.close_rig(made)
        if desk is not None:
            desk.close()


@contextmanager
def own_rig(
    fish: str, target: str, seed: int, folder: Path, console: str = "", say: Say = print
) -> Iterator[tuple[Ports, Path]]:
    """A bench of our own in a process beside, and its key; says where its console is."""
    from tailbeat.link import datagrams as link

    key = folder / "rig.key"
    link.make_key(key)
    listen = link.free_address()
    words = ["rig", "--fish", fish, "--key", str(key), "--robot", f"{listen[0]}:{listen[1]}"]
    words += [f"--target={target}", "--seed", str(seed), "--console", console]
    command = [sys.executable, "-m", "tailbeat", *words]
    alone = {**os.environ, "NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}  # one fish: no pools
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        text=True,
        env=alone,
        start_new_session=True,  # Ctrl-C is for the loop: the bench ends after it
        preexec_fn=end_with_parent,
    )
    assert process.stdout is not None
    try:
        line = process.stdout.readline()
        if not line:
            raise BadInput("the emulated bench did not start; see what it said above.")
        said = json.loads(line)
        for told in said["console"]:
            say(told)
        yield Ports(said["servo"], said["imu"], listen, address(said["laptop"], "laptop")), key
    finally:
        process.terminate()
        process.wait(10)


def log_in(path: Path) -> Path:
    """A log's path; in a folder one that is named by day and time, as a service needs it."""
    return path / time.strftime("swim-%Y%m%d-%H%M%S.mcap") if path.is_dir() else path


def drive(
    policy: str,
    ports: Ports,
    key: Path,
    target: tuple[float, float] | None,
    seconds: float,
    log: Path,
    say: Say,
    each: Callable[[Any], None] = lambda loop: None,
    by_itself: bool = True,
    stay: bool = False,
) -> dict[str, Any]:
    """Arm (`by_itself`, or when ordered to), swim so long, disarm; every period in the log. A
    fish that stopped ends the drive, unless it is to `stay` for orders. A warden beside lets go if
    this process dies, and systemd hears that the loop turns. `each` is given the loop every
    period."""
    need_extra()
    from tailbeat.link import datagrams as link
    from tailbeat.robot import imu, loop, servo, systemd, timing
    from tailbeat.robot import log as logs
    from tailbeat.robot import watchdog as warden

    for refused in timing.claim():
        say(f"        {refused}")
    loaded, secret = load_policy(policy), link.read_key(key)
    refuse_existing(log)
    motor, gyro = servo.connect(ports.servo), None
    try:
        gyro = imu.connect(ports.imu)
        _prepare(gyro, ports.imu)
        receiver = link.Receiver(secret, (LENGTH, WIDTH))
        notes = {"policy": policy, "contract": loaded.contract.fish}
        with (
            link.bind(*ports.listen) as heard,
            contextlib.closing(logs.start(log, notes)) as written,
        ):
            devices = loop.Devices(motor, gyro, receiver, heard, ports.laptop)
            own = loop.Loop(
                loaded, devices, written.put, logging=lambda: not written.failed, target=target
            )
            with warden.guard(ports.servo) as watcher:
                own.alive = Alive(own, watcher, systemd.from_environment())
                try:
                    _swim(own, seconds, say, each, by_itself, stay)
                finally:
                    if not own.owing:
                        watcher.farewell()
            written.last_notes["pace"] = json.dumps(own.pace.report())
        return {**_outcome(own, log, by_itself), **paces(own.pace)}
    finally:
        motor.close()
        if gyro is not None:
            gyro.close()


def _outcome(own: Any, log: Path, by_itself: bool) -> dict[str, Any]:
    """A swim's numbers; of a service, whose log may hold days, how it ended alone."""
    from tailbeat.robot.log import read_rows

    rejected = dict(own.devices.receiver.rejected)
    if not by_itself:
        return {"rejected_datagrams": rejected, "ended": own.stand.reason}
    return summary(read_rows(log), own.stand.reason, rejected)


def _prepare(gyro: Any, path: str) -> None:
    """Set the IMU up without haste. Raises BadInput."""
    from tailbeat.robot.imu import PATIENCE, ImuFault

    gyro.deadline, usual = PATIENCE, gyro.deadline
    try:
        gyro.prepare()
    except ImuFault as fault:
        raise BadInput(f"{path}: {fault}; see what `tailbeat doctor` says.") from None
    gyro.deadline = usual


@dataclass(frozen=True)
class Alive:
    """What the loop calls every period: the warden (`watcher`) and systemd hear that it turns."""

    loop: Any
    watcher: Any
    notifier: Any

    def __call__(self, torque: bool) -> bool:
        """Whether the warden listens."""
        stand = self.loop.stand
        self.notifier.beat(time.monotonic(), f"{stand.state.value}: {stand.reason}")
        return bool(self.watcher.beat(torque))


def paces(pace: Any) -> dict[str, Any]:
    """How punctual the loop was, flat: p50 … max [ms] of every quantity."""
    found = {
        f"{quantity}_{name}": value
        for quantity, row in pace.report().items()
        for name, value in row.items()
    }
    return {**found, "periods": pace.periods, "periods_skipped": pace.skipped}


def _swim(
    own: Any,
    seconds: float,
    say: Say,
    each: Callable[[Any], None],
    by_itself: bool,
    stay: bool,
) -> None:
    """Wait until it may be armed, arm, swim, and say every change of state."""
    from tailbeat.link.status import State

    told, ended = [""], list[int]()

    def over(since: float) -> bool:
        each(own)
        if ended:
            own.stop_asked = OPERATOR  # an order to arm in the same period does not undo it
        if by_itself and not (ended or own.ordered):
            _begin(own, since)
        line = f"{own.stand.state.value}: {own.stand.reason}"
        if line != told[0]:
            told[0] = line
            say(f"{since:6.2f} s  {line}")
        rests = own.stand.state in (State.DISARMED, State.STOP)
        waited = own.stand.state is State.STOP or since > WAIT_TO_ARM
        return since >= seconds or (rests and (bool(ended) or (not stay and waited)))

    def end(number: int, _: Any) -> None:
        own.stop_asked = OPERATOR
        ended.append(number)

    ends = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.signal(number, end) for number in ends}
    try:
        own.run(over)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _begin(own: Any, since: float) -> None:
    """Arm after a second, and swim."""
    from tailbeat.link.status import State

    if own.stand.state is State.DISARMED and since > 1.0:
        own.arm(time.monotonic())
    if own.stand.state is State.ARMED:
        own.swim()


def summary(rows: list[dict[str, Any]], reason: str, rejected: dict[str, int]) -> dict[str, Any]:
    """What a log comes to: rate, lateness, ages, how near the fish came."""
    swum = [row for row in rows if row["state"] == "run"]
    time_ = np.array([row["time_s"] for row in rows])
    away = [_away(row) for row in swum if row["decided_on"]]
    ages = [row["pose_age_s"] for row in swum if row["pose_age_s"] is not None]
    return {
        "seconds": float(time_[-1] - time_[0]),
        "swum_s": 0.02 * len(swum),
        "rate_hz": float((len(rows) - 1) / (time_[-1] - time_[0])),
        "pose_age_ms_median": float(1e3 * np.median(ages)) if ages else None,
        "nearest_m": min(away) if away else None,
        "rejected_datagrams": rejected,
        "ended": reason,
    }


def _away(row: dict[str, Any]) -> float:
    """Distance to the target in the newest frame."""
    x, y, _, tx, ty, _ = row["decided_on"][:6]
    return float(np.hypot(tx - x, ty - y))


def export(log: Path, out: Path) -> Recording:
    """A log as a recording, CSV or Parquet."""
    need_extra()
    from tailbeat.robot.log import as_recording

    refuse_existing(out)
    recording = replace(as_recording(log), name=out.stem)
    write_recording(recording, out)
    return recording


def temporary() -> Any:
    """A folder that goes away."""
    return tempfile.TemporaryDirectory(prefix="tailbeat-")
