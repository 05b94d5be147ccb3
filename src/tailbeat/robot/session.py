"""A drive: arm the fish, swim, disarm, with every period in the log, and what the log comes to."""

import contextlib
import json
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tailbeat.control.policy import load_policy
from tailbeat.files import BadInput, refuse_existing
from tailbeat.link import datagrams as link
from tailbeat.link.places import LENGTH, WIDTH
from tailbeat.link.status import State
from tailbeat.robot import imu, loop, servo, systemd, timing
from tailbeat.robot import log as log_file
from tailbeat.robot import watchdog as watchdog
from tailbeat.robot.ports import Ports

Say = Callable[[str], None]
OPERATOR = "the operator"  # who asked to stop, where a signal did
BY_HAND = ("not armed yet", f"stop asked by {OPERATOR}", "stop asked by the console")
WAIT_TO_ARM = 10.0  # s for the first poses and the laptop's clock


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
    fish that stopped ends the drive, unless it is to `stay` for orders. A watchdog process
    turns torque off if this process dies, and systemd hears that the loop turns. `each` is given
    the loop every period."""
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
            contextlib.closing(log_file.start(log, notes)) as written,
        ):
            devices = loop.Devices(motor, gyro, receiver, heard, ports.laptop)
            own = loop.Loop(
                loaded, devices, written.put, logging=lambda: not written.failed, target=target
            )
            with watchdog.guard(ports.servo) as watcher:
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
    rejected = dict(own.devices.receiver.rejected)
    if not by_itself:
        return {"rejected_datagrams": rejected, "ended": own.safety_status.text}
    return summary(log_file.read_rows(log), own.safety_status.text, rejected)


def _prepare(gyro: Any, path: str) -> None:
    """Set the IMU up without haste. Raises BadInput."""
    gyro.deadline, usual = imu.PATIENCE, gyro.deadline
    try:
        gyro.prepare()
    except imu.ImuFault as fault:
        raise BadInput(f"{path}: {fault}; see what `tailbeat doctor` says.") from None
    gyro.deadline = usual


@dataclass(frozen=True)
class Alive:
    """What the loop calls every period: the watchdog (`watcher`) and systemd hear that it turns."""

    loop: Any
    watcher: Any
    notifier: Any

    def __call__(self, torque: bool) -> bool:
        """Whether the watchdog listens."""
        safety_status = self.loop.safety_status
        self.notifier.beat(time.monotonic(), f"{safety_status.state.value}: {safety_status.text}")
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
    told, ended = [""], list[int]()

    def over(since: float) -> bool:
        each(own)
        if ended:
            own.stop_asked = OPERATOR  # an order to arm in the same period does not undo it
        if by_itself and not (ended or own.ordered):
            _begin(own, since)
        line = f"{own.safety_status.state.value}: {own.safety_status.text}"
        if line != told[0]:
            told[0] = line
            say(f"{since:6.2f} s  {line}")
        rests = own.safety_status.state in (State.DISARMED, State.STOP)
        waited = own.safety_status.state is State.STOP or since > WAIT_TO_ARM
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
    if own.safety_status.state is State.DISARMED and since > 1.0:
        own.arm(time.monotonic())
    if own.safety_status.state is State.ARMED:
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
