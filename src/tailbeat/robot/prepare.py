"""Set a servo up for a fish: find it at any id and baud rate, compare its registers, write them.

Torque goes off before anything is written, and the servo does not move. Every register is read
back. Id and baud rate come last, because the servo is then spoken to anew.
"""

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import serial

from tailbeat.files import BadInput
from tailbeat.fish.description import Family, Fish, Hardware
from tailbeat.fish.store import hardware_of
from tailbeat.robot import dynamixel, feetech_packet, feetech_tables, packet
from tailbeat.robot.dynamixel_tables import table_of
from tailbeat.robot.models import check_model
from tailbeat.robot.servo import Servo, ServoFault, on_port
from tailbeat.robot.settings import BAUD_RATE, IDENT, Setting, held, settings
from tailbeat.robot.wire import GONE, open_port, replies

EVERYONE = 0xFE  # the broadcast id of both families
LISTEN = {
    "dynamixel-x": 0.8,
    "dynamixel-p": 0.8,
    "feetech-sts": 0.1,
    "feetech-scs": 0.1,
}  # s: a Dynamixel waits 3 ms for each lower id
PATIENT = 0.25  # s for a reply


@dataclass(frozen=True)
class Found:
    """Where a servo answers, and its model number."""

    baud: int
    ident: int
    number: int


@dataclass(frozen=True)
class Change:
    """A setting, what its register holds `after` it was written, and what the servo `said`."""

    setting: Setting
    after: int
    said: str = ""

    @property
    def done(self) -> bool:
        """Whether the register holds what is wanted."""
        return self.after == self.setting.wanted


@dataclass(frozen=True)
class Looked:
    """A servo as it was found: where, and its settings."""

    found: Found
    settings: tuple[Setting, ...]

    @property
    def wrong(self) -> tuple[Setting, ...]:
        """The settings to write."""
        return tuple(one for one in self.settings if not one.fits)


# ---- find it ------------------------------------------------------------------------------------


def look(path: str, fish: Fish, ident: int | None = None, baud: int | None = None) -> Looked:
    """Find a servo and read its settings; nothing is written. Without `ident` and `baud` it is
    looked for at all ids and the usual rates. Raises BadInput."""
    hardware = hardware_of(fish)
    found = find(path, hardware, ident, baud)
    with _opened(path, hardware, found) as servo:
        return Looked(found, _settings(servo, fish))


def find(path: str, hardware: Hardware, ident: int | None = None, baud: int | None = None) -> Found:
    """Find the one servo on a bus. Raises BadInput where there is none, more than one, or another
    one than the fish's."""
    usual = feetech_tables.BAUDS if hardware.family.startswith("feetech") else dynamixel.BAUDS
    for rate in usual if baud is None else (baud,):
        with contextlib.closing(open_port(path, rate, PATIENT)) as port:
            heard = _ask(path, port, hardware, ident)
        if len(heard) > 1:
            told = ", ".join(str(one) for one, _ in heard)
            raise BadInput(f"{path}: ids {told} answer at {rate} baud; give one with --id.")
        if heard:
            found = Found(rate, *heard[0])
            check_model(path, found.number, hardware)
            _check_free(path, hardware, found)
            return found
    rates = ", ".join(map(str, usual)) if baud is None else baud
    who = "no servo" if ident is None else f"no servo {ident}"
    raise BadInput(
        f"{path}: {who} of {hardware.make} answers at {rates} baud; check cable and power, and the"
        f" fish's [hardware] table."
    )


def _ask(
    path: str, port: serial.Serial, hardware: Hardware, ident: int | None
) -> list[tuple[int, int]]:
    """Ids and model numbers of the servos that answer on a port: all of them, or one id."""
    listen = LISTEN[hardware.family] if ident is None else PATIENT
    pinged = EVERYONE if ident is None else ident
    try:
        if hardware.family.startswith("feetech"):
            return _feetechs(port, hardware.family, pinged, listen)
        return _dynamixels(port, pinged, listen)
    except GONE as error:
        raise BadInput(f"{path}: {error}; check the cable.") from None


def _dynamixels(port: serial.Serial, ident: int, listen: float) -> list[tuple[int, int]]:
    sent, heard = packet.encode(packet.Packet(ident, packet.PING)), []
    for status in replies(port, sent, packet.Parser(), listen):
        if status.instruction == packet.STATUS and len(status.data) == 3:
            heard.append((status.ident, int.from_bytes(status.data[:2], "little")))
            if ident != EVERYONE:
                break
    return heard


