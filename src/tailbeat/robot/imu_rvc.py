"""The fish's IMU: a CEVA BNO085 (BNO080, BNO086) on a UART in its UART-RVC mode.

Own driver. The sensor sends 100 packets a second and takes no orders: BNO08X data sheet, 1.3.5.2
(not checked on a real sensor). A packet has yaw, pitch and roll, but no rate. The fish's heading
follows from them and the mounting. The yaw rate is its slope: of a straight line through the last
three packets, `RECENT`. Their times are counted with the packets' own index, so neither a late
reading nor a lost packet changes the rate.

One count of an angle is 0.01 degrees. Rounding to it gives the slope of a sensor that lies flat a
noise of 0.0036 rad/s rms, and at most 0.009 rad/s. With two packets it would be twice as much. The
slope is the rate at the middle packet, so it is 10 ms old when the newest packet arrives. If the
sensor's clock is wrong by one per cent, so is the rate.
"""

import contextlib
import math
import struct
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import serial

from tailbeat.robot.imu import FASTEST, ImuFault, NoAnswer, YawRate, opened
from tailbeat.robot.mounting import Mounting, Vector, direction
from tailbeat.robot.wire import GONE, heard, reopen

HEAD, LENGTH = b"\xaa\xaa", 19
FIELDS = struct.Struct("<B6h")  # index, yaw, pitch, roll [0.01 deg], acceleration x, y, z [mg]
STEP = 0.01  # s from one packet to the next
COUNT = math.radians(0.01)  # rad per count of an angle
HIGHEST = (18_000, 9_000, 18_000)  # counts of yaw, pitch, roll
RECENT = 3  # packets of which the slope is taken
GAP = 5  # packets; after a longer gap the slope begins anew
FROZEN = 20  # equal packets in a row that are a fault: the accelerations have noise (chosen)
DEADLINE = 0.008  # s to wait for a packet if none has arrived since the last reading
PATIENCE = 0.15  # s for the first packets
LATE = 64 * LENGTH  # bytes that waited so long that the rate would be old


@dataclass(frozen=True)
class Packet:
    """One packet: its `index` (0 to 255), yaw, pitch and roll [0.01 deg], and the accelerations
    along x, y and z [mg]."""

    index: int
    angles: tuple[int, int, int]
    accelerations: tuple[int, int, int]


def packets(stream: bytearray) -> tuple[list[Packet], int]:
    """Take the whole packets out of a stream, and leave the rest in it. Returns them, and how many
    headers were not followed by a valid packet."""
    found, damaged = [], 0
    while (start := stream.find(HEAD)) >= 0 and len(stream) >= start + LENGTH:
        packet = _packet(bytes(stream[start : start + LENGTH]))
        damaged += packet is None
        del stream[: start + (LENGTH if packet else 1)]
        if packet is not None:
            found.append(packet)
    if start < 0:
        del stream[:-1]  # the last byte may begin a header
    return found, damaged


def _packet(data: bytes) -> Packet | None:
    """A packet of 19 bytes; None if its checksum is wrong or an angle is impossible."""
    index, yaw, pitch, roll, *accelerations = FIELDS.unpack_from(data, 2)
    angles = (yaw, pitch, roll)
    possible = all(abs(one) <= most for one, most in zip(angles, HIGHEST, strict=True))
    if sum(data[2:-1]) % 256 != data[-1] or not possible:
        return None
    x, y, z = accelerations
    return Packet(index, angles, (x, y, z))


def slope(points: Sequence[tuple[float, float]]) -> float:
    """Slope of the straight line that fits points (time, value) best; two points or more."""
    middle, mean = (sum(values) / len(points) for values in zip(*points, strict=True))
    spread = sum((time - middle) ** 2 for time, _ in points)
    return sum((time - middle) * (value - mean) for time, value in points) / spread


