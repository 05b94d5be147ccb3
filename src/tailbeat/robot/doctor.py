"""What usually keeps a fish from moving: one question each, with what was found and what to do.

Every check is a function that returns findings and moves nothing: no torque, no register written.
Checks of a camera are others' functions of the same kind, passed in where there is a camera.
"""

import contextlib
import fcntl
import math
import os
import resource
import shutil
import socket
import statistics
import time
from dataclasses import dataclass
from pathlib import Path

from tailbeat.files import BadInput
from tailbeat.link import datagrams as link
from tailbeat.link.datagrams import Receiver
from tailbeat.robot import imu as imus
from tailbeat.robot import servo as servos
from tailbeat.robot.imu import Imu, ImuFault
from tailbeat.robot.safety import SafetyLimits
from tailbeat.robot.servo import Servo, ServoFault

OK, WARN, BAD = "ok", "warn", "bad"
REVERSED, OVERLOAD = 0b1, 0b100000  # bits of drive mode and shutdown
BAUDS = (57_600, 115_200, 2_000_000, 3_000_000, 4_000_000, 9_600)  # besides 1,000,000
LIMITS = SafetyLimits()
ROOM_WARN, ROOM_BAD = 2e9, 2e8  # bytes: a swim's log takes some 120 MB an hour
FIRMWARE = 42  # older firmware of the X series was not looked at
READS = 50
LISTEN = 2.0  # s to the laptop
ADVICE = {
    "servo answers": "check its power (12 V), cable and id; scan with the maker's Dynamixel Wizard",
    "servo": "check its cable; try another one",
    "servo firmware": "update it with the maker's Dynamixel Wizard",
    "servo supply": "charge or replace the battery; 12 V is meant",
    "servo temperature": "let it cool; is the tail jammed?",
    "servo hardware error": "find the reason, then switch the servo off and on",
    "servo torque": "tailbeat torque-off --servo PORT",
    "servo stopped itself": "nothing: arming clears it",
    "servo mode": "nothing: arming sets it to 3, position",
    "servo return delay": "nothing: arming sets it to 0",
    "servo limits": "2048, straight, must lie between: set registers 48 and 52",
    "servo drive mode": "reversed: set register 10 to 0 with the maker's Wizard",
    "servo homing offset": "set register 20 to 0: the straight tail is 2048",
    "servo shutdown": "overload does not take the torque away: set register 63 to 52",
    "servo reading time": "latency timer 1 ms, return delay 0, 1000000 baud, no hub in between",
    "IMU answers": "check cable, power and PS1 (high for UART); free a Pi's UART: raspi-config",
    "IMU": "switch it off and on; check its cable",
    "IMU's own error": "switch it off and on; the number is SYS_ERR of its data sheet",
    "IMU mode": "it does not take its mode: switch it off and on",
    "IMU readings": "busy, or a bad cable; use its UART, not I2C",
    "IMU at rest": "hold the fish still and ask again; else it is off by so much",
    "key": "tailbeat key NEW.key, copied to both machines, chmod 600",
    "laptop answers": "is the tracker running there? same key on both, address, firewall",
    "clocks compared": "a slow network: own access point, iw dev wlan0 set power_save off",
    "poses": "is the camera covered, or the fish's tag out of view?",
    "poses per second": "exposure too long, or the laptop too slow",
    "datagrams lost": "antenna under water? Wi-Fi power save? a channel of your own",
    "pose age": "the camera queues frames, or the network is slow",
    "fish seen": "its tag must lie in view, whole and without glare",
    "target seen": "float the target's tag, or give drive --target x,y",
    "disk": "choose a folder you may write to, or delete old logs: 120 MB an hour",
    "real-time priority": "start it from a unit (tailbeat unit), or allow rtprio 40 in limits.conf",
    "locked memory": "start it from the unit (tailbeat unit), or memlock unlimited in limits.conf",
    "processor's clock": "cpupower frequency-set -g performance",
    "wireless": "antenna above water; iw dev wlan0 set power_save off",
}  # fmt: skip


