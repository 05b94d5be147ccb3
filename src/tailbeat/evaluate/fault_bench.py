"""The processes of the fault table: emulated devices with faults, and a loop that swims on them.

The emulated devices (`emulators.faults`) run in one process. The loop, the same function as in
`tailbeat drive`, runs in another. Faults of the loop are made in its own process.
"""

import contextlib
import math
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from tailbeat.emulators.faults import serve_broken
from tailbeat.fish.description import Fish
from tailbeat.link import datagrams as link
from tailbeat.processes import fork_server, temporary
from tailbeat.robot.ports import Ports
from tailbeat.robot.session import DriveConfig

Drive = Callable[..., Any]  # `robot.session.drive`
START = 60.0  # s for a process to import and compile
TIMES = ("pose_hold", "pose_stop", "imu_hold", "servo_hold", "servo_stop", "clock_doubt")


class NoNumbers:
    """A network whose output is NaN."""

    def __init__(self, size: int) -> None:
        self.size = size

    def run(self, *_: Any) -> list[Any]:
        """Same call as onnxruntime's."""
        return [np.full((1, self.size), np.nan, np.float32)]


def _fill_disk(own: Any) -> None:
    """Replace the log's file by one without free space."""
    full = os.open("/dev/full", os.O_WRONLY)
    os.dup2(full, own.put.__self__.file.fileno())


def _raise(own: Any) -> None:
    raise RuntimeError("a bug")


def _no_numbers(own: Any) -> None:
    size = own.policy.session.get_outputs()[0].shape[-1]
    own.policy = replace(own.policy, session=NoNumbers(size))


def _kill_watchdog(own: Any) -> None:
    os.kill(own.alive.watcher.process.pid, signal.SIGKILL)


def _stop_watchdog(own: Any) -> None:
    os.kill(own.alive.watcher.process.pid, signal.SIGSTOP)


def _stop_both(own: Any) -> None:
    """The watchdog hangs; before the loop can notice it, it is killed too."""
    _stop_watchdog(own)
    threading.Timer(0.1, lambda: os.kill(os.getpid(), signal.SIGKILL)).start()


LOOP_FAULTS: dict[str, Callable[[Any], None]] = {
    "nan": _no_numbers,
    "hang": lambda own: time.sleep(30),
    "exception": _raise,
    "disk full": _fill_disk,
    "no watchdog": _kill_watchdog,
    "stopped watchdog": _stop_watchdog,
    "both": _stop_both,
}


def _run(pipe: Connection, drive: Drive, config: DriveConfig, patience: float) -> None:
    """The loop's process: sends each line with its time, and makes the faults that it is told."""
    late = [False]

    def each(own: Any) -> None:
        if own.pace.periods == 0:
            _be_patient(own, patience)
        if late[0]:
            time.sleep(0.025)
        if pipe.poll():
            name = pipe.recv()
            late[0] = name == "overrun"
            pipe.send(("broken", time.monotonic(), own.alive.watcher.process.pid))
            LOOP_FAULTS.get(name, lambda own: None)(own)

    drive(config, lambda line: pipe.send(("said", time.monotonic(), line)), each=each)


def _be_patient(own: Any, patience: float) -> None:
    """Lengthen the times to HOLD and STOP, for a machine that is busy with other work."""
    longer = {name: patience * getattr(own.limits, name) for name in TIMES}
    most = own.limits.overruns_hold if patience == 1 else 20
    own.limits = replace(own.limits, overruns_hold=most, **longer)
    own.devices.servo.deadline *= patience
    if own.devices.imu is not None:
        own.devices.imu.deadline *= patience


# ---- from outside -------------------------------------------------------------------------------


@dataclass(eq=False)
class Bench:
    """The emulators' process: its pipe, the folder with a folder per swim for ports and log, and
    the factor `patience` on the loop's times."""

    pipe: Connection
    folder: Path
    key: Path
    context: Any
    patience: float
    swims: int = 0

    def ask(self, *order: Any) -> Any:
        """Send an order and return its answer."""
        self.pipe.send(order)
        return self.pipe.recv()


