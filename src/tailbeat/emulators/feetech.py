"""An emulated Feetech servo, STS or SCS: bytes, faults, a turning shaft.

Its memory is `feetech_table`; packets have their own encoder and parser (`feetech_packet`). It is
tested with the maker's SDK and with another maker's client. It holds positions only. The manual
lets a servo under overload hold with a lower torque (register 34); here torque goes off for every
error in register 19. Its load is what a test sets.
"""

import math
import struct
from dataclasses import dataclass, field

from tailbeat.emulators.feetech_packet import status, take
from tailbeat.emulators.feetech_table import SCS, Table
from tailbeat.emulators.servo import TICK, Faults, Profile, Shaft, torque_of_count
from tailbeat.fish.description import Hardware

PING, READ, WRITE, REG_WRITE, ACTION, RESET, REBOOT = 0x01, 0x02, 0x03, 0x04, 0x05, 0x06, 0x08
SYNC_READ, SYNC_WRITE = 0x82, 0x83
ALL = 0xFE  # the broadcast id
MOST = 250  # bytes of an answer: its length is one byte
SPEEDS = (1_000_000, 500_000, 250_000, 128_000, 115_200, 76_800, 57_600, 38_400)
FINE, ZERO_IS_FASTEST, TURNS = 4, 8, 16  # bits of the phase
VOLTAGE, OVERHEATED, OVERCURRENT, OVERLOAD = 0, 2, 3, 5  # bits of the status
COARSE, RAMP = 50, 100  # counts/s and counts/s^2: units of speed and acceleration
CALIBRATE = 128


