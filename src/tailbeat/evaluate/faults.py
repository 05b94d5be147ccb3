"""The fault table: each fault is put into a swimming fish, for real, and the way to safety timed.

The bench (`emulators.faults`) runs in one process and the loop, the very function behind `tailbeat
drive`, in another; faults of bytes, cables and datagrams are made at the bench, those of the loop's
process in it or by signals. What the servo did is seen inside the servo, not believed of the loop.
"""

import math
import multiprocessing
import os
import signal
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from multiprocessing import forkserver
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from tailbeat.emulators.faults import serve_broken
from tailbeat.fish.description import Fish
from tailbeat.link import datagrams as link
from tailbeat.robot.log import read_rows
from tailbeat.robot.ports import Ports
from tailbeat.robot.session import DriveConfig

Drive = Callable[..., Any]  # `robot.session.drive`
Row = dict[str, Any]
SWIMMING = 0.8  # s before something is broken
CALM = 0.3  # s that a tail must be straight, or a swim go on
WAIT = 6.0  # s for a safe state, times the patience
START = 60.0  # s for a process that imports and compiles
TIMES = ("pose_hold", "pose_stop", "imu_hold", "servo_hold", "servo_stop", "clock_doubt")


@dataclass(frozen=True)
class Case:
    """A fault: what happens, where it is made ("bench", "loop" or "signal") and by which name, the
    state that is safe ("run", "hold", "stop", or "gone": the process is, and so is the torque), and
    words of what the operator reads."""

    title: str
    where: str
    name: str
    safe: str
    words: str = ""


CASES = (
    Case("servo's cable pulled, later put back", "bench", "servo cable", "stop", "no servo for"),
    Case("IMU's cable pulled", "bench", "imu cable", "hold", "no yaw rate for"),
    Case("camera gone: poses stop", "bench", "no poses", "hold", "no pose for"),
    Case("link cut both ways", "bench", "link cut", "hold", "no pose for"),
    Case("30 % of datagrams lost", "bench", "loss", "run"),
    Case("datagrams swapped in pairs", "bench", "reordering", "run"),
    Case("old datagrams again", "bench", "replays", "run"),
    Case("20 forged datagrams to each true one", "bench", "forgeries", "run"),
    Case("one IMU spike of 20 rad/s", "bench", "one spike", "run"),
    Case("IMU spikes in every second reading", "bench", "spikes", "run"),
    Case("IMU's numbers stand still", "bench", "imu frozen", "hold", "numbers do not change"),
    Case("servo's encoder stands still", "bench", "encoder frozen", "stop", "does not follow"),
    Case("servo restarts, RAM lost", "bench", "servo restarts", "stop", "lost its torque"),
    Case("servo at 66 deg C", "bench", "warm", "hold", "servo at 66"),
    Case("servo at 76 deg C", "bench", "hot", "stop", "servo at 76"),
    Case("servo shut down, overheated", "bench", "overheated", "stop", "hardware error"),
    Case("supply sags to 9.0 V", "bench", "voltage sags", "hold", "supply 9.0 V"),
    Case("servo's bus watchdog latched", "bench", "watchdog", "hold", "own watchdog"),
    Case("laptop's clock jumps 5 s ahead", "bench", "clock ahead", "hold", "clock jumped"),
    Case("laptop's clock jumps 5 s back", "bench", "clock back", "hold", ""),
    Case("tag read the wrong way round", "bench", "turned round", "hold", "poses in a row"),
    Case("poses 0.6 m off at once", "bench", "elsewhere", "hold", "poses in a row"),
    Case("policy gives NaN", "loop", "nan", "hold", "not a number"),
    Case("loop late by 25 ms in every period", "loop", "overrun", "hold", "periods missed"),
    Case("loop hangs", "loop", "hang", "gone"),
    Case("an exception in the loop", "loop", "exception", "gone"),
    Case("disk full", "loop", "disk full", "hold", "log cannot be written"),
    Case("watchdog killed with -9", "loop", "no watchdog", "hold", "watchdog process is gone"),
    Case("killed with -9", "signal", "SIGKILL", "gone"),
    Case("stopped with Ctrl-Z", "signal", "SIGSTOP", "gone"),
    Case("SIGTERM", "signal", "SIGTERM", "stop", "stop asked by"),
    Case("Ctrl-C", "signal", "SIGINT", "stop", "stop asked by"),
)


# ---- in the loop's process ----------------------------------------------------------------------


class NoNumbers:
    """A network that gives NaN."""

    def __init__(self, size: int) -> None:
        self.size = size

    def run(self, *_: Any) -> list[Any]:
        """As onnxruntime's."""
        return [np.full((1, self.size), np.nan, np.float32)]


def _fill_disk(own: Any) -> None:
    """The log's file becomes one that has no space left."""
    full = os.open("/dev/full", os.O_WRONLY)
    os.dup2(full, own.put.__self__.file.fileno())


def _raise(own: Any) -> None:
    raise RuntimeError("a bug")


def _no_numbers(own: Any) -> None:
    size = own.policy.session.get_outputs()[0].shape[-1]
    own.policy = replace(own.policy, session=NoNumbers(size))


