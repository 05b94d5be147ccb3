"""Checks of serial ports, servo and IMU. They turn no torque on and write no register of the
servo."""

import contextlib
import fcntl
import math
import os
import statistics
import time
from collections.abc import Callable
from pathlib import Path

from tailbeat.files import BadInput
from tailbeat.fish.description import Hardware
from tailbeat.robot import dynamixel, feetech, feetech_tables, imus
from tailbeat.robot import dynamixel_tables as at
from tailbeat.robot import servo as servos
from tailbeat.robot.findings import BAD, Finding, finding
from tailbeat.robot.imu import ACCGYRO, MODE, STATUS, Imu, ImuFault
from tailbeat.robot.imus import YawSensor
from tailbeat.robot.mounting import TILTED, WRONG, Vector, mounting_of, named
from tailbeat.robot.safety import limits_for
from tailbeat.robot.servo import Servo, ServoFault
from tailbeat.robot.servo_state import PATIENCE
from tailbeat.robot.settings import BAUD_RATE, held

REVERSED, GOAL_TURNS_ON, OVERLOAD = 0b1, 0b1000, 0b100000  # bits of drive mode and shutdown
NO_WATCHDOG = (
    "the servo has no watchdog of its own: if loop and watchdog process both die, it keeps its last"
    " goal with torque on; have the switch of its power within reach"
)
FIRMWARE = 42  # older firmware of the X series was not checked
READS = 50
FEW, ROUNDS = 10, 3  # readings before a drive, and how often they are taken if they are bad: a
# computer that was busy for a moment is no slow bus
MENDED = {"servo torque", "servo limits"}  # by arming
BY_ARMING = "nothing: arming sets it to 0, position"

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
    for baud in [one for one in _bauds(hardware) if one != BAUD_RATE]:
        with contextlib.suppress(BadInput):
            servos.connect(path, hardware, ident, baud, deadline=deadline).port.close()
            do = f"run `tailbeat prepare --servo {path} --fish FISH`: it sets the rate"
            return None, finding(name, f"at {baud} baud, not at 1000000", bad=True, do=do)
    return None, finding(name, said, bad=True)


def _bauds(hardware: Hardware) -> dict[int, int]:
    return feetech_tables.BAUDS if hardware.family.startswith("feetech") else dynamixel.BAUDS


def check_servo(servo: Servo, hardware: Hardware) -> list[Finding]:
    """Check firmware, supply, temperature, errors, mode, limits, gain, delays, and the time of a
    reading."""
    try:
        own = [*_condition(servo, hardware), *_settings(servo, hardware)]
        return [*own, _gain(servo, hardware), _reading_time(servo)]
    except ServoFault as fault:
        return [finding("servo", str(fault), bad=True)]


def check_before_driving(path: str, servo: Servo, hardware: Hardware) -> None:
    """Raises BadInput for what makes a drive wrong or dangerous and arming does not mend: a servo
    that turns the other way, reports an error, has a bad supply, does not shut down under overload,
    or takes too long for a reading."""
    usual, servo.deadline = servo.deadline, max(servo.deadline, PATIENCE)  # nothing moves yet
    try:
        found = [*_condition(servo, hardware), *_settings(servo, hardware)]
        found += _settled(lambda: [_reading_time(servo, FEW)])
    except ServoFault as fault:
        raise BadInput(f"{path}: {fault}; run `tailbeat doctor`.") from None
    finally:
        servo.deadline = usual
    _refuse(path, found)


def check_imu_before_driving(path: str, imu: YawSensor, hardware: Hardware) -> None:
    """Raises BadInput for an IMU with an error or another mode, one whose gravity contradicts the
    fish's file, and one that gives too few readings."""
    _refuse(path, _settled(lambda: check_imu(imu, hardware, FEW)))


