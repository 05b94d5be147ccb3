"""Driver of Feetech STS and SCS servos (STS3215, SCS0009) on a serial port, FT-SCS protocol.

Addresses and units: `feetech_tables`. Three things differ from a Dynamixel. A status reports
conditions of the servo, and never that a command was refused: what matters is read back. The EEPROM
is saved only while its lock is open. **There is no bus watchdog**: a servo that hears nothing more
keeps its last goal and its torque.
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
from tailbeat.robot.feetech_packet import (
    PING,
    READ,
    REBOOT,
    WRITE,
    Packet,
    Parser,
    encode,
    signed,
    with_sign,
)
from tailbeat.robot.feetech_tables import (
    COARSE,
    FASTEST,
    FINE,
    GOAL,
    HIGHEST,
    LEVEL,
    LOWEST,
    MODE,
    MODEL,
    PHASE,
    RETURN_DELAY,
    SCS_FASTEST,
    SPEED,
    STATUS,
    STS,
    TORQUE,
    ZERO_IS_FASTEST,
    Register,
    Table,
)
from tailbeat.robot.models import check_model, no_answer
from tailbeat.robot.servo_state import DEADLINE, PATIENCE, ServoFault, ServoState
from tailbeat.robot.wire import GONE, reopen, replies

VOLTAGE = 0.1  # V
STATE_FIRST, STATE_LENGTH = 56, 15  # present position ... current
POSITION_MODE = 0
ANSWERS_ALL = 1  # response level: the servo answers writes too
HARDWARE = {0: "voltage", 1: "encoder", 2: "overheat", 3: "overcurrent", 5: "overload"}


@dataclass(eq=False)
class Servo:
    """An open servo; see `connect`. `silent` counts missing replies. `sign` is 1 if counts increase
    with the motor angle, else -1. Without `answers_writes` (response level 0), torque is off if the
    register says so, although the write is not answered."""

    port: serial.Serial
    ident: int
    sign: int = 1
    deadline: float = DEADLINE
    current_unit: float = math.nan  # A per count, of the fish's hardware
    table: Table = STS
    speed_unit: float = STS.count  # rad/s per count of speed, as the servo's phase says
    parser: Parser = field(default_factory=Parser)
    silent: int = 0
    answers_writes: bool = True
    own_watchdog: ClassVar[bool] = False

    # ---- what the loop calls --------------------------------------------------------------------

    def read(self) -> ServoState:
        """Read the servo's state in one transaction. Raises ServoFault."""
        status = self._ask(READ, bytes([STATE_FIRST, STATE_LENGTH]), STATE_LENGTH, tries=2)
        data = status.parameters

        def word(address: int) -> int:
            at = address - STATE_FIRST
            return signed(int.from_bytes(data[at : at + 2], self.table.order))

        return ServoState(
            time=time.monotonic(),
            angle=self.sign * self.table.count * (word(56) - self.table.centre),
            velocity=self.sign * self.speed_unit * word(58),
            current=self.sign * self.current_unit * word(69),
            voltage=VOLTAGE * data[62 - STATE_FIRST],
            temperature=float(data[63 - STATE_FIRST]),
            alert=bool(status.instruction),
        )

    def write(self, angle: float) -> float:
        """Send a setpoint [rad]; returns the angle sent, rounded to whole counts. The servo itself
        keeps it within its limits. Raises ServoFault."""
        counts = self._counts(angle)
        self.set(GOAL, with_sign(counts))
        return self.sign * self.table.count * (counts - self.table.centre)

    def _counts(self, angle: float) -> int:
        return self.table.centre + self.sign * round(angle / self.table.count)

    # ---- arming ---------------------------------------------------------------------------------

    def prepare(self, low: float, high: float) -> None:
        """Turn torque off and set position mode, limits [rad] in the servo itself, goals without a
        ramp, and replies to all packets. Raises ServoFault."""
        with self._patient():
            self.torque_off()
            ends = sorted(map(self._counts, (low, high)))
            wanted = {LOWEST: ends[0], HIGHEST: ends[1]}
            if self.table.modes:
                wanted |= {MODE: POSITION_MODE, RETURN_DELAY: 0}
            self.store({one: value for one, value in wanted.items() if self.get(one) != value})
            self.set(self.table.plain, 0)
            self._set_fastest()

    def _set_fastest(self) -> None:
        """Let goals be reached as fast as the servo can: speed 0 means that, or standstill."""
        phase = self.get(PHASE)
        most = SCS_FASTEST
        if self.table.modes:
            most = self.get(FASTEST) * (COARSE if phase & FINE else 1)
        if phase & ZERO_IS_FASTEST or most:
            self.set(SPEED, 0 if phase & ZERO_IS_FASTEST else most)

    def store(self, values: dict[Register, int]) -> None:
        """Write registers of the EEPROM with its lock open, and read them back. Raises
        ServoFault."""
        if not values:
            return
        self.set(self.table.lock, 0)
        try:
            for register, value in values.items():
                self._keep(register, value)
        finally:
            self.set(self.table.lock, 1)

    def _keep(self, register: Register, value: int) -> None:
        self.set(register, value)
        if (kept := self.get(register)) != value:
            raise ServoFault(
                "refused", f"register {register[0]} holds {kept} after writing {value}"
            )

    def arm(self, watchdog: float = 0.1) -> float:
        """Turn torque on and hold the present angle; returns that angle [rad]. The goal is set
        first. `watchdog` has no effect, because the servo has none. Raises ServoFault."""
        with self._patient():
            held = self.release()
            self.set(TORQUE, 1)
            if not self.is_on():
                named = ", ".join(self.hardware_errors()) or "it reports no error"
                raise ServoFault("refused", f"torque did not come on: {named}")
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
        """Make the present angle the goal; returns it [rad]. Raises ServoFault, also where it lies
        outside the servo's limits: the servo would move to the nearer one."""
        angle = self.read().angle
        counts = self._counts(angle)
        low, high = self.get(LOWEST), self.get(HIGHEST)
        if not low <= counts <= high:
            raise ServoFault(
                "refused", f"the shaft is at {counts} counts, outside its limits {low} to {high}"
            )
        self._keep(GOAL, with_sign(counts))
        return angle

    def torque_off(self) -> None:
        """Turn torque off in any state, and read it back. Raises ServoFault."""
        try:
            self.set(TORQUE, 0)
        except ServoFault as fault:
            if fault.kind != "silent" or self.answers_writes:
                raise
        if self.is_on():
            raise ServoFault("refused", "torque is still on after the command to turn it off")

    def stopped_itself(self) -> bool:
        """False: the servo has no watchdog of its own."""
        return False

    def is_on(self) -> bool:
        """Whether the servo holds torque."""
        return bool(self.get(TORQUE))

    def hardware_errors(self) -> list[str]:
        """Names of the present hardware errors."""
        bits = self.get(STATUS)
        return [name for bit, name in HARDWARE.items() if bits >> bit & 1]

    def reboot(self) -> None:
        """Restart the servo: torque is off afterwards, and its RAM is lost. Older firmware does not
        know the instruction."""
        self._ask(REBOOT, b"", 0, tries=1)

    # ---- registers ------------------------------------------------------------------------------

    def get(self, register: Register) -> int:
        """Read an unsigned register (address, bytes). Raises ServoFault."""
        status = self._ask(READ, bytes(register), register[1], tries=2)
        return int.from_bytes(status.parameters, self.table.order)

    def set(self, register: Register, value: int) -> None:
        """Write a register (address, bytes). An answer says only that it came. Raises
        ServoFault."""
        (address, size), most = register, (1 << 8 * register[1]) - 1
        if not 0 <= value <= most:
            raise ServoFault("refused", f"register {address} takes 0 to {most}, not {value}")
        self._ask(WRITE, bytes([address]) + value.to_bytes(size, self.table.order), 0, tries=1)

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
        """One transaction; returns an answer with `length` bytes of data. Raises ServoFault."""
        for _ in range(tries):
            status = self._once(Packet(self.ident, instruction, body), length)
            if status is not None:
                return status
            self.silent += 1
        raise ServoFault("silent", f"no reply within {1e3 * self.deadline:g} ms")

    def _once(self, packet: Packet, length: int) -> Packet | None:
        try:
            for status in replies(self.port, encode(packet), self.parser, self.deadline):
                # Some adapters hear what they send. A read is no answer; a ping may look like one.
                echo = status == packet and packet.instruction == READ
                ours = status.ident == self.ident and len(status.parameters) == length
                if ours and not echo:
                    return status
        except GONE as error:
            raise ServoFault("gone", f"{self.port.port}: {error}; check the cable") from None
        return None


def check(servo: Servo, path: str, hardware: Hardware, baud: int) -> None:
    """Raises BadInput where not the fish's servo answers, or not to every packet."""
    try:
        servo._ask(PING, b"", 0, tries=3)
        number, level, phase = servo.get(MODEL), servo.get(LEVEL), servo.get(PHASE)
    except ServoFault as fault:
        raise no_answer(path, servo.ident, baud, fault) from None
    check_model(path, number, hardware)
    servo.speed_unit = servo.table.speed_unit(phase)
    if level < ANSWERS_ALL:
        raise BadInput(
            f"{path}: the servo's response level (register 8) is {level}, so it answers no writes"
            f" and confirms no command; run `tailbeat prepare --servo {path} --fish FISH`."
        )
