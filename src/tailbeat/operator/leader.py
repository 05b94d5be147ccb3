"""Leads the robot as an operator would: arms it, starts the swim, sends it the targets of a tour,
or one that moves by the clock."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field

from tailbeat.control.measure import PAPER, Measure
from tailbeat.files import BadInput
from tailbeat.link.datagrams import Order
from tailbeat.link.places import POOL, place
from tailbeat.link.reasons import Reason
from tailbeat.link.sender import Sender
from tailbeat.link.status import State, Status
from tailbeat.operator.follow import Follow
from tailbeat.operator.target_path import PathAsked, target_path
from tailbeat.operator.tour import Pose, Tour, draw_targets

Say = Callable[[str], None]
STARTING, STUCK, AGAIN = 30.0, 15.0, 2.0  # s to start, without swimming, between orders
FRESH = 1.0  # s: an older status is not used
REARMED = 20  # most times that a tour arms a robot again; each is reported
UP = (State.ARMED, State.TEST, State.RUN, State.HOLD)  # with torque


@dataclass(eq=False)
class Leader:
    """Leads a fish as an operator would.

    It arms the fish once and starts the swim. In a tour it sends the targets, arms a fish in HOLD
    again (`rearmed` times), and ends if the fish does not swim. `ran` is the last time at which it
    swam. With `follow` the target moves by the clock, and the fish is armed again as in a tour.
    Without both, the target is `aim` [m], and the operator leads from then on.

    A fish that stopped, or that somebody disarmed, gets no order: a person looks after it first.
    One that stopped only because nobody saw it is disarmed and armed again. `up`: it was armed, and
    not disarmed from here.
    """

    tour: Tour | None
    aim: tuple[float, float] | None = None
    ran: float = field(default_factory=lambda: time.monotonic() + STARTING)
    armed: int = 0
    swam: bool = False
    up: bool = False
    asked: float = 0.0
    follow: Follow | None = None

    @property
    def attends(self) -> bool:
        """Whether it leads to the end, and arms a fish in HOLD again."""
        return self.tour is not None or self.follow is not None

    @property
    def rearmed(self) -> int:
        """How often the fish was armed again."""
        return max(self.armed - 1, 0)

    def lead(
        self,
        sender: Sender,
        pose: Pose | None,
        now: float,
        say: Say,
        captured: float | None = None,
    ) -> None:
        """Take the newest pose and status, and send what is next. A target by the clock is sent
        where it is when the pose was `captured` [s]; None: now."""
        status = sender.status if now - sender.heard < FRESH else None
        state = status.state if status else None
        if state in (State.TEST, State.RUN):
            self.ran, self.swam = max(self.ran, now), self.swam or state is State.RUN
        elif status is not None and now - self.asked > AGAIN and (self.attends or not self.swam):
            self._order(sender, status, now, say)
        self.up = self.up or state in UP
        if self.aim is not None:
            sender.target, self.aim = self.aim, None
        if self.tour is not None:
            self._tour(self.tour, sender, pose if state is State.RUN else None, now, say)
        if self.follow is not None:
            sender.target = self.follow.take(status, pose, now if captured is None else captured)

    def _order(self, sender: Sender, status: Status, now: float, say: Say) -> None:
        self.asked, state = now, status.state
        if state is State.ARMED:
            sender.order(Order.SWIM, now)
        elif self.rearmed >= REARMED:
            return
        elif state is State.STOP and status.reason is Reason.POSE_LOST:
            sender.order(Order.DISARM, now)
            self.up = False
        elif state is State.HOLD or (state is State.DISARMED and not self.up):
            self._arm(sender, status, now, say)

    def _arm(self, sender: Sender, status: Status, now: float, say: Say) -> None:
        """Order to arm. It counts as another time if the fish has been armed before."""
        again = self.swam or status.state is State.HOLD
        self.armed = max(self.armed, 1) + again
        if again:
            say(f"{status.state.value}: {status.text}; armed again, time {self.rearmed}")
        sender.order(Order.ARM, now)

    def _tour(self, tour: Tour, sender: Sender, pose: Pose | None, now: float, say: Say) -> None:
        done = len(tour.rows)
        if pose is not None:
            tour.see(pose, now)
        for row in tour.rows[done:]:
            end = f"{100 * row.closest:.1f} cm after {row.seconds:.1f} s"
            say(f"target {row.target} of {len(tour.targets)}: {end}")
        sender.target = tour.target or sender.target

    def over(self) -> bool:
        """Whether the tour or the path is over, or the fish does not swim any more."""
        now = time.monotonic()
        done = self.tour is not None and self.tour.target is None
        done = done or (self.follow is not None and self.follow.over(now))
        return self.attends and (done or now - self.ran > STUCK)


def drawn_tour(
    count: int, seed: int, pool: tuple[float, float] = POOL, measure: Measure = PAPER
) -> Tour | None:
    """A tour of `count` targets in a pool of this length and width [m], in a fish's measure; None
    for 0. Raises BadInput."""
    if not 0 <= count <= 1000:
        raise BadInput(f"--tour {count}: allowed are 0 to 1000 targets.")
    if not count:
        return None
    places = draw_targets(count, seed, pool, measure).tolist()
    return Tour([(x, y) for x, y in places], measure.patience, measure.arrival)


def chosen_leader(
    targets: int,
    seed: int,
    begin: str | None,
    pool: tuple[float, float],
    measure: Measure = PAPER,
    asked: PathAsked | None = None,
) -> Leader | None:
    """A leader through so many drawn targets, or to `begin` (x,y [m] as typed), or after a target
    on the path `asked`; None for none of them. Raises BadInput."""
    if asked is not None:
        if targets or begin is not None:
            raise BadInput(f"--path {asked.path}: give it without --tour and --begin.")
        return Leader(None, follow=Follow(target_path(asked, pool, measure)))
    tour = drawn_tour(targets, seed, pool, measure)
    aim = None if begin is None else place(begin, "--begin", pool)
    return Leader(tour, aim) if tour or aim else None