@dataclass(frozen=True)
class Finding:
    """One answer: `verdict` is "ok", "warn" (it may swim, and badly) or "bad" (it will not)."""

    name: str
    verdict: str
    found: str
    do: str = ""


def finding(name: str, found: str, bad: bool = False, warn: bool = False, do: str = "") -> Finding:
    """A finding, with what to do about it where it is not well."""
    verdict = BAD if bad else WARN if warn else OK
    return Finding(name, verdict, found, "" if verdict == OK else do or ADVICE[name])


# ---- ports --------------------------------------------------------------------------------------


def check_port(name: str, path: str, sysfs: Path = Path("/sys/class/tty")) -> list[Finding]:
    """Whether a serial port is there, may be opened, is free, and answers without delay."""
    if not Path(path).exists():
        do = "plug the cable in; see ls -l /dev/serial/by-id"
        return [finding(name, f"{path}: not there", bad=True, do=do)]
    if not os.access(path, os.R_OK | os.W_OK):
        do = "sudo usermod -aG dialout $USER, then log in anew"
        return [finding(name, f"{path}: no permission", bad=True, do=do)]
    if not _free(path):
        return [finding(name, f"{path}: in use", bad=True, do=f"end who holds it: fuser {path}")]
    timer = sysfs / Path(path).resolve().name / "device" / "latency_timer"
    if not timer.is_file():
        return [finding(name, path)]
    waits, do = int(timer.read_text()), f"echo 1 | sudo tee {timer}; for good, by a udev rule"
    slow = finding(f"{name}: latency timer", f"{waits} ms", bad=waits > 4, warn=waits > 1, do=do)
    return [finding(name, path), slow]


def _free(path: str) -> bool:
    """Whether nobody holds the lock that drivers take."""
    handle = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return True
    except OSError:
        return False
    finally:
        os.close(handle)


# ---- servo --------------------------------------------------------------------------------------


def find_servo(path: str, ident: int = 1, deadline: float = 0.05) -> tuple[Servo | None, Finding]:
    """The servo at a million baud, or at which other rate it answers."""
    name = "servo answers"
    try:
        found = servos.connect(path, ident, deadline=deadline)
        return found, finding(name, f"id {ident}, 1000000 baud")
    except BadInput as error:
        said = str(error)
    for baud in BAUDS:
        with contextlib.suppress(BadInput):
            servos.connect(path, ident, baud, deadline=deadline).port.close()
            do = "set its baud rate, register 8, to 3 with the maker's Dynamixel Wizard"
            return None, finding(name, f"at {baud} baud, not at 1000000", bad=True, do=do)
    return None, finding(name, said, bad=True)


def check_servo(servo: Servo, limits: SafetyLimits = LIMITS) -> list[Finding]:
    """Firmware, supply, temperature, errors, mode, limits, delays, and how long a reading takes."""
    try:
        return [*_condition(servo, limits), *_settings(servo), _reading_time(servo)]
    except ServoFault as fault:
        return [finding("servo", str(fault), bad=True)]


def _condition(servo: Servo, limits: SafetyLimits) -> list[Finding]:
    state, errors, version = servo.read(), servo.hardware_errors(), servo.get((6, 1))
    volts, heat = state.voltage, state.temperature
    sags = not limits.voltage_low <= volts <= limits.voltage_high
    on, latched = servo.is_on(), servo.stopped_itself()
    return [
        finding("servo firmware", str(version), warn=version < FIRMWARE),
        finding("servo supply", f"{volts:.1f} V", bad=sags, warn=volts < limits.voltage_low + 1),
        finding("servo temperature", f"{heat:.0f} deg C", bad=heat >= limits.temperature_hold),
        finding("servo hardware error", ", ".join(errors) or "none", bad=bool(errors)),
        finding("servo torque", "on" if on else "off", bad=on),
        finding("servo stopped itself", "yes" if latched else "no", warn=latched),
    ]


