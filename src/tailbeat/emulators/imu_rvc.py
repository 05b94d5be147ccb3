"""An emulated BNO085 in UART-RVC mode: 100 packets a second, and no replies.

Independent of the driver. Packets are those of the BNO08X data sheet, 1.3.5.2. What it leaves open
was not checked on a real sensor. The noise is chosen.
"""

import contextlib
import math
import os
import select
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from tailbeat.emulators.line import Line

RATE = 100.0  # packets per second
NOISE = 0.003  # deg rms of each angle
SHAKE = 3.0  # mg rms of each acceleration
BETWEEN = 0.02  # s: a spike of a rate is a step of the angle in this time


@dataclass
class Faults:
    """Faults: number of packets that are missing (`mute`), lost on the wire (`lost`: the index goes
    on) or have a wrong checksum (`damaged`); a `spike` [rad/s] in the next packet, or in every
    eighth one (`spiking`); `frozen` numbers."""

    mute: int = 0
    lost: int = 0
    damaged: int = 0
    spike: float = 0.0
    spiking: float = 0.0
    frozen: bool = False


@dataclass(eq=False)
class Bno085:
    """The sensor; its owner calls `turn` and `speak`. `up` is the direction that points up, in its
    own axes. `index` counts packets."""

    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    faults: Faults = field(default_factory=Faults)
    yaw: float = 0.0
    index: int = 255
    due: float | None = None  # s, the next packet
    held: bytes = b""  # angles and accelerations of the last packet
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))

    def turn(self, yaw: float, rate: float) -> None:
        """The fish's yaw [rad], counter-clockwise from above; the sensor reports no rate."""
        self.yaw = yaw

    def answer(self, data: bytes) -> bytes:
        """It takes no orders in this mode."""
        return b""

    def speak(self, now: float) -> bytes:
        """What it sends up to `now` [s]: one packet if it is time. Packets that would have come
        meanwhile are lost, and the index has counted them."""
        self.due = now if self.due is None else self.due
        if now < self.due:
            return b""
        passed = 1 + int((now - self.due) * RATE)
        self.due += passed / RATE
        if self.faults.mute > 0:
            self.faults.mute -= 1
            return b""
        self.index = (self.index + passed) % 256
        return self._sent(self._packet())

    def _packet(self) -> bytes:
        if not (self.faults.frozen and self.held):
            numbers = [*self._angles(), *self._accelerations()]
            self.held = b"".join(one.to_bytes(2, "little", signed=True) for one in numbers)
        body = bytes([self.index]) + self.held + bytes(3)
        return b"\xaa\xaa" + body + bytes([sum(body) % 256])

    def _angles(self) -> list[int]:
        """Yaw, pitch and roll [0.01 deg], turned in this order from the axes of the world."""
        x, y, z = self.up
        yaw = self.yaw + BETWEEN * self._spike()
        found = np.degrees([yaw, -math.asin(x), math.atan2(y, z)]) + self.rng.normal(0, NOISE, 3)
        counts = [round(100 * one) for one in found.tolist()]
        counts[0] = (counts[0] + 18_000) % 36_000 - 18_000
        return [counts[0], max(-9000, min(9000, counts[1])), (counts[2] + 18_000) % 36_000 - 18_000]

    def _spike(self) -> float:
        faults = self.faults
        spike, faults.spike = faults.spike, 0.0
        return spike + faults.spiking * (self.index % 8 == 0)

    def _accelerations(self) -> list[int]:
        """Along x, y, z [mg], of a sensor at rest."""
        return [round(1000 * one + SHAKE * self.rng.normal()) for one in self.up]

    def _sent(self, packet: bytes) -> bytes:
        if self.faults.lost > 0:
            self.faults.lost -= 1
            return b""
        if self.faults.damaged > 0:
            self.faults.damaged -= 1
            return packet[:-1] + bytes([packet[-1] ^ 0x55])
        return packet


def send(line: Line, data: bytes) -> None:
    """Send without waiting: if nobody reads, the bytes are lost, as on a wire."""
    if not data:
        return
    os.set_blocking(line.master, False)
    with contextlib.suppress(BlockingIOError):
        os.write(line.master, data)
    os.set_blocking(line.master, True)


def serve(sensor: Bno085, line: Line, stop: Callable[[], bool]) -> None:
    """Send until `stop` returns True."""
    while not stop():
        send(line, sensor.speak(time.monotonic()))
        if select.select([line.master], [], [], 0.001)[0]:
            os.read(line.master, 256)
