"""What does the laptop do? Camera to poses, poses to the fish, orders and readings to the page."""

import select
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

from tailbeat.files import BadInput
from tailbeat.fish.store import load_fish
from tailbeat.robot_tasks import open_console

Say = Callable[[str], None]
TURN = 0.002  # s that a turn waits for the fish's word: the clock's answer must not
FAREWELL = 1.0  # s to have the order to stop taken at the end
NO_CAMERA = "No camera given: the fish gets no poses."


@contextmanager
def open_tracker(camera: str, calibration: Path | None) -> Iterator[Any]:
    """A tracker in a process beside (`newest`, `picture`, `fault`), or None without a camera.
    Raises BadInput."""
    if not camera:
        yield None
        return
    if calibration is None:
        raise BadInput("--camera: give its --calibration, made by `tailbeat calibrate`.")
    read = import_module("tailbeat.swim.calibration").read_calibration
    tracker = import_module("tailbeat.swim.tracking").start_tracker(camera, read(calibration))
    try:
        yield tracker
    finally:
        tracker.close()


def laptop(
    robot: tuple[str, int],
    listen: tuple[str, int],
    key: Path,
    console: str,
    tracker: Any,
    fish: str,
    say: Say,
) -> None:
    """Send what the tracker sees and serve the page until told to end; then order the fish to
    stop, for nobody watches it any more. Raises BadInput."""
    from tailbeat.swim import link  # needs the extra
    from tailbeat.swim.console.desk import announce
    from tailbeat.swim.sender import Sender

    described, secret = load_fish(fish), link.read_key(key)
    made = link.bind(*listen)
    desk = open_console(console)
    for line in announce(desk) if desk else []:
        say(line)
    ended: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda n, _: ended.append(n))
    sender = Sender(secret, made, robot)
    try:
        _work(sender, tracker, desk, described, lambda: bool(ended), say)
        _farewell(sender, say)
    finally:
        made.close()
        if desk is not None:
            desk.close()


def _work(
    sender: Any, tracker: Any, desk: Any, fish: Any, over: Callable[[], bool], say: Say
) -> None:
    """Turn by turn; says every change of the fish's state."""
    from tailbeat.swim.console.desk import turn

    sent, told = -1, ""
    while not over():
        select.select([sender.socket], [], [], TURN)
        now = time.monotonic()
        sighting = tracker.newest() if tracker else None
        if sighting is not None and sighting.frame.captured != sent:
            sent = sighting.frame.captured
            sender.show(sighting.frame)
        sender.work(now)
        if desk is not None:
            note = tracker.fault if tracker else NO_CAMERA
            turn(desk, sender, fish, now, note, b"" if note else tracker.picture())
        if (line := _line(sender)) != told:
            told = line
            say(line)


def _line(sender: Any) -> str:
    status = sender.status
    return "" if status is None else f"{status.state.value}: {status.reason}"


def _farewell(sender: Any, say: Say) -> None:
    """The fish stops before its poses end."""
    from tailbeat.swim.link import Order

    if sender.status is None:
        return
    sender.order(Order.STOP, time.monotonic())
    end = time.monotonic() + FAREWELL
    while sender.pending and time.monotonic() < end:
        select.select([sender.socket], [], [], TURN)
        sender.work(time.monotonic())
    say(sender.said)
