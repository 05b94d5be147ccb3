"""An emulated X- or P-series servo on a pseudo-terminal: bytes, faults, a turning shaft.

Its table (`servo_table`) and instructions (`servo_commands`) are from the manual, its packets have
their own encoder and parser (`packet`). Both these and the driver's are tested with the maker's
vectors, and the emulator with the maker's library and with another maker's client. It holds
positions only: with torque on in another mode its shaft stays. A profile timed in milliseconds
(drive mode, bit 2) is not emulated.
"""

import fcntl
import math
import os
import select
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

from tailbeat.emulators.line import Line
from tailbeat.emulators.packet import take
from tailbeat.emulators.servo_commands import ALL, execute
from tailbeat.emulators.servo_table import HOLDING, RAM, Table
from tailbeat.fish.catalogue import by_number, profile
from tailbeat.fish.description import Hardware

TICK, WATCHDOG = 1e-3, 0.020  # s
NO_LOAD = 5.55  # rad/s at 12 V
TURN = 2 * math.pi
REVERSED, TIMED = 0b1, 0b100  # bits of the drive mode
VOLTAGE, OVERHEATED = 0, 2  # bits of the hardware error
SPEEDS = {0: 9_600, 1: 57_600, 2: 115_200, 3: 1_000_000, 4: 2_000_000, 5: 3_000_000, 6: 4_000_000}
# Linux's request for a line's settings with the speed as a number: some clients set no named one.
TCGETS2, SETTINGS, SPEED = 0x802C542A, 44, 36  # request, bytes, place of the speed


# ---- the device ---------------------------------------------------------------------------------


@dataclass
class Shaft:
    """A shaft without a plant: speed proportional to the error, at most the no-load speed.

    `drawn` [N m]: the torque that the motor's current makes; NaN: not known, and the register of
    the current keeps what was put into it."""

    angle: float = 0.0
    velocity: float = 0.0
    drawn: float = math.nan
    stiffness: float = 25.0  # 1/s

    def advance(self, goal: float | None, dt: float) -> None:
        """Turn for `dt` [s] towards a goal [rad]; with None (no torque) it stays."""
        wanted = 0.0 if goal is None else self.stiffness * (goal - self.angle)
        self.velocity = max(-NO_LOAD, min(NO_LOAD, wanted))
        self.angle += self.velocity * dt


def torque_of_count(hardware: Hardware | None) -> float:
    """Torque [N m] of one count of a servo's current, or of its load; NaN for a servo whose stall
    current the catalogue lacks."""
    own = hardware or profile("xw430").hardware()
    known = by_number(own.number) if own else None
    return own.current_unit * known.torque_per_ampere if own and known else math.nan


@dataclass
class Faults:
    """Faults: `mute` replies to drop, `corrupt` replies to damage, `garbage` before a reply, `late`
    [s] for the next reply, `slow` [s] for every reply, `frozen` encoder, `dip_until` [s]: when the
    supply is as before; `shown`: share of the angle that the encoder shows."""

    mute: int = 0
    corrupt: int = 0
    garbage: bytes = b""
    late: float = 0.0
    slow: float = 0.0
    frozen: bool = False
    dip_until: float = 0.0
    shown: float = 1.0

    def spoilt(self, reply: bytes, at: int) -> bytes:
        """A reply as it reaches the driver; byte `at` is the one that is damaged."""
        if not reply:
            return b""
        if self.mute > 0:
            self.mute -= 1
            return b""
        if self.corrupt > 0:
            self.corrupt -= 1
            reply = reply[:at] + bytes([reply[at] ^ 0x40]) + reply[at:][1:]
        garbage, self.garbage = self.garbage, b""
        return garbage + reply


@dataclass(eq=False)
class Profile:
    """The goal's own motion: at most a speed [rad/s] and an acceleration [rad/s^2]; infinite: it
    steps, as from the factory."""

    angle: float = 0.0
    velocity: float = 0.0

    def advance(self, goal: float, speed: float, acceleration: float, dt: float) -> float:
        """The angle [rad] after `dt` [s] on the way to a goal [rad]."""
        away = goal - self.angle
        if not math.isfinite(speed):
            self.angle, self.velocity = goal, 0.0
            return self.angle
        slow = math.sqrt(2 * acceleration * abs(away)) if math.isfinite(acceleration) else math.inf
        wanted = math.copysign(min(speed, slow, abs(away) / dt), away)
        change = acceleration * dt
        self.velocity = min(max(wanted, self.velocity - change), self.velocity + change)
        self.angle += self.velocity * dt
        return self.angle


