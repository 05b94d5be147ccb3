"""Driver of ROBOTIS X- and P-series servos on a serial port, Protocol 2.0.

Own driver. The maker's library blocks 34 ms on a lost reply, reads that as the value 0, and writes
without stuffing. Here a reply must come within 5 ms, a read is tried twice, a write once, and every
error byte is checked. Addresses and units: `dynamixel_tables`; model and unit of current: the
fish's `Hardware`.
"""

import contextlib
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import ClassVar

import serial

from tailbeat.files import BadInput
from tailbeat.fish.description import Hardware
from tailbeat.robot.dynamixel_tables import (
    HIGHEST,
    LOWEST,
    MODEL,
    OPERATING_MODE,
    RETURN_DELAY,
    Register,
    Table,
    X,
    table_of,
)
from tailbeat.robot.models import check_model, no_answer
from tailbeat.robot.packet import (
    ERRORS,
    PING,
    READ,
    REBOOT,
    STATUS,
    WRITE,
    Packet,
    Parser,
    encode,
)
from tailbeat.robot.servo_state import DEADLINE, PATIENCE, ServoFault, ServoState
from tailbeat.robot.wire import GONE, reopen, replies

VOLTAGE = 0.1  # V
POSITION_MODE = 3
WATCHDOG_UNIT = 0.020  # s
BAUDS = {1_000_000: 3, 57_600: 1, 115_200: 2, 2_000_000: 4, 3_000_000: 5, 4_000_000: 6, 9_600: 0}
ANSWERS_ALL = 2  # status return level: the servo answers writes too


