"""What does the main job do? Fish, camera, laptop and pool as processes of their own, in real time.

The same verbs that a lab runs: `rig` stands in for the bench, `laptop` finds the fish in the
camera's pictures and shows the page, `drive` is the fish. Here they are only started, told where
the others are, and ended.
"""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from tailbeat import robot_tasks, track_tasks
from tailbeat.files import BadInput

Say = Callable[[str], None]
VIEWS = 20  # of the board, for the lens
START = 60.0  # s for a process to start
LINGER = 10.0  # s for one to end
ALONE = {"NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "PYTHONUNBUFFERED": "1"}  # one fish
PATIENCE = 40.0  # s for each target, and for the start, before the swim counts as stuck


def calibrate(folder: Path, seed: int, say: Say) -> Path:
    """What a lab does before its first swim: film a board and tags in the water, and calibrate."""
    say(f"calibrating the camera: {VIEWS} views of a board, tags in the water")
    track_tasks.pictures(folder / "lab", VIEWS, seed)
    from tailbeat.pool.film import Filming  # needs the extra
    from tailbeat.swim.tags import Board

    filming = Filming()
    sheet = {"square": Board().square}
    for name, tag in (("fish", filming.fish), ("target", filming.target)):
        sheet |= {f"{name}_side": tag.side, f"{name}_height": tag.height}
    views, survey, pool = (str(folder / "lab" / n) for n in ("views", "survey.csv", "pool.png"))
    made = folder / "camera.json"
    done = track_tasks.calibrate(views, Path(survey), pool, sheet, made, VIEWS, lambda _: None)
    say(f"lens {done['lens_rms_px']:.2f} px, place {done['place_rms_mm']:.1f} mm rms")
    return made


@contextmanager
def started(words: list[str], log: Path) -> Iterator["subprocess.Popen[str]"]:
    """A verb of ours as a process; ended with us, what it said of errors kept in `log`."""
    with log.open("w", encoding="utf-8") as errors:
        process = subprocess.Popen(
            [sys.executable, "-m", "tailbeat", *words],
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
            env={**os.environ, **ALONE},
            start_new_session=True,  # Ctrl-C is for us; we end them in their order
        )
        try:
            yield process
        finally:
            end(process)


def end(process: "subprocess.Popen[str]") -> None:
    """As Ctrl-C would; after ten seconds by force."""
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
    try:
        process.wait(LINGER)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def bench(fish: str, folder: Path, seed: int, stack: ExitStack) -> dict[str, str]:
    """Start the emulated bench with its camera; where its ports are."""
    words = ["rig", "--fish", fish, "--camera", str(folder / "camera.sock"), "--seed", str(seed)]
    process = stack.enter_context(started(words, folder / "rig.log"))
    assert process.stdout is not None
    line = process.stdout.readline()
    if not line:
        said = (folder / "rig.log").read_text(encoding="utf-8").strip()
        raise BadInput(f"the emulated bench did not start: {said or 'it said nothing'}.")
    found: dict[str, str] = json.loads(line)
    return found


def swim(
    policy: str,
    fish: str,
    targets: int,
    seed: int,
    console: str,
    log: Path,
    say: Say,
) -> int:
    """Swim in real time: to `targets` drawn ones (then the end), or with 0 after what the operator
    drags, until Ctrl-C. The fish's log is left at `log`; the exit code of the laptop."""
    robot_tasks.need_extra()
    track_tasks.need_extra()
    from tailbeat.swim import link  # needs the extra

    signal.signal(signal.SIGTERM, signal.default_int_handler)  # what we started ends with us

    with robot_tasks.temporary() as name, ExitStack() as stack:
        folder = Path(name)
        key = folder / "fish.key"
        link.make_key(key)
        made = calibrate(folder, seed, say)
        ports = bench(fish, folder, seed, stack)
        robot, laptop = free_address(), free_address()
        drive = ["drive", policy, "--servo", ports["servo"], "--imu", ports["imu"], "--fish", fish]
        drive += ["--listen", robot, "--laptop", laptop, "--key", str(key), "--log", str(log)]
        drive += ["--seconds", str(PATIENCE * (targets + 1) if targets else 1e9)]
        watch = ["laptop", "--robot", robot, "--listen", laptop, "--key", str(key), "--fish", fish]
        watch += ["--camera", ports["camera"], "--calibration", str(made), "--console", console]
        watch += ["--tour", str(targets), "--seed", str(seed)]
        stack.enter_context(started(drive, folder / "drive.log"))
        above = stack.enter_context(started(watch, folder / "laptop.log"))
        return _listen(above, say)


def free_address() -> str:
    """`host:port` on this machine that nobody uses."""
    from tailbeat.swim import link

    probe = link.bind("127.0.0.1", 0)
    host, port = probe.getsockname()
    probe.close()
    return f"{host}:{port}"


def _listen(above: Any, say: Say) -> int:
    """Say what the laptop says, until it ends or Ctrl-C; then it is asked to end."""
    try:
        for line in above.stdout:
            say(line.rstrip())
    except KeyboardInterrupt:
        say("ending")
        end(above)
    return int(above.wait(LINGER))