def _kill_watchdog(own: Any) -> None:
    os.kill(own.alive.watcher.process.pid, signal.SIGKILL)


LOOP_FAULTS: dict[str, Callable[[Any], None]] = {
    "nan": _no_numbers,
    "hang": lambda own: time.sleep(30),
    "exception": _raise,
    "disk full": _fill_disk,
    "no watchdog": _kill_watchdog,
}


def _run(pipe: Connection, drive: Drive, config: DriveConfig, patience: float) -> None:
    """The loop's process: says each line with its time, and breaks what it is told to."""
    late = [False]

    def each(own: Any) -> None:
        if own.pace.periods == 0:
            _be_patient(own, patience)
        if late[0]:
            time.sleep(0.025)
        if pipe.poll():
            name = pipe.recv()
            late[0] = name == "overrun"
            pipe.send(("broken", time.monotonic(), name))
            LOOP_FAULTS.get(name, lambda own: None)(own)

    drive(config, lambda line: pipe.send(("said", time.monotonic(), line)), each=each)


def _be_patient(own: Any, patience: float) -> None:
    """Times beyond which it holds or stops, longer: for a machine that is busy otherwise."""
    longer = {name: patience * getattr(own.limits, name) for name in TIMES}
    most = own.limits.overruns_hold if patience == 1 else 20
    own.limits = replace(own.limits, overruns_hold=most, **longer)
    own.devices.servo.deadline *= patience
    own.devices.imu.deadline *= patience


# ---- from outside -------------------------------------------------------------------------------


@dataclass(eq=False)
class Bench:
    """The bench's process: its pipe, the folder with its ports, and how patient the loop is."""

    pipe: Connection
    folder: Path
    key: Path
    context: Any
    patience: float
    swims: int = 0

    def ask(self, *order: Any) -> Any:
        """An order and its answer."""
        self.pipe.send(order)
        return self.pipe.recv()


@contextmanager
def open_bench(fish: Fish, preload: list[str], patience: float = 1.0) -> Iterator[Bench]:
    """A bench that can be broken, in a process of its own; `preload` names what the loop's
    processes import once."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([*preload, "tailbeat.robot.loop", "tailbeat.robot.log"])
    _start_server()
    with tempfile.TemporaryDirectory(prefix="tailbeat-") as name:
        folder = Path(name)
        link.make_key(folder / "key")
        ours, theirs = context.Pipe()
        words = (theirs, fish, link.read_key(folder / "key"), folder)
        process = context.Process(target=serve_broken, args=words, daemon=True)
        process.start()
        theirs.close()
        assert ours.poll(START) and ours.recv() == "ready", "the bench did not start"
        yield Bench(ours, folder, folder / "key", context, patience)
        ours.send(("over",))
        process.join(5)


def _start_server() -> None:
    """The processes' common parent; one fish needs no pool of threads, which would wait for each
    other on a busy machine."""
    before = os.environ.get("NUMBA_NUM_THREADS")
    os.environ["NUMBA_NUM_THREADS"] = "1"
    try:
        forkserver.ensure_running()
    finally:
        del os.environ["NUMBA_NUM_THREADS"]
        if before is not None:
            os.environ["NUMBA_NUM_THREADS"] = before


@dataclass(eq=False)
class Swim:
    """A loop's process that swims on the bench; `lines` are the states it said, with their time."""

    process: Any
    pipe: Connection
    log: Path
    lines: list[tuple[float, str]]
    broken: float = math.nan

    def listen(self, seconds: float = 0.02) -> None:
        """Take in what it says."""
        try:
            while self.pipe.poll(seconds):
                kind, when, text = self.pipe.recv()
                seconds = 0.0
                if kind == "said":
                    self.lines.append((when, text.split(" s  ", 1)[-1]))
                else:
                    self.broken = when
        except (EOFError, OSError):
            time.sleep(seconds)

    @property
    def state(self) -> str:
        """The last one it said."""
        return self.lines[-1][1].split(":")[0] if self.lines else ""


@contextmanager
def swimming(bench: Bench, policy: str, drive: Drive) -> Iterator[Swim]:
    """A loop that swims on a fresh rig. Raises RuntimeError where it does not come to swim."""
    robot = link.free_address()
    laptop = bench.ask("new", robot)
    bench.swims += 1
    log = bench.folder / f"{bench.swims}.mcap"
    ports = Ports(str(bench.folder / "servo"), str(bench.folder / "imu"), robot, laptop)
    ours, theirs = bench.context.Pipe()
    config = DriveConfig(policy, ports, bench.key, log, seconds=1e3)
    process = bench.context.Process(target=_run, args=(theirs, drive, config, bench.patience))
    process.start()
    theirs.close()
    swim = Swim(process, ours, log, [])
    try:
        _wait(swim, lambda: swim.state == "run" or not process.is_alive(), START)
        if swim.state != "run":
            raise RuntimeError(f"the fish did not come to swim: {swim.lines}")
        yield swim
    finally:
        _end(process)
        bench.ask("end")


