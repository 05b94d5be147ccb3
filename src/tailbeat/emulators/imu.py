"""An emulated BNO055 on a pseudo-terminal: two pages of registers, modes, reset, busy replies.

Independent of the driver. What the data sheet leaves open was not checked on a real sensor.
"""

import math
import os
import select
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from tailbeat.emulators.line import Line
from tailbeat.fish.description import Hardware

COUNT = 16 * 180 / math.pi  # per rad/s
NOISE = 0.3  # deg/s rms, in counts of 16
GRAVITY = 981  # counts of 0.01 m/s^2
CONFIG, LAST = 0x00, 0x6A
PAGE, MODE, TRIGGER = 0x07, 0x3D, 0x3F
WRITABLE = {PAGE, 0x3B, MODE, 0x3E, TRIGGER, 0x40, 0x41, 0x42, *range(0x55, 0x6B)}
WRITABLE_1 = {PAGE, *range(0x08, 0x0E), *range(0x0F, 0x20)}  # of page 1: ranges, interrupts
RESET, RESTART = 0x20, 0.65  # bit of the trigger; s without a reply after it


@dataclass
class Faults:
    """Faults: number of replies that are "bus over-run" (`busy`) or missing (`mute`); a `spike`
    [rad/s] in the next reading, or in every second one (`spiking`); `frozen` numbers."""

    busy: int = 0
    mute: int = 0
    spike: float = 0.0
    spiking: float = 0.0
    frozen: bool = False


@dataclass(eq=False)
class Bno055:
    """The sensor; its owner sets `rates` [rad/s] about its x, y, z, or turns it with `turn`. `up`
    is the direction that points up, in its own axes."""

    rates: tuple[float, float, float] = (0.0, 0.0, 0.0)
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    faults: Faults = field(default_factory=Faults)
    table: bytearray = field(default_factory=lambda: _fresh())
    second: bytearray = field(default_factory=lambda: _fresh_second())
    quiet_until: float = 0.0  # while it restarts
    stream: bytearray = field(default_factory=bytearray)
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))

    def turn(self, yaw: float, rate: float) -> None:
        """The fish's yaw [rad] and yaw rate [rad/s], counter-clockwise from above."""
        x, y, z = self.up
        self.rates = (rate * x, rate * y, rate * z)

    def speak(self, now: float) -> bytes:
        """What it sends without a request: nothing."""
        return b""

    def answer(self, data: bytes) -> bytes:
        """Bytes in, bytes out."""
        if time.monotonic() < self.quiet_until:
            return b""
        self.stream += data
        out = b""
        while len(self.stream) >= 4:
            if self.stream[0] != 0xAA:
                self.stream.clear()
                return out + b"\xee\x06"
            reading, first, length = self.stream[1] == 1, self.stream[2], self.stream[3]
            size = 4 if reading else 4 + length
            if len(self.stream) < size:
                return out
            body = bytes(self.stream[4:size])
            del self.stream[:size]
            out += self._spoilt(self._read(first, length) if reading else self._write(first, body))
        return out

    def _read(self, first: int, length: int) -> bytes:
        if not 0 < length <= 128:
            return b"\xee\x08"
        if first + length > LAST + 1:
            return b"\xee\x04"
        self._sense()
        page = self.second if self.table[PAGE] else self.table
        return bytes([0xBB, length]) + bytes(page[first : first + length])

    def _sense(self) -> None:
        """Write the rates into their registers; zero in configuration mode."""
        if self.faults.frozen:
            return
        faults = self.faults
        spike, faults.spike = faults.spike, 0.0 if faults.spike else faults.spiking
        for axis, (rate, up) in enumerate(zip(self.rates, self.up, strict=True)):
            count = (rate + spike) * COUNT + 16 * NOISE * self.rng.normal()
            self._put(0x14 + 2 * axis, count)
            self._put(0x08 + 2 * axis, GRAVITY * up)

    def _put(self, place: int, count: float) -> None:
        whole = round(count) if self.table[MODE] & 0x0F != CONFIG else 0
        clipped = max(-32768, min(32767, whole))
        self.table[place : place + 2] = clipped.to_bytes(2, "little", signed=True)

    def _write(self, first: int, body: bytes) -> bytes:
        places, later = range(first, first + len(body)), bool(self.table[PAGE])
        if not body or any(place not in (WRITABLE_1 if later else WRITABLE) for place in places):
            return b"\xee\x05"
        free = (PAGE,) if later else (PAGE, MODE, TRIGGER)
        if self.table[MODE] & 0x0F != CONFIG and first not in free:
            return b"\xee\x03"  # other registers only in configuration mode
        if first == PAGE:
            self.table[PAGE] = self.second[PAGE] = body[0] & 1
        elif not later and first == TRIGGER and body[0] & RESET:
            return self._restart()
        else:
            (self.second if later else self.table)[first : first + len(body)] = body
        return b"\xee\x01"

    def _restart(self) -> bytes:
        """Power-up values, and no reply, not even to this."""
        self.table, self.second = _fresh(), _fresh_second()
        self.quiet_until = time.monotonic() + RESTART
        return b""

    def _spoilt(self, reply: bytes) -> bytes:
        if self.faults.mute > 0:
            self.faults.mute -= 1
            return b""
        if self.faults.busy > 0:
            self.faults.busy -= 1
            return b"\xee\x07"
        return reply


def direction(axis: str) -> tuple[float, float, float]:
    """Unit vector of an axis by name, such as "-z"."""
    sign = -1.0 if axis.startswith("-") else 1.0
    x, y, z = (sign * (name == axis[-1]) for name in "xyz")
    return x, y, z


def up_of(hardware: Hardware) -> tuple[float, float, float]:
    """Unit vector that points up in the axes of an IMU that is mounted as a fish's file says."""
    if hardware.imu_rotation is None:
        return direction(hardware.imu_up)
    turned = np.eye(3)
    for axis, angle in enumerate(hardware.imu_rotation):
        a, b = (axis + 1) % 3, (axis + 2) % 3
        once = np.eye(3)
        once[a, a] = once[b, b] = math.cos(angle)
        once[b, a] = math.sin(angle)
        once[a, b] = -once[b, a]
        turned = once @ turned
    x, y, z = turned.T[:, 2].tolist()  # the fish's z, seen from the sensor
    return x, y, z


def _fresh() -> bytearray:
    """Power-up values."""
    table = bytearray(128)
    table[0x00:0x04] = b"\xa0\xfb\x32\x0f"
    table[0x39], table[0x3B] = 5, 0x80
    return table


def _fresh_second() -> bytearray:
    """Power-up values of page 1: ranges and bandwidths of the three sensors."""
    table = bytearray(128)
    table[PAGE] = 1
    table[0x08:0x0B] = b"\x0d\x0b\x38"
    return table


def serve(sensor: Bno055, line: Line, stop: Callable[[], bool]) -> None:
    """Answer until `stop` returns True, with the delay of 115,200 baud."""
    while not stop():
        ready, _, _ = select.select([line.master], [], [], 0.001)
        if not ready:
            continue
        data = os.read(line.master, 256)
        reply = sensor.answer(data)
        if reply:
            time.sleep(10 * (len(data) + len(reply)) / 115_200)
            os.write(line.master, reply)