def _settings(servo: Servo) -> list[Finding]:
    """EEPROM; arming sets mode, delay and limits by itself."""
    mode, delay = servo.get(servos.OPERATING_MODE), servo.get(servos.RETURN_DELAY)
    low, high = servo.get(servos.LOWEST), servo.get(servos.HIGHEST)
    drive, homing, shutdown = servo.get((10, 1)), servo.get((20, 4)), servo.get((63, 1))
    outside = not low < servos.CENTRE < high
    return [
        finding("servo mode", str(mode), warn=mode != servos.POSITION_MODE),
        finding("servo return delay", f"{2 * delay} us", warn=delay > 5),
        finding("servo limits", f"{low} to {high} counts", bad=outside),
        finding("servo drive mode", str(drive), bad=bool(drive & REVERSED)),
        finding("servo homing offset", str(homing), warn=homing != 0),
        finding("servo shutdown", f"{shutdown:#b}", bad=not shutdown & OVERLOAD),
    ]


def _reading_time(servo: Servo) -> Finding:
    """A reading must leave room in 20 ms."""
    took = []
    for _ in range(READS):
        began = time.monotonic()
        servo.read()
        took.append(1e3 * (time.monotonic() - began))
    middle = statistics.median(took)
    found = f"median {middle:.1f} ms, worst {max(took):.1f} ms, {servo.silent} lost"
    return finding("servo reading time", found, bad=middle > 8, warn=middle > 4 or servo.silent > 0)


# ---- IMU ----------------------------------------------------------------------------------------


def find_imu(path: str, deadline: float = 0.05) -> tuple[Imu | None, Finding]:
    """The BNO055, or why none answers."""
    try:
        return imus.connect(path, deadline=deadline), finding("IMU answers", "BNO055")
    except BadInput as error:
        return None, finding("IMU answers", str(error), bad=True)


def check_imu(imu: Imu) -> list[Finding]:
    """Its own errors, its mode, whether it measures, and its noise at rest."""
    try:
        error = imu.registers(imus.STATUS, 2)[1]
        imu.prepare()
        mode = imu.registers(imus.MODE, 1)[0] & 0x0F
        rates = []
        for _ in range(READS):
            rates.append(imu.read())
            time.sleep(0.01)  # it has a new number a hundred times a second
    except ImuFault as fault:
        return [finding("IMU", str(fault), bad=True)]
    came = [one.rate for one in rates if one is not None]
    still = statistics.pstdev(came) if came else math.nan
    mean = abs(statistics.fmean(came)) if came else math.nan
    said = f"turning at {mean:.3f} rad/s, noise {still:.3f} rad/s"
    return [
        finding("IMU's own error", str(error), bad=error != 0),
        finding("IMU mode", str(mode), bad=mode != imus.ACCGYRO),
        finding("IMU readings", f"{len(came)} of {READS}", bad=len(came) < READS / 2),
        finding("IMU at rest", said, warn=not (mean < 0.1 and still < 0.1)),
    ]


# ---- key, network, laptop -----------------------------------------------------------------------


def check_key(path: Path | None) -> Finding:
    """Whether the shared key is there and nobody else's."""
    if path is None:
        return finding("key", "none given", bad=True)
    try:
        link.read_key(path)
    except BadInput as error:
        return finding("key", str(error), bad=True)
    return finding("key", str(path))


def listen_to(
    made: socket.socket, laptop: tuple[str, int], receiver: Receiver, seconds: float
) -> list[tuple[int, float]]:
    """Ask the laptop for its clock and take its poses for so long; sequence and age [s] of
    each, NaN while the clocks were not compared."""
    heard: list[tuple[int, float]] = []
    end, asked, questions = time.monotonic() + seconds, 0.0, 0
    while (now := time.monotonic()) < end:
        if now - asked > 0.1:
            asked, questions = now, questions + 1
            ask = link.ask_datagram(receiver.key, receiver.nonce, questions, time.monotonic_ns())
            with contextlib.suppress(OSError):
                made.sendto(ask, laptop)
        for data, _ in link.drain(made):
            before, now_ns = receiver.accepted, time.monotonic_ns()
            receiver.take(data, now_ns)
            if receiver.accepted > before:
                age = receiver.age(receiver.frames[0], now_ns)
                heard.append((receiver.last, math.nan if age is None else age))
        time.sleep(0.002)
    return heard