def _end(process: Any) -> None:
    if process.is_alive():
        os.kill(process.pid, signal.SIGCONT)
        process.terminate()
        process.join(3)
    if process.is_alive():
        process.kill()
        process.join()


def _wait(swim: Swim, done: Callable[[], bool], seconds: float) -> bool:
    """Listen until it is so; whether it came to that in time."""
    end = time.monotonic() + seconds
    while not done():
        if time.monotonic() > end:
            return False
        swim.listen()
    return True


def measure(case: Case, bench: Bench, policy: str, drive: Drive, tries: int = 3) -> Row:
    """One fault in one swim: a row of the table. Where the outcome is not the one that is safe it
    is tried again, and `tries` says so: on a busy machine a loop may hold by itself."""
    row: Row = {}
    for attempt in range(1, tries + 1):
        try:
            with swimming(bench, policy, drive) as swim:
                _wait(swim, lambda: False, SWIMMING)
                row = {**_row(case, bench, swim, _break(case, bench, swim)), "tries": attempt}
        except RuntimeError as error:
            row = {**_nothing(case, str(error)), "tries": attempt}
        if row["ok"]:
            break
    return row


def _nothing(case: Case, why: str) -> Row:
    """The row of a fish that did not come to swim."""
    times = {"told_s": None, "safe_s": None, "ok": False, "log_lost_s": None}
    return {"fault": case.title, "operator sees": why, "safe state": case.safe, **times}


def _break(case: Case, bench: Bench, swim: Swim) -> float:
    """Break it; when that was [s]."""
    if case.where == "bench":
        return float(bench.ask("break", case.name))
    if case.where == "signal":
        os.kill(swim.process.pid, signal.Signals[case.name])
        return time.monotonic()
    swim.pipe.send(case.name)
    _wait(swim, lambda: not math.isnan(swim.broken), WAIT)
    return swim.broken


def _row(case: Case, bench: Bench, swim: Swim, broken: float) -> Row:
    began, safe_at = broken, _safe_at(case, bench, swim, broken)
    if case.name == "servo cable":  # nobody can tell the servo anything until then
        began = bench.ask("plug")
        safe_at = _safe_at(replace(case, safe="gone"), bench, swim, began)
    since = [(when - broken, text) for when, text in swim.lines if when >= broken]
    told = next(((when, text) for when, text in since if _is(case, text)), None)
    seen = told or (since or [(0.0, swim.lines[-1][1])])[0]
    return {
        "fault": case.title,
        "operator sees": seen[1],
        "safe state": {"gone": "torque off", "stop": "stop: torque off"}.get(case.safe, case.safe),
        "told_s": told[0] if told else None,
        "safe_s": None if math.isnan(safe_at) else max(safe_at - began, 0.0),
        "ok": not math.isnan(safe_at) and (told is not None or case.safe in ("gone", "run")),
        "log_lost_s": _lost(swim.log, broken) if case.name == "SIGKILL" else None,
    }


def _is(case: Case, text: str) -> bool:
    """Whether a line is the one that the fault should lead to."""
    return text.startswith(case.safe) and case.words in text


def _safe_at(case: Case, bench: Bench, swim: Swim, broken: float) -> float:
    """When the servo was safe: let go, straight, or still swimming as it should; NaN if never."""
    found = [math.nan]

    def safe() -> bool:
        look, on = bench.ask("look")
        now = time.monotonic()
        if case.safe == "run":
            found[0] = broken if now - broken > 5 * CALM and swim.state == "run" else math.nan
        elif case.safe == "hold":
            calm = on and swim.state == "hold" and now - look.straight > CALM
            found[0] = look.straight if calm else math.nan
        elif case.name == "servo cable" and case.safe == "stop":
            found[0] = now if swim.state == "stop" else math.nan
        else:
            found[0] = look.off if not on else math.nan
        return not math.isnan(found[0])

    _wait(swim, safe, WAIT * bench.patience)
    if case.safe in ("stop", "hold"):  # the line may still be on its way
        _wait(swim, lambda: swim.state == case.safe or not swim.process.is_alive(), 1.0)
        swim.listen()
    return found[0]


def _lost(log: Path, killed: float) -> float:
    """How long before its end [s] a log's last whole row lies."""
    return killed - float(read_rows(log)[-1]["time_s"])


def kill_at_random(
    times: int, bench: Bench, policy: str, drive: Drive, rng: np.random.Generator
) -> list[Row]:
    """The loop's process is killed with -9, each time at another moment of its swim; one row each:
    when, how soon the torque was off, how much of the log is missing."""
    rows: list[Row] = []
    while len(rows) < times:
        with swimming(bench, policy, drive) as swim:
            swum = float(rng.uniform(0.0, 1.0))
            _wait(swim, lambda: False, swum)
            os.kill(swim.process.pid, signal.SIGKILL)
            killed = time.monotonic()
            off = _safe_at(Case("", "", "", "gone"), bench, swim, killed)
            row = {"swum_s": swum, "off_s": off - killed, "log_lost_s": _lost(swim.log, killed)}
            rows.append(row)
    return rows
