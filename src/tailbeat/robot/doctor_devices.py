"""Checks of serial ports, servo and IMU. They turn no torque on and write no register of the
servo."""

import contextlib
import fcntl
import math
import os
import statistics
import time
from pathlib import Path

from tailbeat.files import BadInput
from tailbeat.fish.description import Hardware
from tailbeat.robot import imu as imus
from tailbeat.robot import servo as servos
from tailbeat.robot.findings import BAD, Finding, finding
from tailbeat.robot.imu import Imu, ImuFault
from tailbeat.robot.safety import SafetyLimits, limits_for
from tailbeat.robot.servo import Servo, ServoFault

REVERSED, OVERLOAD = 0b1, 0b100000  # bits of drive mode and shutdown
BAUDS = (57_600, 115_200, 2_000_000, 3_000_000, 4_000_000, 9_600)  # besides 1,000,000
FIRMWARE = 42  # older firmware of the X series was not checked
READS = 50
MENDED = {"servo torque", "servo limits"}  # by arming

# ---- ports --------------------------------------------------------------------------------------


def check_port(name: str, path: str, sysfs: Path = Path("/sys/class/tty")) -> list[Finding]:
    """Whether a serial port exists, may be opened, is not in use, and answers without delay."""
    if not Path(path).exists():
        do = "plug the cable in; see ls -l /dev/serial/by-id"
        return [finding(name, f"{path}: does not exist", bad=True, do=do)]
    if not os.access(path, os.R_OK | os.W_OK):
        do = "sudo usermod -aG dialout $USER, then log in again"
        return [finding(name, f"{path}: no permission", bad=True, do=do)]
    if not _free(path):
        return [
            finding(
                name, f"{path}: in use", bad=True, do=f"end the program that uses it: fuser {path}"
            )
        ]
    timer = sysfs / Path(path).resolve().name / "device" / "latency_timer"
    if not timer.is_file():
        return [finding(name, path)]
    waits, do = int(timer.read_text()), f"echo 1 | sudo tee {timer}; or a udev rule"
    slow = finding(f"{name}: latency timer", f"{waits} ms", bad=waits > 4, warn=waits > 1, do=do)
    return [finding(name, path), slow]


def _free(path: str) -> bool:
    """Whether no driver holds the port's lock."""
    handle = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return True
    except OSError:
        return False
    finally:
        os.close(handle)


# ---- servo --------------------------------------------------------------------------------------


def find_servo(
    path: str, hardware: Hardware, ident: int = 1, deadline: float = 0.05
) -> tuple[Servo | None, Finding]:
    """Find the fish's servo at 1,000,000 baud; if it answers at another rate, say at which."""
    name = "servo answers"
    try:
        found = servos.connect(path, hardware, ident, deadline=deadline)
        return found, finding(name, f"{hardware.model}, id {ident}, 1000000 baud")
    except BadInput as error:
        said = str(error)
    for baud in BAUDS:
        with contextlib.suppress(BadInput):
            servos.connect(path, hardware, ident, baud, deadline=deadline).port.close()
            do = "set its baud rate, register 8, to 3 with Dynamixel Wizard"
            return None, finding(name, f"at {baud} baud, not at 1000000", bad=True, do=do)
    return None, finding(name, said, bad=True)


def check_servo(servo: Servo, hardware: Hardware) -> list[Finding]:
    """Check firmware, supply, temperature, errors, mode, limits, gain, delays, and the time of a
    reading."""
    try:
        condition = _condition(servo, limits_for(hardware))
        return [*condition, *_settings(servo), _gain(servo, hardware), _reading_time(servo)]
    except ServoFault as fault:
        return [finding("servo", str(fault), bad=True)]


def check_before_driving(path: str, servo: Servo, hardware: Hardware) -> None:
    """Raises BadInput for what makes a drive wrong or dangerous and arming does not mend: a servo
    that turns the other way, reports an error, has a bad supply, or does not shut down under
    overload."""
    try:
        found = [*_condition(servo, limits_for(hardware)), *_settings(servo)]
    except ServoFault as fault:
        raise BadInput(f"{path}: {fault}; run `tailbeat doctor`.") from None
    bad = [one for one in found if one.verdict == BAD and one.name not in MENDED]
    if bad:
        told = "; ".join(f"{one.name} is {one.found}: {one.do}" for one in bad)
        raise BadInput(f"{path}: {told}.")


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
    """Check the EEPROM. Arming sets mode, return delay and limits; the other registers stay as they
    are."""
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


def _gain(servo: Servo, hardware: Hardware) -> Finding:
    """Check the gain of its position loop: with another, it is not the servo that was identified.
    The driver does not set it."""
    gain = servo.get(servos.GAIN)
    do = f"write {hardware.gain} to register 84, or identify the servo again with {gain}"
    return finding("servo position gain", str(gain), warn=gain != hardware.gain, do=do)


def _reading_time(servo: Servo) -> Finding:
    """Check the time of a reading: it must leave room in the 20 ms of a period."""
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
    """Find the BNO055, or say why none answers."""
    try:
        return imus.connect(path, deadline=deadline), finding("IMU answers", "BNO055")
    except BadInput as error:
        return None, finding("IMU answers", str(error), bad=True)


def check_imu(imu: Imu) -> list[Finding]:
    """Check its own errors, its mode, its readings, and its noise at rest."""
    try:
        error = imu.registers(imus.STATUS, 2)[1]
        imu.prepare()
        mode = imu.registers(imus.MODE, 1)[0] & 0x0F
        rates = []
        for _ in range(READS):
            rates.append(imu.read())
            time.sleep(0.01)  # it measures a hundred times a second
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
