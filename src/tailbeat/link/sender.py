"""The station's end of the link: sends frames, clock answers and orders; receives the status.

A plain object without a thread; its owner calls `work`. It does not depend on camera or pool.
"""

import contextlib
import math
import secrets
import socket
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from tailbeat.link import datagrams as link
from tailbeat.link.clock import Loss
from tailbeat.link.datagrams import Frame, Order
from tailbeat.link.places import POOL
from tailbeat.link.status import State, Status, read_status

REPEAT = 0.05  # s between two sendings of an order
GIVE_UP = 3.0  # s until an order that the fish has not taken is given up
LIVE = 1.0  # s since the last status in which another start's request does not replace the fish
STATUSES = 50  # five seconds of statuses
OUTCOMES = 16  # of orders that are kept
# States in which the robot is when it has followed an order.
FOLLOWED = {
    Order.ARM: (State.ARMED, State.TEST, State.RUN),
    Order.SWIM: (State.TEST, State.RUN),
    Order.DISARM: (State.DISARMED,),
    Order.STOP: (State.STOP, State.DISARMED),
}


@dataclass(eq=False)
class Pending:
    """An order that the fish has not taken yet: its number, when it was given and when it is sent
    again [s], and who gave it."""

    order: Order
    number: int
    given: float
    due: float = -math.inf
    asker: str = ""


@dataclass(frozen=True)
class Outcome:
    """News of an order: a rising number, who gave the order, a text, whether it was in vain."""

    number: int
    asker: str
    text: str
    bad: bool = False


def result(order: Order, status: Status) -> tuple[str, bool]:
    """What the robot did with an order that it has taken: the state that it is in now, or why it
    did not follow, and then True."""
    name, now = order.name, status.state
    if now in FOLLOWED[order]:
        return f"{name} done: {now.value}", False
    first = "; disarm first" if now is State.STOP and "disarm first" not in status.text else ""
    return f"{name} refused: {status.text}{first}", True