@dataclass(eq=False)
class Servo:
    """An open servo; see `connect`. `silent` counts missing replies. `sign` is 1 if counts increase
    with the motor angle, else -1. Without `answers_writes` (status return level 0 or 1), torque is
    off if the register says so, although the write is not answered. `known`: its model was
    compared with the table."""

    port: serial.Serial
    ident: int
    sign: int = 1
    deadline: float = DEADLINE
    current_unit: float = math.nan  # A per count, of the fish's hardware
    table: Table = X
    known: bool = False
    parser: Parser = field(default_factory=Parser)
    silent: int = 0
    answers_writes: bool = True
    own_watchdog: ClassVar[bool] = True

    # ---- what the loop calls --------------------------------------------------------------------

    def read(self) -> ServoState:
        """Read the servo's state in one transaction. Raises ServoFault."""
        table = self.table
        status = self._ask(READ, _pair(*table.state), table.state[1], tries=2)

        def held(register: Register) -> int:
            first = register[0] - table.state[0]
            return int.from_bytes(status.data[first:][: register[1]], "little", signed=True)

        return ServoState(
            time=time.monotonic(),
            angle=self.sign * table.count * (held(table.present_position) - table.centre),
            velocity=self.sign * table.velocity * held(table.present_velocity),
            current=self.sign * self.current_unit * held(table.present_current),
            voltage=VOLTAGE * held(table.present_voltage),
            temperature=float(held(table.temperature)),
            alert=status.alert,
        )

    def write(self, angle: float) -> float:
        """Send a setpoint [rad]; returns the angle sent, rounded to whole counts. Raises
        ServoFault, of kind "watchdog" if the servo had stopped itself."""
        counts = self._counts(angle)
        try:
            self.set(self.table.goal, counts)
        except ServoFault as fault:
            if fault.kind == "refused" and self.stopped_itself():
                raise ServoFault("watchdog", "the servo's bus watchdog stopped it") from None
            raise
        return self.sign * self.table.count * (counts - self.table.centre)

    def _counts(self, angle: float) -> int:
        return self.table.centre + self.sign * round(angle / self.table.count)

    # ---- arming ---------------------------------------------------------------------------------

    def prepare(self, low: float, high: float) -> None:
        """Turn torque off and set position mode, limits [rad] in the servo itself, goals without a
        profile, and fast replies to all packets. Raises ServoFault."""
        with self._patient():
            self._prepare(low, high)

    def _prepare(self, low: float, high: float) -> None:
        self.torque_off()
        ends = sorted(map(self._counts, (low, high)))
        wanted = {OPERATING_MODE: POSITION_MODE, RETURN_DELAY: 0, LOWEST: ends[0], HIGHEST: ends[1]}
        for register, value in wanted.items():
            held = value % (1 << 8 * register[1])  # registers are read without a sign
            if self.get(register) != held:  # saves write cycles of the EEPROM
                self.set(register, value)
        for register in (self.table.profile_acceleration, self.table.profile_velocity):
            self.set(register, 0)
        self.set(self.table.return_level, ANSWERS_ALL)

    def arm(self, watchdog: float = 0.1) -> float:
        """Turn torque on and hold the present angle; returns that angle [rad].

        The goal is set first, then the servo's own watchdog [s] (at most 2.54), then torque: it is
        never on without the watchdog. Raises ServoFault.
        """
        with self._patient():
            held = self.release(watchdog)
            self.set(self.table.torque, 1)
        return held

    @contextlib.contextmanager
    def _patient(self) -> Iterator[None]:
        """Wait longer for replies: nothing moves yet, and EEPROM is slow."""
        usual, self.deadline = self.deadline, max(self.deadline, PATIENCE)
        try:
            yield
        finally:
            self.deadline = usual

    def release(self, watchdog: float = 0.1) -> float:
        """Accept goals again after the servo's own watchdog stopped it; returns the angle held
        [rad].

        The first goal is the present angle, then the watchdog [s] is set again. Torque does not
        change. Raises ServoFault.
        """
        self.set(self.table.bus_watchdog, 0)
        held = self.write(self.read().angle)
        self.set(self.table.bus_watchdog, _periods(watchdog))
        return held

    def torque_off(self) -> None:
        """Turn torque off in any state, then the servo's watchdog. Raises ServoFault.

        The register is read back, because a late reply to an earlier write looks like the reply to
        this one. A model that was not compared yet is asked for, because a servo of another series
        may answer for a register that it does not have.
        """
        self._send(self.table.torque, 0)
        if self.is_on():
            raise ServoFault("refused", "torque is still on after the command to turn it off")
        if not self.known and table_of(self.get(MODEL)).torque != self.table.torque:
            raise ServoFault("refused", "a servo of another series answers")
        self._send(self.table.bus_watchdog, 0)

    def stopped_itself(self) -> bool:
        """Whether the servo's own watchdog stopped it; then goals are refused until `release`."""
        return self.get(self.table.bus_watchdog) == 0xFF

    def is_on(self) -> bool:
        """Whether the servo holds torque."""
        return bool(self.get(self.table.torque))

    def hardware_errors(self) -> list[str]:
        """Names of the present hardware errors. After a shutdown, only `reboot` clears them."""
        bits = self.get(self.table.hardware_error)
        return [name for bit, name in self.table.errors.items() if bits >> bit & 1]

    def reboot(self) -> None:
        """Restart the servo: torque is off afterwards, and its RAM is lost."""
        self._ask(REBOOT, b"", 0, tries=1)

    # ---- registers ------------------------------------------------------------------------------

    def get(self, register: Register) -> int:
        """Read an unsigned register (address, bytes). Raises ServoFault."""
        status = self._ask(READ, _pair(*register), register[1], tries=2)
        return int.from_bytes(status.data, "little")

    def set(self, register: Register, value: int) -> None:
        """Write a register (address, bytes). Raises ServoFault."""
        address, size = register
        body = address.to_bytes(2, "little") + (value % (1 << 8 * size)).to_bytes(size, "little")
        self._ask(WRITE, body, 0, tries=1)

    def _send(self, register: Register, value: int) -> None:
        """Write a register; of a servo that answers no writes, a missing reply is no fault."""
        try:
            self.set(register, value)
        except ServoFault as fault:
            if fault.kind != "silent" or self.answers_writes:
                raise

    def reopen(self) -> None:
        """Open the port again after the cable was unplugged. Raises ServoFault."""
        try:
            reopen(self.port)
        except GONE as error:
            raise ServoFault("gone", f"{self.port.port}: {error}; check the cable") from None

    def close(self) -> None:
        """Turn torque off if the servo still answers, and close the port."""
        with contextlib.suppress(ServoFault):
            self.torque_off()
        with contextlib.suppress(*GONE):
            self.port.close()

    def _ask(self, instruction: int, body: bytes, length: int, tries: int) -> Packet:
        """One transaction; returns a status with `length` bytes of data. Raises ServoFault."""
        for _ in range(tries):
            status = self._once(Packet(self.ident, instruction, body))
            if status is None:
                self.silent += 1
            elif status.error:
                said = ERRORS.get(status.error, f"number {status.error}")
                raise ServoFault("refused", f"the servo refused: {said} error")
            elif len(status.data) == length:
                return status
        raise ServoFault("silent", f"no reply within {1e3 * self.deadline:g} ms")

    def _once(self, packet: Packet) -> Packet | None:
        try:
            for status in replies(self.port, encode(packet), self.parser, self.deadline):
                ours = status.ident == self.ident and status.instruction == STATUS
                if ours and status.parameters:
                    return status
        except GONE as error:
            raise ServoFault("gone", f"{self.port.port}: {error}; check the cable") from None
        return None


def check(servo: Servo, path: str, hardware: Hardware, baud: int) -> None:
    """Raises BadInput where not the fish's servo answers, or not to every packet."""
    try:
        model = int.from_bytes(servo._ask(PING, b"", 3, tries=3).data[:2], "little")
    except ServoFault as fault:
        raise no_answer(path, servo.ident, baud, fault) from None
    check_model(path, model, hardware)
    servo.known = True
    try:
        level = servo.get(servo.table.return_level)
    except ServoFault:
        level = 0
    if level < ANSWERS_ALL:
        raise BadInput(
            f"{path}: the servo's status return level (register {servo.table.return_level[0]}) is"
            f" {level}, so it answers no writes and confirms no command; run `tailbeat prepare"
            f" --servo {path} --fish FISH`."
        )


def _periods(watchdog: float) -> int:
    """A bus watchdog [s] in its own unit."""
    return min(max(round(watchdog / WATCHDOG_UNIT), 1), 127)


def _pair(address: int, length: int) -> bytes:
    return address.to_bytes(2, "little") + length.to_bytes(2, "little")