def check_link(
    made: socket.socket,
    laptop: tuple[str, int],
    receiver: Receiver,
    seconds: float = LISTEN,
    limits: SafetyLimits = LIMITS,
) -> list[Finding]:
    """Clock offset, loss, age of the poses, and whether fish and target are seen."""
    heard = listen_to(made, laptop, receiver, seconds)
    offset = receiver.clock.offset(time.monotonic_ns())
    if offset is None:
        strange = f"; dropped: {dict(receiver.rejected)}" if receiver.rejected else ""
        where = f"{laptop[0]}:{laptop[1]}"
        return [finding("laptop answers", f"nothing from {where}{strange}", bad=True)]
    ahead, doubt = offset[0] / link.SECOND, offset[1] / link.SECOND
    said = f"ahead by {ahead:.3f} s, known to {1e3 * doubt:.1f} ms"
    known = finding("clocks compared", said, bad=doubt >= limits.clock_doubt, warn=doubt > 0.01)
    answers = finding("laptop answers", "yes")
    if not heard:
        return [answers, known, finding("poses", f"none in {seconds:g} s", bad=True)]
    return [answers, known, *_poses(heard, receiver.frames[0], seconds, limits)]


def _poses(
    heard: list[tuple[int, float]], frame: link.Frame, seconds: float, limits: SafetyLimits
) -> list[Finding]:
    ages = [age for _, age in heard if not math.isnan(age)]
    rate, age = len(heard) / seconds, statistics.median(ages) if ages else math.nan
    lost = 1 - len(heard) / (heard[-1][0] - heard[0][0] + 1)
    old, fish, target = not age < limits.pose_hold, frame.fish, frame.target
    return [
        finding("poses per second", f"{rate:.0f}", bad=rate < 15, warn=rate < 40),
        finding("datagrams lost", f"{100 * lost:.0f} %", bad=lost > 0.5, warn=lost > 0.1),
        finding("pose age", f"{1e3 * age:.0f} ms", bad=old, warn=age > 0.1),
        finding("fish seen", "yes" if fish else "no", bad=fish is None),
        finding("target seen", "yes" if target else "no", warn=target is None),
    ]


# ---- this computer ------------------------------------------------------------------------------


def check_disk(folder: Path) -> Finding:
    """Room for the log."""
    if not folder.is_dir() or not os.access(folder, os.W_OK):
        return finding("disk", f"{folder}: no folder to write to", bad=True)
    free = shutil.disk_usage(folder).free
    return finding("disk", f"{free / 1e9:.1f} GB free", bad=free < ROOM_BAD, warn=free < ROOM_WARN)


def check_scheduling() -> list[Finding]:
    """Whether real-time priority and locked memory are allowed."""
    root, most = os.geteuid() == 0, resource.RLIM_INFINITY
    priority = root or resource.getrlimit(resource.RLIMIT_RTPRIO)[1] != 0
    memory = resource.getrlimit(resource.RLIMIT_MEMLOCK)[1]
    locked = "unlimited" if root or memory == most else f"{memory // 1024} KiB"
    return [
        finding("real-time priority", "allowed" if priority else "not allowed", warn=not priority),
        finding("locked memory", locked, warn=locked != "unlimited"),
    ]


def check_governor(sysfs: Path = Path("/sys/devices/system/cpu")) -> Finding:
    """Whether the processor's clock stays up."""
    files = sysfs.glob("cpu[0-9]*/cpufreq/scaling_governor")
    found = sorted({file.read_text().strip() for file in files})
    slow = bool(found) and found != ["performance"]
    return finding("processor's clock", ", ".join(found) or "fixed", warn=slow)


def check_wireless(proc: Path = Path("/proc/net/wireless")) -> Finding:
    """Whether a wireless link may carry the poses, and how strong it is."""
    rows = proc.read_text().splitlines()[2:] if proc.is_file() else []
    if not rows:
        return finding("wireless", "none")
    name, level = rows[0].split(":")[0].strip(), float(rows[0].split()[3])
    return finding("wireless", f"{name}: {level:.0f} dBm", bad=level < -80, warn=level < -67)
