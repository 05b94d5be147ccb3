"""The poolside station: camera to poses, poses to the fish, orders and readings for the operator
page."""

import select
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tailbeat.files import BadInput
from tailbeat.fish.description import Fish
from tailbeat.fish.store import load_fish
from tailbeat.link import datagrams as link
from tailbeat.link.clock import SECOND
from tailbeat.link.datagrams import Order
from tailbeat.link.places import POOL
from tailbeat.link.sender import Sender
from tailbeat.operator.client import OperatorClient, announce, open_page, turn
from tailbeat.operator.leader import Leader
from tailbeat.processes import told_to_end
from tailbeat.robot import systemd
from tailbeat.vision.moved import warning

if TYPE_CHECKING:  # needs OpenCV
    from tailbeat.vision.tracking import TrackerProcess

Say = Callable[[str], None]
TURN = 0.002  # s that a turn waits for a datagram; longer would delay the clock's answer
FAREWELL = 1.0  # s for the robot to take the order to stop at the end
NO_CAMERA = "No camera given: the fish gets no poses."


@contextmanager
def open_tracker(
    camera: str, calibration: Path | None, ids: tuple[int, int], exposure: float, latency: float
) -> "Iterator[TrackerProcess | None]":
    """Start a tracker process, or yield None without a camera. `ids` of fish and target; `exposure`
    and `latency` of the camera [s]. Raises BadInput."""
    if not camera:
        yield None
        return
    if calibration is None:
        raise BadInput("--camera needs --calibration: give the file of `tailbeat calibrate`.")
    from tailbeat.vision.follow import TrackConfig, watch  # needs OpenCV

    tracker = watch(TrackConfig(camera, calibration, ids, exposure, latency))
    try:
        yield tracker
    finally:
        tracker.close()


@dataclass(frozen=True)
class StationConfig:
    """A station: host and port of the robot and its own, the key's file, host:port of the operator
    page ("": none), and the fish to draw (a file or a name)."""

    robot: tuple[str, int]
    listen: tuple[str, int]
    key: Path
    page: str = ""
    fish: str = "pulley-fish"


def pool_of(tracker: "TrackerProcess | None", say: Say) -> tuple[float, float]:
    """Length and width of the pool [m] from the tracker's calibration; reports if the file does not
    have them."""
    known = tracker.watching.calibration.pool if tracker else POOL
    if known is None:
        say(f"calibration: it has no pool size; {POOL[0]:g} by {POOL[1]:g} m is assumed;"
            " calibrate again with --pool")  # fmt: skip
    return known or POOL


def work(
    config: StationConfig, tracker: "TrackerProcess | None", leader: Leader | None, say: Say
) -> None:
    """Send the tracker's poses and serve the page until told to end, or a tour or path is over.

    Then order the robot to stop, because nobody watches it any more. Raises BadInput.
    """
    described, secret = load_fish(config.fish), link.read_key(config.key)
    made, pool = link.bind(*config.listen), pool_of(tracker, say)
    _compare_tags(tracker, described, say)
    client = open_page(config.page, pool)
    ended = told_to_end(signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    for line in announce(client) if client else []:
        say(line)
    sender = Sender(secret, made, config.robot, pool=pool, calibration=_digest(tracker))
    station = Station(sender, tracker, client, described)
    over = lambda: bool(ended) or (leader is not None and leader.over())  # noqa: E731
    try:
        _turns(station, leader, over, say)
    finally:
        _farewell(station.sender, say)
        made.close()
        if client is not None:
            client.close()


def _compare_tags(tracker: "TrackerProcess | None", fish: Fish, say: Say) -> None:
    """Say if the camera was calibrated for a tag of another size than the fish has."""
    if tracker is None:
        return
    from tailbeat.vision.tags import of_other_size  # needs OpenCV

    if other := of_other_size(tracker.watching.calibration.fish, fish.tag):
        say(f"calibration: {other}; calibrate again with --fish")


def _digest(tracker: "TrackerProcess | None") -> bytes:
    """The SHA-256 of the tracker's calibration, which the fish's log names."""
    return tracker.watching.calibration.digest if tracker else link.NO_CAMERA


@dataclass(frozen=True, eq=False)
class Station:
    """The parts of a running station."""

    sender: Sender
    tracker: "TrackerProcess | None"
    client: OperatorClient | None
    fish: Fish


def _turns(station: Station, leader: Leader | None, over: Callable[[], bool], say: Say) -> None:
    """Run the station; reports every change of the robot's state, and every fault of the tracker
    and of the page's server. Who started it may listen whether it runs, as systemd does."""
    sender, tracker, sent = station.sender, station.tracker, -1
    notifier = systemd.from_environment()
    told = dict.fromkeys(("", "camera: "), "")
    note = ""
    while not over():
        select.select([sender.socket], [], [], TURN)
        now = time.monotonic()
        sighting = tracker.newest() if tracker else None
        if sighting is not None and sighting.frame.captured != sent:
            sent = sighting.frame.captured
            if leader is not None:
                leader.lead(sender, sighting.frame.fish, now, say, sent / SECOND)
            sender.show(sighting.frame)
            note = warning(sighting.moved)
        sender.work(now)
        notifier.beat(now, _line(sender))
        if news := _show(station, now, note):
            say(news)
        camera = (tracker.fault or note) if tracker else ""
        for kind, line in (("", _line(sender)), ("camera: ", camera)):
            if line != told[kind]:
                told[kind] = line
                say(f"{kind}{line or 'frames arrive'}")
    notifier.end()


def _show(station: Station, now: float, moved: str) -> str:
    """Serve the page, if there is one; returns what happened to its server, "" for nothing. `moved`
    warns of a camera that moved."""
    tracker = station.tracker
    if station.client is None:
        return ""
    note = tracker.fault if tracker else NO_CAMERA
    picture = tracker.picture() if tracker and not note else b""
    note = note or moved
    return turn(station.client, station.sender, station.fish, now, note, picture)


def _line(sender: Sender) -> str:
    status = sender.status
    return "" if status is None else f"{status.state.value}: {status.text}"


def _farewell(sender: Sender, say: Say) -> None:
    """Stop the robot before its poses end."""
    if sender.status is None:
        return
    sender.order(Order.STOP, time.monotonic())
    end = time.monotonic() + FAREWELL
    while sender.pending and time.monotonic() < end:
        select.select([sender.socket], [], [], TURN)
        sender.work(time.monotonic())
    say(sender.said)
