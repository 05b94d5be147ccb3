"""The poolside station: camera to poses, poses to the fish, orders and readings to the page."""

import select
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tailbeat.files import BadInput
from tailbeat.fish.store import load_fish
from tailbeat.link import datagrams as link
from tailbeat.link.datagrams import Order
from tailbeat.link.sender import Sender
from tailbeat.link.status import State
from tailbeat.operator.client import announce, open_console, turn
from tailbeat.operator.tour import Pose, Tour, draw_targets
from tailbeat.processes import told_to_end

Say = Callable[[str], None]
TURN = 0.002  # s that a turn waits for the fish's word: the clock's answer must not
STARTING, STUCK, AGAIN = 30.0, 15.0, 2.0  # s: to begin, not to swim, between two orders
FRESH = 1.0  # s: an older status says nothing about now
REARMED = 20  # times that a tour arms a fish that holds; each is said and counted
FAREWELL = 1.0  # s to have the order to stop taken at the end
NO_CAMERA = "No camera given: the fish gets no poses."


@contextmanager
def open_tracker(
    camera: str, calibration: Path | None, ids: tuple[int, int], exposure: float, latency: float
) -> Iterator[Any]:
    """A tracker in a process beside (`newest`, `picture`, `fault`), or None without a camera; ids
    of fish and target, exposure and latency of the camera [s]. Raises BadInput."""
    if not camera:
        yield None
        return
    if calibration is None:
        raise BadInput("--camera: give its --calibration, made by `tailbeat calibrate`.")
    from tailbeat.vision.follow import watch  # needs OpenCV

    tracker = watch(camera, calibration, ids, exposure, latency)
    try:
        yield tracker
    finally:
        tracker.close()


@dataclass(eq=False)
class Leader:
    """Leads a fish as an operator would: arms it once and lets it swim; through a tour, sends the
    targets, arms a fish that holds anew (`rearmed` so many times), gives up one that does not swim.
    `ran` is when it last swam. Without a tour it is sent to `aim` [m], and the operator leads from
    then on."""

    tour: Tour | None
    aim: tuple[float, float] | None = None
    ran: float = field(default_factory=lambda: time.monotonic() + STARTING)
    armed: int = 0
    swam: bool = False
    asked: float = 0.0

    @property
    def rearmed(self) -> int:
        """How often a fish that had been armed was armed again."""
        return max(self.armed - 1, 0)

    def lead(self, sender: Any, pose: Pose | None, now: float, say: Say) -> None:
        """Take what was seen, send what is next."""
        fresh = sender.status is not None and now - sender.heard < FRESH
        state = sender.status.state if fresh else None
        if state is State.RUN:
            self.ran, self.swam = max(self.ran, now), True
        elif state is not None and now - self.asked > AGAIN and not (self.swam and not self.tour):
            self._order(sender, state, now, say)
        if self.aim is not None:
            sender.target, self.aim = self.aim, None
        if self.tour is not None:
            self._tour(self.tour, sender, pose if state is State.RUN else None, now, say)

    def _order(self, sender: Any, state: State, now: float, say: Say) -> None:
        self.asked = now
        if state is State.ARMED:
            sender.order(Order.SWIM, now)
        elif state is State.STOP and self.rearmed < REARMED:
            sender.order(Order.DISARM, now)
        elif self.rearmed < REARMED:
            if self.swam:
                self.armed += 1
                say(f"{state.value}: {sender.status.text}; armed anew, time {self.rearmed}")
            self.armed = max(self.armed, 1)
            sender.order(Order.ARM, now)

    def _tour(self, tour: Tour, sender: Any, pose: Pose | None, now: float, say: Say) -> None:
        done = len(tour.rows)
        if pose is not None:
            tour.see(pose, now)
        for row in tour.rows[done:]:
            end = f"{100 * row.closest:.1f} cm after {row.seconds:.1f} s"
            say(f"target {row.target} of {len(tour.targets)}: {end}")
        sender.target = tour.target or sender.target

    def over(self) -> bool:
        """Whether all is swum, or the fish will not."""
        if self.tour is None:
            return False
        return self.tour.target is None or time.monotonic() - self.ran > STUCK


def drawn_tour(count: int, seed: int) -> Tour | None:
    """A tour of so many targets in the paper's pool, or None for none."""
    if not 0 <= count <= 1000:
        raise BadInput(f"--tour {count}: allowed are 0 to 1000 targets.")
    if not count:
        return None
    return Tour([(float(x), float(y)) for x, y in draw_targets(count, seed)])


def work(
    robot: tuple[str, int],
    listen: tuple[str, int],
    key: Path,
    console: str,
    tracker: Any,
    fish: str,
    say: Say,
    leader: Leader | None = None,
) -> None:
    """Send what the tracker sees and serve the page until told to end, or a tour is over; then
    order the fish to stop, for nobody watches it any more. Raises BadInput."""
    described, secret = load_fish(fish), link.read_key(key)
    made = link.bind(*listen)
    client = open_console(console)
    for line in announce(client) if client else []:
        say(line)
    ended = told_to_end(signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    sender = Sender(secret, made, robot)
    over = lambda: bool(ended) or (leader is not None and leader.over())  # noqa: E731
    try:
        _turns(sender, tracker, client, described, over, say, leader)
    finally:
        _farewell(sender, say)
        made.close()
        if client is not None:
            client.close()


def _turns(
    sender: Any,
    tracker: Any,
    client: Any,
    fish: Any,
    over: Callable[[], bool],
    say: Say,
    leader: Leader | None,
) -> None:
    """Turn by turn; says every change of the fish's state."""
    sent, told = -1, ""
    while not over():
        select.select([sender.socket], [], [], TURN)
        now = time.monotonic()
        sighting = tracker.newest() if tracker else None
        if sighting is not None and sighting.frame.captured != sent:
            sent = sighting.frame.captured
            if leader is not None:
                leader.lead(sender, sighting.frame.fish, now, say)
            sender.show(sighting.frame)
        sender.work(now)
        if client is not None:
            note = tracker.fault if tracker else NO_CAMERA
            turn(client, sender, fish, now, note, b"" if note else tracker.picture())
        if (line := _line(sender)) != told:
            told = line
            say(line)


def _line(sender: Any) -> str:
    status = sender.status
    return "" if status is None else f"{status.state.value}: {status.text}"


def _farewell(sender: Any, say: Say) -> None:
    """The fish stops before its poses end."""
    if sender.status is None:
        return
    sender.order(Order.STOP, time.monotonic())
    end = time.monotonic() + FAREWELL
    while sender.pending and time.monotonic() < end:
        select.select([sender.socket], [], [], TURN)
        sender.work(time.monotonic())
    say(sender.said)
