"""An emulated device on a pseudo-terminal, served by a thread, for the tests of the drivers."""

import re
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tailbeat.emulators.feetech import Feetech
from tailbeat.emulators.line import close_line, open_line
from tailbeat.emulators.servo import Dynamixel, serve
from tailbeat.fish.catalogue import profiles
from tailbeat.fish.description import Hardware
from tailbeat.fish.store import fish_path, hardware_of, load_fish
from tailbeat.robot.servo import connect

XW430 = hardware_of(load_fish("pulley-fish"))
PATIENT = 0.25  # s: the emulator is a thread of this process and waits for the interpreter


def bought(name: str) -> Hardware:
    """A servo of the catalogue."""
    found = profiles()[name].hardware()
    assert found is not None
    return found


STS3215 = bought("sts3215")


def sts_fish(folder: Path) -> Path:
    """The pulley fish as a file, with the STS3215 of the documentation."""
    page = Path(__file__).parents[1] / "docs" / "how-to" / "set-up-the-servo.md"
    (hardware,) = re.findall(r"```toml\n(.*?)```", page.read_text("utf-8"), re.S)
    before, rest = fish_path("pulley-fish").read_text("utf-8").split("[hardware]", 1)
    path = folder / "sts-fish.toml"
    after = "\n[tendons]" + rest.split("[tendons]", 1)[1]
    path.write_text(before + hardware + after, "utf-8")
    return path


@contextmanager
def served(serve: Callable[..., None], device: Any) -> Iterator[tuple[str, Callable[[], None]]]:
    """The port that a driver opens, and how to pull its cable."""
    line, ended = open_line(), threading.Event()
    thread = threading.Thread(target=serve, args=(device, line, ended.is_set), daemon=True)
    thread.start()

    def pull() -> None:
        if not ended.is_set():
            ended.set()
            thread.join()  # first, or it writes into what is opened next under the same number
            close_line(line)

    yield line.path, pull
    pull()


@dataclass
class Bench:
    """An emulated servo on a line."""

    device: Any  # a Dynamixel or a Feetech
    path: str
    pull: Callable[[], None]

    @property
    def on(self) -> bool:
        return bool(self.device.on)

    def armed(self) -> None:
        servo = connect(self.path, self.device.hardware, deadline=PATIENT)
        servo.prepare(-1.4, 1.4)
        servo.arm(2.5)
        servo.port.close()
        assert self.on


@contextmanager
def servo_bench(hardware: Hardware = XW430) -> Iterator[Bench]:
    family = Feetech if hardware.family.startswith("feetech") else Dynamixel
    device = family(hardware=hardware)
    with served(serve, device) as (path, pull):
        yield Bench(device, path, pull)


def heard_by(success: int, call: Callable[..., tuple[int, ...]], *words: int) -> tuple[int, ...]:
    """The answer to a call of Feetech's own library. On a busy machine its 50 ms are too short: it
    asks again."""
    for _ in range(20):
        answer = call(*words)
        if answer[-2] == success:
            return answer
        time.sleep(0.05)
    raise AssertionError(answer)
