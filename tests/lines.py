"""An emulated device on a pseudo-terminal, served by a thread, for the tests of the drivers."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from tailbeat.emulators.line import close_line, open_line
from tailbeat.emulators.servo import Dynamixel, serve
from tailbeat.fish.description import Hardware
from tailbeat.fish.store import hardware_of, load_fish
from tailbeat.robot.servo import connect

XW430 = hardware_of(load_fish("pulley-fish"))
PATIENT = 0.25  # s: the emulator is a thread of this process and waits for the interpreter


@contextmanager
def served(serve: Callable[..., None], device: Any) -> Iterator[tuple[str, Callable[[], None]]]:
    """The port that a driver opens, and how to pull its cable."""
    line, ended = open_line(), threading.Event()
    thread = threading.Thread(target=serve, args=(device, line, ended.is_set), daemon=True)
    thread.start()

    def pull() -> None:
        if not ended.is_set():
            ended.set()
            thread.join(2)
            close_line(line)

    yield line.path, pull
    pull()


@dataclass
class Bench:
    """An emulated servo on a line."""

    device: Dynamixel
    path: str
    pull: Callable[[], None]

    @property
    def on(self) -> bool:
        return bool(self.device.get(64))

    def armed(self) -> None:
        servo = connect(self.path, XW430, deadline=PATIENT)
        servo.prepare(-1.4, 1.4)
        servo.arm(2.5)
        servo.port.close()
        assert self.on


@contextmanager
def servo_bench(hardware: Hardware = XW430) -> Iterator[Bench]:
    device = Dynamixel(hardware=hardware)
    with served(serve, device) as (path, pull):
        yield Bench(device, path, pull)
