"""Fish, camera, station and pool as processes, in real time.

They are the verbs that a lab runs. `emulate` replaces the devices. `station` finds the fish in the
camera's pictures and serves the operator page. `drive` is the fish. They are started, told each
other's addresses, and ended here.
"""

import contextlib
import json
import math
import os
import select
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tailbeat.emulators.film import filming_of
from tailbeat.emulators.lab import miscalibrated, pictures
from tailbeat.files import BadInput
from tailbeat.fish.store import load_fish
from tailbeat.link import datagrams as link
from tailbeat.link.places import POOL, TARGET, as_text, within
from tailbeat.operator.target_path import PathAsked
from tailbeat.pool.mess import lab_at
from tailbeat.processes import end, start_verb, temporary
from tailbeat.vision import calibrate as calibration
from tailbeat.vision.calibration import read_calibration, write_calibration
from tailbeat.vision.tags import Board

Say = Callable[[str], None]
VIEWS = 20  # of the board, for the lens
START = 60.0  # s for a process to start
TURN = 0.2  # s between two checks that all processes run
FINISHED = (0, 1)  # exit codes of a station; 1: a tour or path was not finished
HUNG = 5.0  # s without a sign of life of the station, which gives four a second
# Where the target's tag is, over half of the pool's length and width: in a corner. It floats, and a
# fish hidden below it goes to HOLD.
ASIDE = (-2.5 / 2.75, 1.15 / 1.35)


def calibrate(folder: Path, chain: "Chain", say: Say) -> Path:
    """Calibrate as a lab does before its first swim: film a board and tags in the water. A messy
    lab's calibration is as wrong as `mess` and `seed` say. Raises BadInput."""
    say(f"calibrating the camera: {VIEWS} views of a board, tags in the water")
    seed, filming = chain.seed, filming_of(load_fish(chain.fish), chain.pool)
    pictures(folder / "lab", VIEWS, seed, filming)
    sheet = calibration.Measured(Board().square, filming.fish, filming.target, chain.pool)
    views, survey, pool = (str(folder / "lab" / n) for n in ("views", "survey.csv", "pool.png"))
    made = folder / "camera.json"
    done = calibration.calibrate(views, Path(survey), pool, sheet, made, VIEWS, lambda _: None)
    say(f"lens {done.lens_rms_px:.2f} px, place {done.place_rms_mm:.1f} mm rms")
    wrong = miscalibrated(read_calibration(made), lab_at(chain.mess, seed).errors)
    write_calibration(folder / "used.json", wrong)
    return folder / "used.json"


@dataclass(frozen=True, eq=False)
class Part:
    """A verb as a process; its errors go to `log`."""

    name: str
    process: "subprocess.Popen[str]"
    log: Path

    def last_words(self) -> str:
        """The last line of its log, or a note that there is none."""
        lines = self.log.read_text(encoding="utf-8", errors="replace").split("\n")
        return next((line.strip() for line in reversed(lines) if line.strip()), "it wrote nothing")


@dataclass(eq=False)
class Pulse:
    """Signs of life of a process, as systemd gets them, at the socket `address`; it counts from the
    first one to the announced end."""

    address: str
    line: socket.socket
    last: float = math.inf  # when the last one came [s]

    def silent(self) -> float:
        """How long [s] none has come."""
        with contextlib.suppress(BlockingIOError):
            while True:
                ending = self.line.recv(4096).startswith(b"STOPPING")
                self.last = math.inf if ending else time.monotonic()
        return time.monotonic() - self.last


