"""The fish's IMU: a Bosch BNO055 on a UART, read for its yaw rate.

Own driver. A reading is one burst. It does not wait for a busy sensor: "bus over-run" replies are
normal and pass by themselves. Registers, units and replies: data sheet BST-BNO055-DS000 (not
checked on a real sensor). Only the gyroscope is used. The IMU's heading drifts and has no fixed
zero; the camera gives the heading.
"""

import contextlib
import math
import struct
import time
from dataclasses import dataclass

import serial

from tailbeat.files import BadInput
from tailbeat.robot.mounting import Mounting, Vector, direction
from tailbeat.robot.wire import GONE, heard, hurry, reopen, send

CHIP_ID, ACCELERATION, GYRO, STATUS, UNITS, MODE, TRIGGER, PAGE = (
    0x00,
    0x08,
    0x14,
    0x39,
    0x3B,
    0x3D,
    0x3F,
    0x07,
)
CHIP = 0xA0
CONFIG, ACCGYRO = 0x00, 0x05  # raw rates: the fusion modes recalibrate during use
RATE = math.radians(1 / 16)  # rad/s per count
FASTEST = math.radians(2000)
TO_CONFIG, TO_OPERATE = 0.019, 0.007  # s that a change of mode takes
DEADLINE = 0.008  # s for a reply: 12 bytes at 115,200 baud plus the sensor's time
PATIENCE = 0.1  # s for the first one
OVER_RUN = 0x07
ERRORS = {
    0x02: "read failed", 0x03: "write failed", 0x04: "bad address", 0x05: "write disabled",
    0x06: "wrong start byte", 0x07: "bus over-run", 0x08: "too long", 0x09: "too short",
    0x0A: "time-out",
}  # fmt: skip
FROZEN = 10  # equal readings in a row that are a fault: at rest, noise is several counts


class ImuFault(Exception):
    """The sensor did not answer correctly. `kind`: "silent" (no reply), "gone" (the port is
    missing), "refused" (an error reply), or "frozen" (it answers, but its numbers do not
    change)."""

    def __init__(self, kind: str, text: str) -> None:
        super().__init__(text)
        self.kind = kind


class NoAnswer(BadInput):
    """Nothing that can be understood arrives from the port."""


@dataclass(frozen=True)
class YawRate:
    """One reading: `time` [s] monotonic, `rate` [rad/s], counter-clockwise from above."""

    time: float
    rate: float