def _settled(check: Callable[[], list[Finding]]) -> list[Finding]:
    """What a check finds; found bad, it is repeated, because the computer may have been busy."""
    for _ in range(ROUNDS):
        found = check()
        if all(one.verdict != BAD for one in found):
            break
    return found


def _refuse(path: str, found: list[Finding]) -> None:
    """Raises BadInput that names all that is bad and that arming does not mend."""
    bad = [one for one in found if one.verdict == BAD and one.name not in MENDED]
    if bad:
        told = "; ".join(f"{one.name} is {one.found}: {one.do}" for one in bad)
        raise BadInput(f"{path}: {told}.")


def _condition(servo: Servo, hardware: Hardware) -> list[Finding]:
    state, errors, limits = servo.read(), servo.hardware_errors(), limits_for(hardware)
    volts, heat = state.voltage, state.temperature
    sags = not limits.voltage_low <= volts <= limits.voltage_high
    on, latched = servo.is_on(), servo.stopped_itself()
    watchdog = finding("servo stopped itself", "yes" if latched else "no", warn=latched)
    if not servo.own_watchdog:
        watchdog = finding("servo's own watchdog", "none", warn=True, do=NO_WATCHDOG)
    return [
        _firmware(servo, hardware),
        finding("servo supply", f"{volts:.1f} V", bad=sags, warn=volts < limits.voltage_low + 1),
        finding("servo temperature", f"{heat:.0f} deg C", bad=heat >= limits.temperature_hold),
        finding("servo hardware error", ", ".join(errors) or "none", bad=bool(errors)),
        finding("servo torque", "on" if on else "off", bad=on),
        watchdog,
    ]


def _firmware(servo: Servo, hardware: Hardware) -> Finding:
    if hardware.family.startswith("feetech"):
        version = f"{servo.get(feetech_tables.MAJOR)}.{servo.get(feetech_tables.MINOR)}"
        return finding("servo firmware", version)
    number = servo.get(at.FIRMWARE)
    old = hardware.family == "dynamixel-x" and number < FIRMWARE
    return finding("servo firmware", str(number), warn=old)


def _settings(servo: Servo, hardware: Hardware) -> list[Finding]:
    """Check the EEPROM. Arming sets mode, return delay and limits; `tailbeat prepare` sets the
    other registers too."""
    if hardware.family.startswith("feetech"):
        return _of_feetech(servo, hardware)
    return _of_dynamixel(servo, at.table_of(hardware.number).centre)


def _of_dynamixel(servo: Servo, centre: int) -> list[Finding]:
    mode, delay = servo.get(at.OPERATING_MODE), servo.get(at.RETURN_DELAY)
    low, high = held(servo, at.LOWEST), held(servo, at.HIGHEST)
    drive, homing = servo.get(at.DRIVE_MODE), held(servo, at.HOMING)
    shutdown = servo.get(at.SHUTDOWN)
    outside, turned = not low < centre < high, bool(drive & (REVERSED | GOAL_TURNS_ON))
    return [
        finding("servo mode", str(mode), warn=mode != dynamixel.POSITION_MODE),
        finding("servo return delay", f"{2 * delay} us", warn=delay > 5),
        finding("servo limits", f"{low} to {high} counts", bad=outside),
        finding("servo drive mode", str(drive), bad=turned, warn=drive != 0),
        finding("servo homing offset", str(homing), warn=homing != 0),
        finding("servo shutdown", f"{shutdown:#b}", bad=not shutdown & OVERLOAD),
    ]


def _of_feetech(servo: Servo, hardware: Hardware) -> list[Finding]:
    own, table = feetech_tables, feetech_tables.table_of(hardware.family)
    phase, unloading = servo.get(own.PHASE), servo.get(own.UNLOADING)
    low, high = servo.get(own.LOWEST), servo.get(own.HIGHEST)
    found = [
        finding("servo limits", f"{low} to {high} counts", bad=not low < table.centre < high),
        finding("servo phase", str(phase), bad=bool(phase & table.reversed)),
        finding("servo unloading", f"{unloading:#b}", bad=not unloading & OVERLOAD),
    ]
    if not table.modes:
        return found
    mode, turns = servo.get(own.MODE), bool(phase & own.TURNS)
    told = "counted" if turns else "within one"
    return [
        finding("servo mode", str(mode), warn=mode != feetech.POSITION_MODE, do=BY_ARMING),
        finding("servo turns", told, bad=turns),
        *found,
    ]