@dataclass(eq=False)
class Bno085:
    """An open sensor; see `connect`. `missed` counts readings without a rate, `damaged` the packets
    with a wrong checksum."""

    port: serial.Serial
    mounting: Mounting
    deadline: float = DEADLINE
    name: str = "BNO085"
    missed: int = 0
    damaged: int = 0
    same: int = 0
    last: Packet | None = None
    stream: bytearray = field(default_factory=bytearray)
    recent: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=RECENT))

    def read(self) -> YawRate | None:
        """The yaw rate, or None if no packet came in time, or too few in a row; the next call tries
        again. Raises ImuFault if the sensor is gone, or its numbers do not change."""
        came = self._hear(time.monotonic() + self.deadline)
        fresh = sum([self._take(packet) for packet in came])
        if self.same >= FROZEN:
            raise ImuFault("frozen", f"the IMU gave the same numbers {FROZEN} times; restart it")
        rate = slope(self.recent) if fresh and len(self.recent) == RECENT else math.inf
        if abs(rate) > FASTEST:
            self.missed += 1
            return None
        return YawRate(time.monotonic() - self._age(), rate)

    def _age(self) -> float:
        """Time from the middle of the recent packets to the newest [s]."""
        times = [when for when, _ in self.recent]
        return times[-1] - sum(times) / len(times)

    def _take(self, packet: Packet) -> bool:
        """Add a packet to the recent ones; returns whether it is new. After a gap they begin
        anew."""
        last, self.last = self.last, packet
        gap = (packet.index - last.index) % 256 if last else GAP + 1
        if not gap:
            return False
        if last is None or gap > GAP or not self.recent:
            self.recent.clear()
            self.recent.append((0.0, 0.0))
            return True
        turned = math.remainder(self._heading(packet) - self._heading(last), math.tau)
        when, yaw = self.recent[-1]
        self.recent.append((when + gap * STEP, yaw + turned))
        alike = (packet.angles, packet.accelerations) == (last.angles, last.accelerations)
        self.same = self.same + 1 if alike else 0
        return True

    def _heading(self, packet: Packet) -> float:
        """The fish's heading [rad], without a fixed zero."""
        yaw, pitch, roll = (COUNT * one for one in packet.angles)
        return self.mounting.heading(yaw, pitch, roll)

    def _hear(self, end: float) -> list[Packet]:
        """The packets that have arrived; if there is none, wait for one until `end` [s]. Raises
        ImuFault."""
        try:
            data = b"".join(iter(lambda: heard(self.port, 0.0), b""))
            if len(data) > LATE:
                self._forget()
                return []
            while not (found := self._parsed(data)):
                if not (data := heard(self.port, end)):
                    break
        except GONE as error:
            raise ImuFault("gone", f"{self.port.port}: {error}; check the cable") from None
        return found

    def _parsed(self, data: bytes) -> list[Packet]:
        self.stream += data
        found, damaged = packets(self.stream)
        self.damaged += damaged
        return found

    def _forget(self) -> None:
        """Drop what was heard, so that the next rate is of new packets alone."""
        self.last, self.same = None, 0
        self.stream.clear()
        self.recent.clear()
        self.port.reset_input_buffer()

    def prepare(self) -> None:
        """Wait until packets arrive; the sensor has no settings in this mode. Raises ImuFault."""
        try:
            self._forget()
        except GONE as error:
            raise ImuFault("gone", f"{self.port.port}: {error}; check the cable") from None
        end = time.monotonic() + max(self.deadline, PATIENCE)
        while len(self.recent) < RECENT:
            if time.monotonic() > end:
                raise ImuFault("silent", f"no packets within {1e3 * PATIENCE:g} ms")
            for packet in self._hear(end):
                self._take(packet)

    def healthy(self) -> bool:
        """Whether whole packets arrive: the sensor reports no error of its own in this mode. Raises
        ImuFault."""
        self.prepare()
        return True

    def up(self) -> Vector:
        """Unit vector that points up by gravity, in the sensor's axes. Raises ImuFault."""
        self.prepare()
        return direction(self.last.accelerations if self.last else (0, 0, 0))

    def reopen(self) -> None:
        """Open the port again after the cable was unplugged. Raises ImuFault."""
        try:
            reopen(self.port)
        except GONE as error:
            raise ImuFault("gone", f"{self.port.port}: {error}; check the cable") from None
        self.prepare()

    def close(self) -> None:
        """Close the port."""
        with contextlib.suppress(*GONE):
            self.port.close()


def connect(path: str, mounting: Mounting | None = None, deadline: float = DEADLINE) -> Bno085:
    """Open a port and check that a BNO085 sends packets. `deadline` [s] is for a packet. Raises
    BadInput, NoAnswer if no packets arrive.

    The angles are counted from the vertical that gravity gives (data sheet: yaw, then pitch, then
    roll), so the rate has the same sign with z up and z down, whatever `mounting` says.
    """
    port = opened(path, deadline)
    sensor = Bno085(port, mounting or Mounting(), max(deadline, PATIENCE))
    try:
        sensor.prepare()
    except ImuFault as fault:
        sensor.close()
        raise NoAnswer(
            f"{path}: no BNO085 sends packets at 115200 baud ({fault}); check cable, power and its"
            f" pins (PS0 high, PS1 low for UART-RVC)."
        ) from None
    sensor.deadline = deadline
    return sensor
