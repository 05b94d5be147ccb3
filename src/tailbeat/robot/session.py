"""A drive: arm the robot, swim, disarm, with every period in the log."""

import contextlib
import hashlib
import json
import platform
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import datetime
from importlib.metadata import version
from pathlib import Path

from tailbeat import __version__
from tailbeat.control.policy import Contract, Policy, load_policy, policy_path
from tailbeat.files import BadInput, refuse_existing
from tailbeat.fish.description import Fish, Hardware
from tailbeat.fish.store import hardware_of, load_fish
from tailbeat.link import datagrams as link
from tailbeat.link.reasons import Reason
from tailbeat.link.status import State
from tailbeat.processes import git_describe
from tailbeat.robot import imus, safety, servo, systemd, timing, watchdog
from tailbeat.robot import log as log_file
from tailbeat.robot.devices import Devices
from tailbeat.robot.doctor_devices import (
    NO_WATCHDOG,
    check_before_driving,
    check_imu_before_driving,
)
from tailbeat.robot.fits import NONE, carried, check_driven, check_swims, check_yaw_rate
from tailbeat.robot.imu import PATIENCE, ImuFault
from tailbeat.robot.imus import YawSensor
from tailbeat.robot.loop import Loop
from tailbeat.robot.models import motor_of
from tailbeat.robot.mounting import WRONG, mounting_of, named
from tailbeat.robot.ports import Ports
from tailbeat.robot.results import DriveResult, summarise

Say = Callable[[str], None]
Each = Callable[[Loop], None]
OPERATOR = "the operator"  # who requested a stop by a signal
WAIT_TO_ARM = 10.0  # s for the first poses and the station's clock


def log_in(path: Path) -> Path:
    """The log's path; if `path` is a folder, a file in it named by date and time, as a service
    needs."""
    return path / time.strftime("swim-%Y%m%d-%H%M%S.mcap") if path.is_dir() else path


@dataclass(frozen=True)
class DriveConfig:
    """A drive.

    The policy (a file or a shipped policy's name), the devices' ports, the key's file, the log's
    file. `target` [m], if set, replaces the target's tag; if it is outside the pool, whose size the
    station sends, the robot does not arm. The drive lasts `seconds`. It arms and swims `by_itself`,
    or when ordered. A robot that stopped ends the drive, unless `stay` is set. The first swim
    begins with the sign test, unless `sign_test` is False. `fish` is the fish that drives, by file
    or name: its `[hardware]` counts; None: the fish inside the policy. With `force_camera` a policy
    that was trained with an IMU swims without one.
    """

    policy: str
    ports: Ports
    key: Path
    log: Path
    target: tuple[float, float] | None = None
    seconds: float = 30.0
    by_itself: bool = True
    stay: bool = False
    sign_test: bool = True
    fish: str | None = None
    force_camera: bool = False


def drive(config: DriveConfig, say: Say, each: Each = lambda loop: None) -> DriveResult:
    """Arm, swim, disarm; every period is logged.

    A watchdog process turns torque off if this process fails. systemd is told that the loop runs.
    `say` gets every change of state; `each` is called every period with the loop. Raises BadInput.
    """
    for refused in timing.claim():
        say(f"        {refused}")
    loaded, secret = load_policy(config.policy), link.read_key(config.key)
    check_driven(loaded.contract)
    check_yaw_rate(loaded.contract, config.ports.imu, config.force_camera)
    fish = _that_drives(config, loaded)
    hardware = hardware_of(fish)
    if hardware.family.startswith("feetech"):
        say(f"        {hardware.model}: {NO_WATCHDOG}")
    refuse_existing(config.log)
    with _open_devices(config, secret, hardware) as devices:
        found = yaw_source(devices, hardware, config.force_camera)
        say(f"        yaw rate: {found}")
        noted = notes(config.policy, loaded.contract, fish) | {"yaw_rate": found}
        noted["sign_test"] = _sign_test(config, loaded, say)
        with contextlib.closing(log_file.start(config.log, noted)) as written:
            limits = safety.limits_for(hardware)
            own = Loop(
                loaded, devices, written.put, limits,
                target=config.target, sign_test=config.sign_test,
                motor=motor_of(carried(loaded.contract), hardware),
            )  # fmt: skip
            own.logging = lambda: written.healthy
            _guarded(own, config, hardware, say, _noting(written, each))
            written.last_notes["pace"] = json.dumps(own.pace.report())
        if written.failed or written.dropped:
            say(f"log: {written.dropped} rows are lost; {written.failed or 'its writer was late'}")
        return _result(own, config)


def _that_drives(config: DriveConfig, policy: Policy) -> Fish:
    """The fish that drives. Raises BadInput if the policy does not fit it."""
    fish = load_fish(config.fish) if config.fish else carried(policy.contract)
    check_swims(policy, None, fish)
    return fish


def notes(policy: str, contract: Contract, fish: Fish) -> dict[str, str]:
    """What the head of a log tells of a drive: its date, what swam, and with which versions. `fish`
    is the description of the fish that drives, in SI. The camera's calibration is the station's,
    which tells it later; see `_noting`."""
    return {
        "date": datetime.now().astimezone().isoformat(timespec="seconds"),
        "policy": policy,
        "policy_sha256": hashlib.sha256(policy_path(policy).read_bytes()).hexdigest(),
        "contract": contract.fish,
        "fish_digest": contract.fish_digest,
        "fish": fish.model_dump_json(),
        "calibration": "unknown: no station told it",
        "tailbeat": __version__,
        "git": git_describe(),
        "onnxruntime": version("onnxruntime"),
        "python": platform.python_version(),
    }


