"""Real faults of the emulated devices: bytes, cables, datagrams, clocks.

Each fault is a function of the rig; `FAULTS` names them. `serve_broken` serves a rig in its own
process. It is told over a pipe which fault to make, and answers with what the servo did and when.
Torque and goal are read inside the servo, a thousand times a second.
"""

import gc
import secrets
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from tailbeat.emulators import rig as bench
from tailbeat.emulators.line import close_line, link_lines, open_line, unlink_lines
from tailbeat.emulators.plant_shaft import PlantShaft
from tailbeat.emulators.rig import Rig
from tailbeat.emulators.servo import Dynamixel
from tailbeat.fish.description import Fish
from tailbeat.robot import timing

CENTRE = 2048
AT_REST = 30  # counts from straight that count as straight: 2.6 degrees
NOWHERE = ("127.0.0.1", 9)


@dataclass(eq=False)
class Network:
    """The station's socket with a bad network: datagrams `lost` (a fraction), one delayed behind
    the next (`swapped`), old ones repeated (`replayed`), altered or random ones added (`forged` per
    true one). `cut`: nothing passes."""

    socket: socket.socket
    rng: np.random.Generator
    lost: float = 0.0
    swapped: bool = False
    replayed: bool = False
    forged: int = 0
    cut: bool = False
    held: list[tuple[bytes, Any]] = field(default_factory=list)
    past: list[bytes] = field(default_factory=list)

    def fileno(self) -> int:
        """For `select`."""
        return self.socket.fileno()

    def recvfrom(self, size: int) -> tuple[bytes, Any]:
        """What the fish sent, unless the link is cut."""
        while True:
            data, sender = self.socket.recvfrom(size)
            if not self.cut and self.rng.uniform() >= self.lost:
                return data, sender

    def sendto(self, data: bytes, to: Any) -> None:
        """Send to the fish, or lose it."""
        if self.cut or self.rng.uniform() < self.lost:
            return
        if self.swapped and not self.held:
            self.held.append((data, to))
            return
        for one, where in [(data, to), *self.held, *self._strange(data, to)]:
            self.socket.sendto(one, where)
        self.held.clear()

    def _strange(self, data: bytes, to: Any) -> list[tuple[bytes, Any]]:
        self.past = [*self.past[-200:], data]
        made = [(secrets.token_bytes(len(data)), to) for _ in range(self.forged // 2)]
        for _ in range(self.forged - self.forged // 2):
            altered = bytearray(data)
            altered[self.rng.integers(len(data))] ^= 1 << self.rng.integers(8)
            made.append((bytes(altered), to))
        again = [(self.past[self.rng.integers(len(self.past))], to)] if self.replayed else []
        return made + again

    def getsockname(self) -> Any:
        """Where it is bound."""
        return self.socket.getsockname()

    def close(self) -> None:
        """Close the socket."""
        self.socket.close()


def _servo(rig: Rig) -> Dynamixel:
    """The rig's servo; the faults are those of a Dynamixel."""
    assert isinstance(rig.servo, Dynamixel)
    return rig.servo


def _unplug(rig: Rig, index: int) -> None:
    """End a line and open a new one, to which no link points yet."""
    lines = list(rig.lines)
    close_line(lines[index])
    lines[index] = open_line()
    rig.lines = (lines[0], lines[1])


def _network(rig: Rig, **bad: Any) -> None:
    for name, value in bad.items():
        setattr(rig.station.socket, name, value)


def _restart(rig: Rig) -> None:
    _servo(rig).reboot()


def _spike(rig: Rig) -> None:
    rig.imu.faults.spike = 20.0  # rad/s, once


def _spikes(rig: Rig) -> None:
    rig.imu.faults.spiking = 20.0


def _turned_round(rig: Rig) -> None:
    rig.station.shifted = (0.0, 0.0, np.pi)


def _elsewhere(rig: Rig) -> None:
    rig.station.shifted = (0.6, 0.0, 0.0)


def _stand_still(rig: Rig) -> None:
    rig.imu.faults.frozen = True


def _stick(rig: Rig) -> None:
    _servo(rig).faults.frozen = True


def _dip(rig: Rig) -> None:
    _servo(rig).put(144, 97)
    _servo(rig).faults.dip_until = _servo(rig).now + 0.02


def _broken(rig: Rig, **bad: Any) -> None:
    for name, value in bad.items():
        setattr(rig.shaft.broken, name, value)


def _tracker(rig: Rig, **bad: Any) -> None:
    for name, value in bad.items():
        setattr(rig.station.faults, name, value)


def _upside_down(rig: Rig) -> None:
    rig.imu_up = -1


def _biased(rig: Rig) -> None:
    rig.imu_bias, rig.imu_biased = 0.5, time.monotonic()


def _askew(rig: Rig) -> None:
    rig.station.shifted = (0.0, 0.0, np.pi / 2)


FAULTS: dict[str, Callable[[Rig], None]] = {
    "servo cable": lambda rig: _unplug(rig, 0),
    "imu cable": lambda rig: _unplug(rig, 1),
    "no poses": lambda rig: setattr(rig.station, "due", np.inf),
    "link cut": lambda rig: _network(rig, cut=True),
    "loss": lambda rig: _network(rig, lost=0.3),
    "reordering": lambda rig: _network(rig, swapped=True),
    "replays": lambda rig: _network(rig, replayed=True),
    "forgeries": lambda rig: _network(rig, forged=20),
    "one spike": _spike,
    "spikes": _spikes,
    "imu frozen": _stand_still,
    "encoder frozen": _stick,
    "servo restarts": _restart,
    "warm": lambda rig: _servo(rig).put(146, 66),
    "hot": lambda rig: _servo(rig).put(146, 76),
    "overheated": lambda rig: _servo(rig).fail(2),
    "voltage sags": lambda rig: _servo(rig).put(144, 97),
    "voltage fails": lambda rig: _servo(rig).put(144, 90),
    "voltage dips": _dip,
    "watchdog": lambda rig: _servo(rig).trip(),
    "clock ahead": lambda rig: setattr(rig.station, "stepped", 5.0),
    "clock back": lambda rig: setattr(rig.station, "stepped", -5.0),
    "turned round": _turned_round,
    "elsewhere": _elsewhere,
    "tail reversed": lambda rig: _broken(rig, reversed=True),
    "half stroke": lambda rig: _broken(rig, stroke=0.5),
    "horn slips": lambda rig: _broken(rig, slipping=0.5),
    "tendon snapped": lambda rig: rig.shaft.snap(),
    "left tendon cut": lambda rig: rig.shaft.snap(right=False),
    "right tendon cut": lambda rig: rig.shaft.snap(left=False),
    "held still": lambda rig: rig.shaft.hold(),
    "encoder 30 %": lambda rig: setattr(rig.servo.faults, "shown", 0.3),
    "encoder 20 %": lambda rig: setattr(rig.servo.faults, "shown", 0.2),
    "picture mirrored": lambda rig: _tracker(rig, mirrored=True),
    "places mirrored": lambda rig: _tracker(rig, mirrored_at=float(rig.shaft.pose[0])),
    "pose frozen": lambda rig: _tracker(rig, frozen=True),
    "target jumps": lambda rig: _tracker(rig, jumping=0.5),
    "camera drifts": lambda rig: _tracker(rig, drifting=time.monotonic()),
    "tag askew": _askew,
    "imu upside down": _upside_down,
    "imu biased": _biased,
}


UNPLUGGED = {"servo cable": ("servo",), "imu cable": ("imu",)}  # links that a fault takes away


@dataclass(eq=False)
class Look:
    """What the servo did since a fault was made; times [s] monotonic, NaN: not yet."""

    broken: float = float("nan")
    off: float = float("nan")  # torque was off
    straight: float = float("nan")  # torque was on, and the goal was straight again


def _watch(rig: Rig, look: Look) -> None:
    now, on = time.monotonic(), _servo(rig).get(64)
    near = abs(_servo(rig).get(116, True) - CENTRE) <= AT_REST
    if on:
        look.off = float("nan")
    elif np.isnan(look.off):
        look.off = now
    if not (on and near):
        look.straight = float("nan")
    elif np.isnan(look.straight):
        look.straight = now


def serve_broken(pipe: Connection, fish: Fish, key: bytes) -> None:
    """Serve rigs, one after the other, until the pipe closes.

    Orders: ("new", robot, fault, folder) opens a rig, with a fault unless it is "", links its ports
    in the folder and answers with the station's address; ("break", name) answers with the time;
    ("plug",) reconnects both cables; ("look",) answers with a `Look` and whether torque is on;
    ("end",) closes the rig.
    """
    timing.claim(timing.BESIDE)
    warm = PlantShaft(fish=fish)  # compiled once, before anyone waits for it
    warm.advance(0.0, 0.01)
    _ = warm.pose
    gc.freeze()
    gc.disable()
    pipe.send("ready")
    while (order := pipe.recv())[0] == "new":
        robot, fault, folder = order[1:]
        rig = bench.open_rig(fish, key, robot, (1.5, 0.5))
        if fault:
            FAULTS[fault](rig)
        own = rig.station.sender
        own.socket = Network(own.socket, np.random.default_rng(0))  # type: ignore
        link_lines(rig.lines, folder)
        pipe.send(rig.station.socket.getsockname())
        _serve(pipe, rig, folder)
        unlink_lines(folder)
        bench.close_rig(rig)
        pipe.send("closed")


def _serve(pipe: Connection, rig: Rig, folder: Path) -> None:
    look, ended = Look(), [False]

    def order() -> bool:
        """Called every millisecond; returns whether the lines changed or the rig is to close."""
        _watch(rig, look)
        if not pipe.poll():
            return False
        match pipe.recv():
            case ("break", name):
                look.broken = time.monotonic()
                unlink_lines(folder, UNPLUGGED.get(name, ()))
                FAULTS[name](rig)
                pipe.send(look.broken)
            case ("plug",):
                link_lines(rig.lines, folder)
                pipe.send(time.monotonic())
            case ("look",):
                pipe.send((look, bool(_servo(rig).get(64))))
            case ("end",):
                ended[0] = True
        return True

    while not ended[0]:
        bench.serve(rig, order)  # again after each order: the lines may have changed