def _feetechs(
    port: serial.Serial, family: Family, ident: int, listen: float
) -> list[tuple[int, int]]:
    asked, heard = feetech_packet.Packet(ident, feetech_packet.PING), []
    for status in replies(port, feetech_packet.encode(asked), feetech_packet.Parser(), listen):
        if status.ident != EVERYONE and not status.parameters:
            heard.append(status.ident)
            if ident != EVERYONE:
                break
    with contextlib.suppress(ServoFault):
        servos = [on_port(port, family, one, PATIENT) for one in heard]
        return [(servo.ident, servo.get(feetech_tables.MODEL)) for servo in servos]
    return []


def _check_free(path: str, hardware: Hardware, found: Found) -> None:
    """Raises BadInput if another servo has the id and rate that this one is to have."""
    for rate in {found.baud, BAUD_RATE}:
        if (rate, IDENT) == (found.baud, found.ident):
            continue
        with contextlib.closing(open_port(path, rate, PATIENT)) as port:
            if _ask(path, port, hardware, IDENT):
                raise BadInput(
                    f"{path}: another servo has id {IDENT} at {rate} baud; unplug all but one."
                )


@contextlib.contextmanager
def _opened(path: str, hardware: Hardware, found: Found) -> Iterator[Servo]:
    with contextlib.closing(open_port(path, found.baud, PATIENT)) as port:
        yield on_port(port, hardware.family, found.ident, PATIENT)


def _settings(servo: Servo, fish: Fish) -> tuple[Setting, ...]:
    """What the servo's registers hold; of one that answers pings alone, the level that says so."""
    hardware = hardware_of(fish)
    try:
        return settings(servo, hardware, fish.motor.range)
    except ServoFault as fault:
        if fault.kind != "silent" or hardware.family.startswith("feetech"):
            raise BadInput(f"{servo.port.port}: {fault}; check its cable.") from None
    level = table_of(hardware.number).return_level
    return (Setting("status return level", level, 0, dynamixel.ANSWERS_ALL),)


# ---- write it -----------------------------------------------------------------------------------


def write(path: str, fish: Fish, looked: Looked) -> tuple[Change, ...]:
    """Turn torque off, write every setting that does not fit, and read it back. Raises BadInput if
    the servo stops answering, with how far it came."""
    hardware, done = hardware_of(fish), list[Change]()
    with _opened(path, hardware, looked.found) as servo:
        try:
            for change in _changes(servo, hardware, fish):
                done.append(change)
        except (ServoFault, *GONE) as fault:
            raise BadInput(
                f"{path}: {fault}; {len(done)} of {len(looked.wrong)} registers were written before"
                f" the servo stopped answering. Check cable and power, then run it again."
            ) from None
    return tuple(done)


def _changes(servo: Servo, hardware: Hardware, fish: Fish) -> Iterator[Change]:
    """Write what does not fit: first that the servo answers at all."""
    before = _settings(servo, fish)[0]
    if hardware.family.startswith("feetech"):
        _send(servo, feetech_tables.table_of(hardware.family).lock, 0)
    if not before.fits:
        yield _written(servo, before)
    servo.torque_off()
    for setting in settings(servo, hardware, fish.motor.range):
        if not setting.fits and setting.register != before.register:
            yield _written(servo, setting)
    if hardware.family.startswith("feetech"):
        servo.set(feetech_tables.table_of(hardware.family).lock, 1)


def _written(servo: Servo, setting: Setting) -> Change:
    """Write a setting and read it back, where the servo is then."""
    said = _send(servo, setting.register, setting.wanted)
    if setting.name == "id":
        old, servo.ident = servo.ident, setting.wanted
        return _read_back(servo, setting, said, lambda: setattr(servo, "ident", old))
    if setting.name == "baud rate":
        rate, servo.port.baudrate = servo.port.baudrate, BAUD_RATE
        return _read_back(servo, setting, said, lambda: setattr(servo.port, "baudrate", rate))
    return Change(setting, held(servo, setting.register), said)


def _read_back(servo: Servo, setting: Setting, said: str, go_back: Callable[[], None]) -> Change:
    """Read a setting under the servo's new id or rate, or under the old one if it kept that."""
    try:
        return Change(setting, held(servo, setting.register), said)
    except ServoFault as fault:
        if fault.kind != "silent":
            raise
    go_back()
    return Change(setting, held(servo, setting.register), said)


def _send(servo: Servo, register: tuple[int, int], value: int) -> str:
    """Write a register that is read back later; returns what the servo said against it."""
    try:
        servo.set(register, value)
    except ServoFault as fault:
        if fault.kind == "refused":
            return str(fault)
        if fault.kind != "silent":
            raise
    return ""