def _noting(written: log_file.Log, each: Each) -> Each:
    """`each`, and the log's head gets the calibration that the station tells. One that changes,
    because another station is followed, is added."""
    known = list[bytes]()

    def both(loop: Loop) -> None:
        told = loop.devices.receiver.calibration
        if told is not None and told not in known[-1:]:
            known.append(told)
            written.note("calibration", ", then ".join(map(_calibration, known)))
        each(loop)

    return both


def _calibration(told: bytes) -> str:
    return "none: the station has no camera" if told == link.NO_CAMERA else f"sha256 {told.hex()}"


def _sign_test(config: DriveConfig, policy: Policy, say: Say) -> str:
    """What the log says of the sign test; `say` gets why there is none."""
    if not config.sign_test:
        said = "skipped as asked: nobody checked servo, IMU and camera against each other"
    elif policy.expected is None:
        said = (
            "missing: the policy's file does not say what to expect; run `tailbeat policy expect`"
        )
    else:
        return "before the first swim"
    say(f"sign test: {said}")
    return said


def yaw_source(devices: Devices, hardware: Hardware, forced: bool = False) -> str:
    """Where the yaw rate comes from, for the operator and the log. A sensor at rest whose gravity
    contradicts the fish's file is named."""
    if devices.imu is None:
        return "the camera" + (", forced: the policy was trained with an IMU" if forced else "")
    try:
        up = devices.imu.up()
    except ImuFault as fault:
        return f"{devices.imu.name}; {fault}"
    mounting = mounting_of(hardware)
    told = f"{devices.imu.name}, {mounting} up"
    if mounting.off(up) < WRONG:
        return told
    return f"{told}; WARNING: by gravity {named(up)} is up, see `tailbeat doctor`"


@contextlib.contextmanager
def _open_devices(config: DriveConfig, key: bytes, hardware: Hardware) -> Iterator[Devices]:
    """Open servo, IMU and the link's socket; close them at the end."""
    ports = config.ports
    gyro: YawSensor | None = None
    motor = servo.connect(ports.servo, hardware)
    try:
        check_before_driving(ports.servo, motor, hardware)
        if ports.imu != NONE:
            gyro = imus.connect(ports.imu, mounting_of(hardware))
            _prepare(gyro, ports.imu, hardware)
        receiver = link.Receiver(key)  # the station sends the pool's size
        with link.bind(*ports.listen) as heard:
            yield Devices(motor, gyro, receiver, heard, ports.station)
    finally:
        motor.close()
        if gyro is not None:
            gyro.close()


def _guarded(own: Loop, config: DriveConfig, hardware: Hardware, say: Say, each: Each) -> None:
    """Swim with a watchdog process; it ends without action once the torque is off."""
    with watchdog.guard(config.ports.servo, families=[hardware.family]) as watcher:
        own.alive = Alive(own, watcher, systemd.from_environment())
        try:
            _swim(own, config, say, each)
        finally:
            if not own.torque.owing:
                watcher.farewell()


def _result(own: Loop, config: DriveConfig) -> DriveResult:
    status = own.safety_status
    swim = summarise(log_file.read_rows(config.log)) if config.by_itself else None
    return DriveResult(
        reason=status.reason,
        ended=status.text,
        rejected=dict(own.devices.receiver.rejected),
        punctuality=own.pace.report(),
        periods=own.pace.periods,
        periods_skipped=own.pace.skipped,
        swim=swim,
    )


def _prepare(gyro: YawSensor, path: str, hardware: Hardware) -> None:
    """Set the IMU up and check it, with a longer deadline. Raises BadInput."""
    gyro.deadline, usual = PATIENCE, gyro.deadline
    try:
        gyro.prepare()
        check_imu_before_driving(path, gyro, hardware)
    except ImuFault as fault:
        raise BadInput(f"{path}: {fault}; run `tailbeat doctor`.") from None
    gyro.deadline = usual


@dataclass(frozen=True)
class Alive:
    """Called every period: tells the watchdog (`watcher`) and systemd that the loop runs."""

    loop: Loop
    watcher: watchdog.Watchdog
    notifier: systemd.Notifier

    def __call__(self, torque: bool) -> bool:
        """Whether the watchdog process still runs."""
        safety_status = self.loop.safety_status
        self.notifier.beat(time.monotonic(), f"{safety_status.state.value}: {safety_status.text}")
        return self.watcher.beat(torque)


def _swim(own: Loop, config: DriveConfig, say: Say, each: Each) -> None:
    """Wait until arming is possible, arm, swim, and report every change of state."""
    told, ended = [""], list[int]()

    def over(since: float) -> bool:
        each(own)
        if ended:
            own.stop_asked = OPERATOR  # an order to arm in the same period does not undo it
        if config.by_itself and not (ended or own.ordered):
            _begin(own, since)
        line = f"{own.safety_status.state.value}: {own.safety_status.text}"
        if line != told[0]:
            told[0] = line
            say(f"{since:6.2f} s  {line}")
        rests = own.safety_status.state in (State.DISARMED, State.STOP)
        waited = own.safety_status.state is State.STOP or since > WAIT_TO_ARM
        return since >= config.seconds or (rests and (bool(ended) or (not config.stay and waited)))

    def end(number: int, _: object) -> None:
        own.stop_asked = OPERATOR
        ended.append(number)

    ends = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.signal(number, end) for number in ends}
    try:
        own.run(over)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _begin(own: Loop, since: float) -> None:
    """Arm one second after the start, and swim. Raises BadInput for a target outside the pool."""
    if own.safety_status.state is State.DISARMED and since > 1.0:
        refused = own.arm(time.monotonic())
        if refused.reason is Reason.TARGET_OUTSIDE:
            raise BadInput(f"--target: {refused.text}; give a target inside.")
    if own.safety_status.state is State.ARMED:
        own.swim()