@dataclass(eq=False)
class Dynamixel:
    """The servo with its control table; `answer` handles bytes, `advance` steps time."""

    shaft: Shaft = field(default_factory=Shaft)
    faults: Faults = field(default_factory=Faults)
    hardware: Hardware | None = None  # None: an XW430-T200 at 12 V
    stream: bytearray = field(default_factory=bytearray)
    registered: bytes = b""
    quiet_until: float = 0.0  # while it restarts
    heard: float = 0.0  # time of the last packet
    now: float = 0.0
    profile: Profile = field(default_factory=Profile)

    def __post_init__(self) -> None:
        self.table = Table(self.hardware)
        self.get, self.put, self.units = self.table.get, self.table.put, self.table.units
        self.torque_count = torque_of_count(self.hardware)

    @property
    def baud(self) -> int | None:
        """Its baud rate."""
        return SPEEDS.get(self.get(8))

    @property
    def return_delay(self) -> float:
        """Time from an instruction to its answer [s]."""
        return 2e-6 * self.get(9)

    @property
    def on(self) -> bool:
        """Whether it holds torque."""
        return bool(self.get(64))

    # ---- time -----------------------------------------------------------------------------------

    def advance(self, now: float) -> None:
        """Step to time `now` [s]: turn the shaft, check the bus watchdog, update the readings."""
        dt, self.now = max(now - self.now, 0.0), now
        limit = self.get(98)
        if self.get(64) and 0 < limit < 128 and now - self.heard > limit * WATCHDOG:
            self.trip()
        goal = self._goal()
        while dt > 0:
            self._turn(goal, min(dt, TICK))
            dt -= TICK
        self.put(120, int(now * 1e3) % 32768)
        self._check()
        if not self.faults.frozen:
            self.put(132, self._counts(self.faults.shown * self.shaft.angle))
            self.put(128, self._sign * round(self.shaft.velocity / self.units.speed))
        if math.isfinite(counts := self.shaft.drawn / self.torque_count):
            self.put(126, self._sign * round(counts))

    @property
    def _sign(self) -> int:
        return -1 if self.get(10) & REVERSED else 1

    def _counts(self, angle: float) -> int:
        """Counts of a shaft's angle [rad], with drive mode and homing offset."""
        turned = self._sign * round(angle * self.units.steps / TURN)
        return self.units.middle + turned + self.get(20, True)

    def _goal(self) -> float | None:
        """The angle [rad] that is asked for; None where the mode or the torque asks for none."""
        mode = self.get(11)
        if not self.get(64) or mode not in HOLDING:
            return None
        counts = self.get(116, True) - self.units.middle - self.get(20, True)
        return self._sign * counts * TURN / self.units.steps

    def _turn(self, goal: float | None, dt: float) -> None:
        """Step the profile and the shaft."""
        if goal is None:
            self.profile = Profile(self.shaft.angle)
            self.shaft.advance(None, dt)
            return
        speed, ramp, timed = self.get(112), self.get(108), self.get(10) & TIMED
        limits = (
            speed * self.units.speed if speed and not timed else math.inf,
            ramp * self.units.acceleration if ramp and not timed else math.inf,
        )
        asked = self.profile.advance(goal, *limits, dt)
        self.put(140, self._counts(asked))
        self.shaft.advance(asked, dt)

    def _check(self) -> None:
        """Report a supply or a temperature beyond its limits."""
        if 0 < self.faults.dip_until < self.now:
            self.faults.dip_until = 0.0
            self.put(144, self.table.factory_value(144))
        if not self.get(34) <= self.get(144) <= self.get(32):
            self.fail(VOLTAGE)
        if self.get(146) >= self.get(31):
            self.fail(OVERHEATED)

    def trip(self) -> None:
        """Trip the bus watchdog: the servo stops where it is and refuses goals until 0 is written
        to it; its profile is lost."""
        self.put(98, 0xFF)
        self.put(108, 0)
        self.put(112, 0)
        self.put(116, self._counts(self.shaft.angle))

    def fail(self, bit: int) -> None:
        """Set a hardware error; torque goes off if it is in the shutdown mask."""
        self.put(70, self.get(70) | 1 << bit)
        if self.get(63) >> bit & 1:
            self.put(64, 0)

    def reboot(self) -> None:
        """Restart: RAM as at power-up; no replies for a tenth of a second."""
        heat, volts = self.get(146), self.get(144)
        self.table.factory(RAM)
        self.put(146, heat)
        self.put(144, volts)
        self.quiet_until = self.now + 0.1

    # ---- packets --------------------------------------------------------------------------------

    def answer(self, data: bytes) -> bytes:
        """Bytes in, bytes out."""
        if self.now < self.quiet_until:
            return b""
        self.stream += data
        out = b""
        while (packet := take(self.stream)) is not None:
            if packet[0] in (self.get(7), ALL):
                self.heard = self.now
                out += self.faults.spoilt(execute(self, *packet), -3)
        return out


# ---- the pseudo-terminal ------------------------------------------------------------------------


class Device(Protocol):
    """An emulated servo of any family."""

    faults: Faults

    @property
    def baud(self) -> int | None:
        """Its baud rate."""

    @property
    def return_delay(self) -> float:
        """Time from an instruction to its answer [s]."""

    def advance(self, now: float) -> None:
        """Step to time `now` [s]."""

    def answer(self, data: bytes) -> bytes:
        """Bytes in, bytes out."""


def hears(device: Device, line: Line) -> bool:
    """Whether the driver's end of the line has the servo's baud rate; otherwise it receives
    noise."""
    held = fcntl.ioctl(line.slave, TCGETS2, bytes(SETTINGS))
    return int.from_bytes(held[SPEED : SPEED + 4], "little") == device.baud


def serve(device: Device, line: Line, stop: Callable[[], bool], baud: int = 1_000_000) -> None:
    """Answer until `stop` returns True, with the time of the wire in both directions and the return
    delay."""
    began = time.monotonic()
    while not stop():
        ready, _, _ = select.select([line.master], [], [], TICK)
        device.advance(time.monotonic() - began)
        if not ready:
            continue
        data = os.read(line.master, 1024)
        reply = device.answer(data) if hears(device, line) else b""
        if reply:
            late, device.faults.late = device.faults.late + device.faults.slow, 0.0
            time.sleep(10 * (len(data) + len(reply)) / baud + device.return_delay + late)
            os.write(line.master, reply)