@dataclass(eq=False)
class Feetech:
    """The servo with its memory; `answer` handles bytes, `advance` steps time."""

    shaft: Shaft = field(default_factory=Shaft)
    faults: Faults = field(default_factory=Faults)
    hardware: Hardware | None = None  # None: an STS3215 at 12 V
    stream: bytearray = field(default_factory=bytearray)
    registered: bytes = b""
    quiet_until: float = 0.0  # while it restarts
    now: float = 0.0
    profile: Profile = field(default_factory=Profile)
    latched: int = 0  # bits of errors that stay
    strained: dict[int, float] = field(default_factory=dict)  # s: since when, by error

    def __post_init__(self) -> None:
        self.table = Table(self.hardware)
        self.put, self.kind = self.table.put, self.table.kind
        self.count = math.radians(self.kind.span) / self.kind.steps
        self.torque_count = torque_of_count(self.hardware)

    def get(self, address: int, signed: bool = False) -> int:
        """Read a register, with its sign if it has one."""
        return self.table.get(address)

    @property
    def baud(self) -> int:
        """Its baud rate."""
        return SPEEDS[self.get(6)]

    @property
    def return_delay(self) -> float:
        """Time from an instruction to its answer [s]."""
        return 2e-6 * self.get(7)

    @property
    def on(self) -> bool:
        """Whether it holds torque."""
        return self.get(40) == 1

    # ---- time -----------------------------------------------------------------------------------

    def advance(self, now: float) -> None:
        """Step to time `now` [s]: turn the shaft, update readings and errors."""
        dt, self.now = max(now - self.now, 0.0), now
        goal = self._goal()
        while dt > 0:
            self._turn(goal, min(dt, TICK))
            dt -= TICK
        self._check()
        if not self.faults.frozen:
            self.put(56, self._counts(self.shaft.angle))
            self.put(58, self._sign * round(self.shaft.velocity / self._speed))
        if math.isfinite(counts := self.shaft.drawn / self.torque_count):
            self.put(69, self._sign * round(counts))

    @property
    def _speed(self) -> float:
        """Unit of speeds [rad/s]."""
        return self.count * (1 if self.get(18) & FINE or self.kind is SCS else COARSE)

    @property
    def _sign(self) -> int:
        return -1 if self.get(18) & self.kind.reversed else 1

    def _counts(self, angle: float) -> int:
        """Counts of a shaft's angle [rad]: within a turn, unless it counts turns; an SCS measures
        no angle beyond its ends."""
        counts = self.kind.middle + self._sign * round(angle / self.count) - self.get(31)
        if self.kind is SCS:
            return min(max(counts, 0), self.kind.steps - 1)
        return counts if self.get(18) & TURNS else counts % self.kind.steps

    def _goal(self) -> float | None:
        """The angle [rad] that is asked for; None where the mode or the torque asks for none."""
        if not self.on or self.get(33) != 0:
            return None
        counts, low, high = self.get(42), self.get(9), self.get(11)
        if self.kind is SCS and not (low or high):
            return None  # it turns as a motor
        if low or high:  # without both an STS takes goals of several turns
            counts = min(max(counts, low), high)
        self.put(67, counts)
        return self._sign * (counts - self.kind.middle + self.get(31)) * self.count

    def _turn(self, goal: float | None, dt: float) -> None:
        """Step the profile and the shaft."""
        if goal is None:
            self.profile = Profile(self.shaft.angle)
            self.shaft.advance(None, dt)
            return
        phase, speed, ramp = self.get(18), abs(self.get(46)), self.get(41)
        fastest = speed == 0 and bool(phase & ZERO_IS_FASTEST)
        limits = (
            math.inf if fastest else speed * self._speed,
            self.count * RAMP * ramp if ramp else math.inf,
        )
        self.shaft.advance(self.profile.advance(goal, *limits, dt), dt)

    def _check(self) -> None:
        """Report what is beyond its limits: at once, or after the time that the memory says."""
        if 0 < self.faults.dip_until < self.now:
            self.faults.dip_until = 0.0
            self.put(62, self.table.own.get(62, 120))
        bits = self.latched
        bits |= (not self.get(15) <= self.get(62) <= self.get(14)) << VOLTAGE
        bits |= (self.get(63) >= self.get(13)) << OVERHEATED
        if self.kind.overcurrent:
            most, patience = map(self.get, self.kind.overcurrent)
            self._strain(OVERCURRENT, abs(self.get(69)) >= most, 0.01 * patience)
        most, patience = map(self.get, self.kind.overload)
        self._strain(OVERLOAD, abs(self.get(60)) >= 10 * most, 0.01 * patience)
        self._report(bits | self.latched)

    def _strain(self, bit: int, strained: bool, patience: float) -> None:
        since = self.strained.setdefault(bit, self.now)
        if not strained:
            self.strained[bit] = self.now
        elif self.on and self.now - since >= patience:
            self.latched |= 1 << bit

    def _report(self, bits: int) -> None:
        self.put(65, bits)
        if bits & self.get(19):
            self.put(40, 0)

    def fail(self, bit: int) -> None:
        """Set an error until the servo restarts; torque goes off if the memory says so."""
        self.latched |= 1 << bit
        self._report(self.get(65) | self.latched)

    def reboot(self) -> None:
        """Restart: RAM as at power-up, the EEPROM as stored; no replies for a tenth of a second."""
        self.table.restart()
        self.latched, self.strained = 0, {}
        self.quiet_until = self.now + 0.1

    # ---- packets --------------------------------------------------------------------------------

    def answer(self, data: bytes) -> bytes:
        """Bytes in, bytes out."""
        if self.now < self.quiet_until:
            return b""
        self.stream += data
        out = b""
        while (packet := take(self.stream)) is not None:
            if packet[0] in (self.get(5), ALL):
                out += self.faults.spoilt(self._execute(*packet), -2)
        return out

    def _execute(self, ident: int, instruction: int, body: bytes) -> bytes:
        """The answer to an instruction; b"" where the servo says nothing."""
        own, level = self.get(5), self.get(8)  # its answer to a new id is still the old one's
        if instruction == PING:
            return status(own, self.get(65))
        if instruction in (READ, SYNC_READ):
            first = len(body) > 2 and body[2] == own  # alone on its line, it waits for no other
            asked = first if instruction == SYNC_READ else len(body) == 2 and ident != ALL
            fits = asked and body[1] <= MOST
            return status(own, self.get(65), self.table.read(*body[:2])) if fits else b""
        known = self._command(instruction, body)
        return status(own, self.get(65)) if known and level and ident != ALL else b""

    def _command(self, instruction: int, body: bytes) -> bool:
        """Carry an instruction out; returns whether it is one that gets an answer."""
        if instruction == WRITE:
            self._write(body)
        elif instruction == REG_WRITE:
            self.registered = body
            self.put(64, 1)
        elif instruction == ACTION:
            held, self.registered = self.registered, b""
            self.put(64, 0)
            self._write(held)
        elif instruction == RESET:
            self.table.factory(frozenset({5}))
        elif instruction == REBOOT:
            self.reboot()
        elif instruction == SYNC_WRITE:
            self._write_of_many(body)
        return instruction in (WRITE, REG_WRITE, ACTION, RESET, REBOOT)

    def _write(self, body: bytes) -> None:
        if len(body) < 2:
            return
        before = self.get(40)
        self.table.write(body[0], body[1:])
        if self.get(40) == CALIBRATE:
            self.put(40, before)
            away = self._counts(self.shaft.angle) - self.kind.middle + self.get(31)
            self.table.write(31, struct.pack("<H", away if away >= 0 else -away | 1 << 11))

    def _write_of_many(self, body: bytes) -> None:
        """A write to many servos: this one's part, if it is whole."""
        if len(body) < 3:
            return
        address, length = body[:2]
        for first in range(2, len(body), length + 1):
            data = body[first + 1 : first + 1 + length]
            if body[first] == self.get(5) and len(data) == length:
                self._write(bytes([address]) + data)
                return