@dataclass(eq=False)
class Sender:
    """The station's end. Call `work` at least a few hundred times a second, and `show` at every
    frame.

    `clock` gives the station's monotonic time [ns]. `target` [m], if set, replaces the target that
    the camera saw. `pool` is the length and width [m] that the fish is told, `calibration` the
    SHA-256 of the camera's calibration. `status` is the fish's last one, received at `heard` [s].
    `outcomes` tells what became of the last orders.
    """

    key: bytes
    socket: socket.socket
    fish: tuple[str, int]
    clock: Callable[[], int] = time.monotonic_ns
    target: tuple[float, float] | None = None
    pool: tuple[float, float] = POOL
    calibration: bytes = link.NO_CAMERA
    run: int = field(default_factory=lambda: 1 + secrets.randbits(63))
    nonce: int | None = None  # of the fish's start to which we send
    answerer: int | None = None  # nonce of the start that sent the last status
    left: set[int] = field(default_factory=set)  # nonces of starts that ended
    frames: deque[Frame] = field(default_factory=lambda: deque(maxlen=link.FRAMES))
    seen: Frame | None = None  # the newest with the fish in it
    status: Status | None = None
    heard: float = -math.inf
    loss: Loss = field(default_factory=lambda: Loss(deque(maxlen=STATUSES)))
    rejected: Counter[str] = field(default_factory=Counter)
    outcomes: deque[Outcome] = field(default_factory=lambda: deque(maxlen=OUTCOMES))
    sequence: int = 0
    answered: int = -1  # sequence of the last status
    orders: int = 0
    told: int = 0
    pending: deque[Pending] = field(default_factory=deque)

    def work(self, now: float) -> None:
        """Handle received datagrams and send orders that are due, at `now` [s], monotonic."""
        for data, _ in link.drain(self.socket):
            self._take(data, now)
        self._repeat(now)

    def show(self, frame: Frame) -> None:
        """Send a frame, with the two before it. The operator's target replaces the camera's."""
        if self.target is not None:
            frame = replace(frame, target=self.target)
        self.frames.append(frame)
        if frame.fish is not None:
            self.seen = frame
        if self.nonce is None:
            return  # no fish has asked yet
        self.sequence += 1
        frames = list(self.frames)
        self._send(link.pose_datagram(self.key, self.run, self.nonce, self.sequence, frames))

    @property
    def said(self) -> str:
        """What happened to the last order."""
        return self.outcomes[-1].text if self.outcomes else ""

    def order(self, order: Order, now: float, asker: str = "") -> None:
        """Send an order of `asker` until the status shows that it is taken. STOP and DISARM cancel
        all earlier orders."""
        if order in (Order.STOP, Order.DISARM):
            self._drop(f"{order.name} was ordered")
        self.orders += 1
        self.pending.append(Pending(order, self.orders, now, asker=asker))
        self._tell(asker, f"{order.name} sent")
        self._repeat(now)

    # ---- inside ---------------------------------------------------------------------------------

    def _take(self, data: bytes, now: float) -> None:
        received = self.clock()
        if link.is_signed(self.key, data, link.ASK, link.LENGTHS[link.ASK]):
            self._answer(data, received, now)
        elif (status := read_status(self.key, data)) is not None:
            self._hear(*status, now)
        else:
            self.rejected["not the fish's"] += 1

    def _answer(self, data: bytes, received: int, now: float) -> None:
        """Answer a clock request, and name the camera's calibration. It may be a recording, so it
        changes the fish only if none is heard."""
        nonce, sequence = link.HEAD.unpack_from(data)[2:]
        if now - self.heard > LIVE and nonce not in self.left:
            self.nonce = nonce
        told = link.tell_datagram(self.key, self.run, data, received, self.clock(), self.pool)
        if told is not None:
            self._send(told)
            known = nonce, sequence, self.calibration
            self._send(link.camera_datagram(self.key, self.run, *known))

    def _hear(self, run: int, nonce: int, sequence: int, status: Status, now: float) -> None:
        """Accept a status that names our run: it answers us, so it is not a recording."""
        old = nonce == self.answerer and sequence <= self.answered
        if run != self.run or nonce in self.left or old:
            self.rejected["old"] += 1
            return
        if nonce != self.answerer:
            self._meet(nonce)
        self.nonce, self.answered, self.status, self.heard = nonce, sequence, status, now
        self.loss.add(sequence)

    def _meet(self, nonce: int) -> None:
        """Switch to a fish that restarted; it does not get the orders given before."""
        if self.answerer is not None:
            self.left.add(self.answerer)
            self._drop("the fish started again")
        self.answerer, self.loss = nonce, Loss(deque(maxlen=STATUSES))

    def _repeat(self, now: float) -> None:
        """Send the oldest order that the fish has not taken; later orders wait for it."""
        taken = self.status.order if self.status else 0
        while self.status and self.pending and self.pending[0].number <= taken:
            first = self.pending.popleft()
            self._tell(first.asker, *result(first.order, self.status))
        if not self.pending or now < self.pending[0].due:
            return
        first = self.pending[0]
        if now - first.given > GIVE_UP:
            self._drop("the fish does not answer")
        elif self.nonce is not None:
            first.due = now + REPEAT
            words = self.run, self.nonce, first.number, first.order, self.clock()
            self._send(link.order_datagram(self.key, *words))

    def _drop(self, why: str) -> None:
        """Forget the orders that the fish has not taken."""
        for one in self.pending:
            self._tell(one.asker, f"{one.order.name} not taken: {why}", True)
        self.pending.clear()

    def _tell(self, asker: str, text: str, bad: bool = False) -> None:
        self.told += 1
        self.outcomes.append(Outcome(self.told, asker, text, bad))

    def _send(self, datagram: bytes) -> None:
        with contextlib.suppress(OSError):  # the age of the status shows that a network is down
            self.socket.sendto(datagram, self.fish)