@contextmanager
def open_bench(fish: Fish, preload: list[str], patience: float = 1.0) -> Iterator[Bench]:
    """Start emulated devices that can be given faults, in their own process. `preload` names
    modules that the loop's processes import once."""
    context = fork_server([*preload, "tailbeat.robot.loop", "tailbeat.robot.log"])
    with temporary() as name:
        folder = Path(name)
        link.make_key(folder / "key")
        ours, theirs = context.Pipe()
        words = (theirs, fish, link.read_key(folder / "key"))
        process = context.Process(target=serve_broken, args=words, daemon=True)
        process.start()
        theirs.close()
        assert ours.poll(START) and ours.recv() == "ready", "the bench did not start"
        yield Bench(ours, folder, folder / "key", context, patience)
        ours.send(("over",))
        process.join(5)


@dataclass(eq=False)
class Swim:
    """A loop's process that swims; `lines` are its reported states, with their times. `watchdog` is
    the id of its watchdog process, known from a fault of the loop on (0: not known)."""

    process: Any
    pipe: Connection
    log: Path
    lines: list[tuple[float, str]]
    broken: float = math.nan
    watchdog: int = 0

    def listen(self, seconds: float = 0.02) -> None:
        """Receive its reports."""
        try:
            while self.pipe.poll(seconds):
                kind, when, text = self.pipe.recv()
                seconds = 0.0
                if kind == "said":
                    self.lines.append((when, text.split(" s  ", 1)[-1]))
                else:
                    self.broken, self.watchdog = when, text
        except (EOFError, OSError):
            time.sleep(seconds)

    @property
    def state(self) -> str:
        """The last reported state."""
        return self.lines[-1][1].split(":")[0] if self.lines else ""


@contextmanager
def swimming(bench: Bench, policy: str, drive: Drive, fault: str = "") -> Iterator[Swim]:
    """Start a loop that swims on a new rig, without the sign test. With a `fault` the rig has it
    from the start: the loop does the sign test and is waited for until it ends. Raises RuntimeError
    if it does not start to swim."""
    robot = link.free_address()
    bench.swims += 1
    own = bench.folder / str(bench.swims)  # what is left of an earlier swim cannot find it
    own.mkdir()
    station = bench.ask("new", robot, fault, own)
    log = own / "swim.mcap"
    ports = Ports(str(own / "servo"), str(own / "imu"), robot, station)
    ours, theirs = bench.context.Pipe()
    config = DriveConfig(policy, ports, bench.key, log, seconds=1e3, sign_test=bool(fault))
    process = bench.context.Process(target=_run, args=(theirs, drive, config, bench.patience))
    process.start()
    theirs.close()
    swim = Swim(process, ours, log, [])
    try:
        began = ("run", "stop") if fault else ("run",)
        over = (*began, "hold")  # nobody arms it again
        wait(swim, lambda: swim.state in over or not process.is_alive(), START)
        if swim.state not in began:
            raise RuntimeError(f"the fish did not start to swim: {swim.lines}")
        yield swim
    finally:
        _end(process)
        if swim.watchdog:  # one that was stopped would stay
            with contextlib.suppress(ProcessLookupError):
                os.kill(swim.watchdog, signal.SIGKILL)
        bench.ask("end")


def _end(process: Any) -> None:
    if process.is_alive():
        os.kill(process.pid, signal.SIGCONT)
        process.terminate()
        process.join(3)
    if process.is_alive():
        process.kill()
        process.join()


def wait(swim: Swim, done: Callable[[], bool], seconds: float) -> bool:
    """Receive until `done()` is true; returns whether that was in time."""
    end = time.monotonic() + seconds
    while not done():
        if time.monotonic() > end:
            return False
        swim.listen()
    return True