@dataclass(eq=False)
class Imu:
    """An open sensor; see `connect`. `missed` counts failed readings, `over_runs` those that the
    sensor refused because it was busy."""

    port: serial.Serial
    mounting: Mounting
    deadline: float = DEADLINE
    name: str = "BNO055"
    missed: int = 0
    over_runs: int = 0
    last: bytes = b""
    same: int = 0

    def read(self) -> YawRate | None:
        """The yaw rate, or None if no valid reading came in time; the next call tries again. Raises
        ImuFault if the sensor is gone, or its numbers do not change."""
        try:
            data = self.registers(GYRO, 6)
        except ImuFault as fault:
            if fault.kind == "gone":
                raise
            self.missed += 1
            return None
        self._check_alive(data)
        x, y, z = (RATE * count for count in struct.unpack("<3h", data))
        if max(abs(x), abs(y), abs(z)) > FASTEST:
            self.missed += 1
            return None
        return YawRate(time.monotonic(), self.mounting.rate((x, y, z)))

    def _check_alive(self, data: bytes) -> None:
        self.same = self.same + 1 if data == self.last else 0
        self.last = data
        if self.same >= FROZEN:
            raise ImuFault("frozen", f"the IMU gave the same numbers {FROZEN} times; restart it")

    def prepare(self) -> None:
        """Set the units to degrees per second and the mode to accelerometer and gyroscope. Raises
        ImuFault."""
        for register, value, pause in (
            (PAGE, 0, 0.0), (MODE, CONFIG, TO_CONFIG), (UNITS, 0, 0.0), (MODE, ACCGYRO, TO_OPERATE),
        ):  # fmt: skip
            self.set(register, value)
            time.sleep(pause)

    def healthy(self) -> bool:
        """Whether the sensor reports no error of its own."""
        return self.registers(STATUS, 2)[1] == 0

    def up(self) -> Vector:
        """Unit vector that points up by gravity, in the sensor's axes. It needs `prepare`. Raises
        ImuFault."""
        x, y, z = struct.unpack("<3h", self.registers(ACCELERATION, 6))
        return direction((x, y, z))

    def registers(self, first: int, length: int) -> bytes:
        """Read a burst of registers. Raises ImuFault."""
        reply = self._exchange(bytes([0xAA, 0x01, first, length]), 2 + length)
        if reply[0] == 0xBB and reply[1] == length and len(reply) == 2 + length:
            return reply[2:]
        raise self._refused(reply)

    def set(self, register: int, value: int, tries: int = 5) -> None:
        """Write one register; try again while the sensor is busy or does not reply. Raises
        ImuFault."""
        for _ in range(tries):
            try:
                reply = self._exchange(bytes([0xAA, 0x00, register, 1, value]), 2)
            except ImuFault as silent:
                if silent.kind == "gone":
                    raise
                fault = silent
            else:
                if reply == b"\xee\x01":
                    return
                fault = self._refused(reply)
            time.sleep(0.01)
        raise fault

    def _refused(self, reply: bytes) -> ImuFault:
        code = reply[1] if reply[0] == 0xEE else -1
        self.over_runs += code == OVER_RUN
        return ImuFault("refused", f"the IMU: {ERRORS.get(code, 'a damaged reply')}")

    def _exchange(self, question: bytes, length: int) -> bytes:
        """Send a request and read its reply: `length` bytes, or two bytes if it is an error."""
        try:
            self.port.reset_input_buffer()
            send(self.port, question)
            end, reply = time.monotonic() + self.deadline, b""
            while len(reply) < (2 if reply[:1] == b"\xee" else length):
                data = heard(self.port, end, length - len(reply))
                if not data:
                    raise ImuFault("silent", f"no reply within {1e3 * self.deadline:g} ms")
                reply += data
        except GONE as error:
            raise ImuFault("gone", f"{self.port.port}: {error}; check the cable") from None
        return reply

    def reopen(self) -> None:
        """Open the port again after the cable was unplugged, and set the sensor up. Raises
        ImuFault."""
        try:
            reopen(self.port)
        except GONE as error:
            raise ImuFault("gone", f"{self.port.port}: {error}; check the cable") from None
        self.prepare()

    def close(self) -> None:
        """Close the port."""
        with contextlib.suppress(*GONE):
            self.port.close()


def opened(path: str, deadline: float) -> serial.Serial:
    """The open port of an IMU; both kinds speak 115,200 baud. Raises BadInput."""
    try:
        port = serial.Serial(path, 115_200, timeout=deadline, write_timeout=0.1, exclusive=True)
    except (*GONE, ValueError) as error:
        raise BadInput(f"{path}: {error}; give the IMU's port, closed in other programs.") from None
    hurry(port)
    return port


def connect(path: str, mounting: Mounting | None = None, deadline: float = DEADLINE) -> Imu:
    """Open a port and check that a BNO055 answers. `deadline` [s] is for a reply. Raises BadInput,
    NoAnswer if nothing answers."""
    imu = Imu(opened(path, deadline), mounting or Mounting(), max(deadline, PATIENCE))
    fault = None
    for _ in range(5):
        try:
            imu.set(PAGE, 0, tries=1)  # another program may have left it on page 1
            chip = imu.registers(CHIP_ID, 1)[0]
            break
        except ImuFault as one:
            fault = one
    else:
        imu.close()
        raise NoAnswer(
            f"{path}: no BNO055 answers at 115200 baud ({fault}); check cable, power and"
            f" its PS1 pin (high for UART)."
        )
    imu.deadline = deadline
    if chip != CHIP:
        imu.close()
        raise BadInput(
            f"{path}: chip {chip:#x} answers, a BNO055 has {CHIP:#x}; give the IMU's port."
        )
    return imu