@contextmanager
def pulse(folder: Path) -> Iterator[Pulse]:
    """Listen for signs of life at a socket in a folder."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as line:
        line.setblocking(False)
        line.bind(str(folder / "alive"))
        yield Pulse(str(folder / "alive"), line)


@contextmanager
def started(words: list[str], log: Path, heard: bool = False, alive: str = "") -> Iterator[Part]:
    """Start a verb; its output goes to its log unless `heard` is set. It gives signs of life to the
    socket `alive`, and ends with this process."""
    with log.open("w", encoding="utf-8") as kept:
        process = start_verb(
            words,
            stdout=subprocess.PIPE if heard else kept,
            stderr=kept,
            env={"PYTHONUNBUFFERED": "1", "NOTIFY_SOCKET": alive},
        )
        try:
            yield Part(words[0], process, log)
        finally:
            end(process)


@dataclass(frozen=True)
class Chain:
    """Who swims: the policy, the fish and the seed of the emulated devices. Host and port of the
    page, and the folder of the log and of every process's output. `start`: pose of the tag at the
    start, as `emulate --start` takes it; "": the pool's middle. `mess`: what the lab gets wrong.
    `pool`: its length and width [m]."""

    policy: str
    fish: str
    seed: int
    page: str
    out: Path
    start: str = ""
    mess: str = "clean"
    pool: tuple[float, float] = POOL


def bench(chain: Chain, folder: Path, stack: ExitStack) -> tuple[Part, Any]:
    """Start the emulated devices with their camera; returns the process and its ports. Raises
    BadInput."""
    words = ["emulate", "--fish", chain.fish, "--camera", str(folder / "camera.sock")]
    words += ["--seed", str(chain.seed), f"--target={within(ASIDE, chain.pool)}"]
    words += [f"--start={chain.start}", "--mess", chain.mess, "--pool", as_text(chain.pool)]
    part = stack.enter_context(started(words, chain.out / "emulate.log", heard=True))
    assert part.process.stdout is not None
    ready, _, _ = select.select([part.process.stdout], [], [], START)
    line = part.process.stdout.readline() if ready else ""
    if not line:
        raise BadInput(f"the emulated devices did not start: {part.last_words()}")
    return part, json.loads(line)


def swim(chain: Chain, targets: int, say: Say) -> None:
    """Swim in real time: to `targets` drawn targets, or with 0 to targets that the operator sets,
    until Ctrl-C.

    Writes the fish's log `swim.mcap`, the tour's `tour.json` and every process's output. Raises
    BadInput if a process ends early.
    """
    tour = ["--tour", str(targets), "--seed", str(chain.seed)]
    tour += ["--json", str(chain.out / "tour.json"), "--policy", chain.policy]
    _run(chain, tour if targets else [f"--begin={within(TARGET, chain.pool)}"], say)


def follow(chain: Chain, asked: PathAsked, say: Say) -> None:
    """Swim in real time after a target that moves by the clock.

    Writes the fish's log `swim.mcap`, what the station saw, `path.json`, and every process's
    output. Raises BadInput if a process ends early.
    """
    words = ["--path", asked.path, "--policy", chain.policy]
    words += ["--json", str(chain.out / "path.json")]
    for option in ("speed", "laps", "seconds"):
        value = getattr(asked, option)
        words += [] if value is None else [f"--{option}", str(value)]
    _run(chain, words, say)


def _run(chain: Chain, leads: list[str], say: Say) -> None:
    """Start everything and wait for the station's end; `leads`: options with which it leads."""
    for number in (signal.SIGTERM, signal.SIGHUP):  # end the processes that we started
        signal.signal(number, signal.default_int_handler)
    with temporary() as name, ExitStack() as stack:
        folder, fish, out = Path(name), chain.fish, chain.out
        key = folder / "fish.key"
        link.make_key(key)
        made = calibrate(folder, chain, say)
        rig, ports = bench(chain, folder, stack)
        robot, station = ("{}:{}".format(*link.free_address()) for _ in range(2))
        drive = ["drive", chain.policy, "--servo", ports["servo"], "--imu", ports["imu"]]
        drive += ["--fish", fish, "--listen", robot, "--station", station, "--key", str(key)]
        drive += ["--wait", "--log", str(out / "swim.mcap")]
        watch = ["station", "--robot", robot, "--listen", station, "--key", str(key)]
        watch += ["--fish", fish, "--camera", ports["camera"], "--calibration", str(made)]
        watch += ["--page", chain.page, *leads]
        own = stack.enter_context(started(drive, out / "drive.log"))
        beats = stack.enter_context(pulse(folder))
        above = stack.enter_context(started(watch, out / "station.log", True, beats.address))
        _listen(above, (rig, own), beats, say)


def _listen(above: Part, others: tuple[Part, ...], beats: Pulse, say: Say) -> None:
    """Repeat the station's output until it ends, or until Ctrl-C, which ends it. Raises BadInput if
    it hangs."""
    spoken = above.process.stdout
    assert spoken is not None
    os.set_blocking(spoken.fileno(), False)
    try:
        while above.process.poll() is None:
            select.select([spoken], [], [], TURN)
            for line in iter(spoken.readline, ""):
                say(line.rstrip())
            for one in others:
                if (code := one.process.poll()) is not None:
                    raise BadInput(f"`{one.name}` ended ({code}): {one.last_words()}")
            if (silence := beats.silent()) > HUNG:
                above.process.kill()
                raise BadInput(f"`station` gave no sign of life for {silence:.0f} s; try it again.")
    except KeyboardInterrupt:
        say("ending")
        end(above.process)
        if above.process.returncode not in FINISHED:
            raise
        return
    for line in iter(spoken.readline, ""):
        say(line.rstrip())
    if above.process.returncode not in FINISHED:
        raise BadInput(f"`station` ended ({above.process.returncode}): {above.last_words()}")