def _gain(servo: Servo, hardware: Hardware) -> Finding:
    """Check the gain of its position loop: with another, it is not the servo that was identified.
    The driver does not set it."""
    feetechs = hardware.family.startswith("feetech")
    register = feetech_tables.GAIN if feetechs else at.table_of(hardware.number).gain
    gain = servo.get(register)
    do = f"write {hardware.gain} to register {register[0]}, or identify the servo again with {gain}"
    return finding("servo position gain", str(gain), warn=gain != hardware.gain, do=do)


def _reading_time(servo: Servo, reads: int = READS) -> Finding:
    """Check the time of a reading: it must leave room in the 20 ms of a period."""
    took = []
    for _ in range(reads):
        began = time.monotonic()
        servo.read()
        took.append(1e3 * (time.monotonic() - began))
    middle = statistics.median(took)
    found = f"median {middle:.1f} ms, worst {max(took):.1f} ms, {servo.silent} lost"
    return finding("servo reading time", found, bad=middle > 8, warn=middle > 4 or servo.silent > 0)


# ---- IMU ----------------------------------------------------------------------------------------


def find_imu(
    path: str, hardware: Hardware, deadline: float = 0.05
) -> tuple[YawSensor | None, Finding]:
    """Find out which IMU is there, or say why none answers."""
    try:
        found = imus.connect(path, mounting_of(hardware), deadline)
    except BadInput as error:
        return None, finding("IMU answers", str(error), bad=True)
    return found, finding("IMU answers", found.name)


def check_imu(imu: YawSensor, hardware: Hardware, reads: int = READS) -> list[Finding]:
    """Check its own errors, its mode, its mounting, its readings, and its noise at rest."""
    try:
        own = _own_state(imu) if isinstance(imu, Imu) else []
        up = imu.up()
        rates = []
        for _ in range(reads):
            rates.append(imu.read())
            time.sleep(0.01)  # it measures a hundred times a second
    except ImuFault as fault:
        return [finding("IMU", str(fault), bad=True)]
    came = [one.rate for one in rates if one is not None]
    still = statistics.pstdev(came) if came else math.nan
    mean = abs(statistics.fmean(came)) if came else math.nan
    said = f"turning at {mean:.3f} rad/s, noise {still:.3f} rad/s"
    return [
        *own,
        _mounting(imu, up, hardware),
        finding("IMU readings", f"{len(came)} of {reads}", bad=len(came) < reads / 2),
        finding("IMU at rest", said, warn=not (mean < 0.1 and still < 0.1)),
    ]


def _own_state(imu: Imu) -> list[Finding]:
    """What a BNO055 reports about itself."""
    error = imu.registers(STATUS, 2)[1]
    imu.prepare()
    mode = imu.registers(MODE, 1)[0] & 0x0F
    return [
        finding("IMU's own error", str(error), bad=error != 0),
        finding("IMU mode", str(mode), bad=mode != ACCGYRO),
    ]


def _mounting(imu: YawSensor, up: Vector, hardware: Hardware) -> Finding:
    """Compare gravity with the fish's file. The rate of a BNO085 has the same sign upside down."""
    mounting = mounting_of(hardware)
    told, off = f"{named(up)} is up by gravity, {mounting} by the fish's file", mounting.off(up)
    harmless = imu.name != "BNO055" and off > math.pi - TILTED
    return finding("IMU mounting", told, bad=off > WRONG and not harmless, warn=off > TILTED)
