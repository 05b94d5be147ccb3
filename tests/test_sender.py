"""The station's end of the link in single steps, at exact times, against a socket and no fish."""

import time
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest

from tailbeat.link import datagrams as link
from tailbeat.link.datagrams import Frame, Order, Receiver
from tailbeat.link.reasons import Reason
from tailbeat.link.sender import Outcome, Sender
from tailbeat.link.status import Numbers, State, Status, status_datagram

KEY, RUN, FISH = bytes(range(32)), 77, 5  # FISH: the nonce of the fish's start
FRAME = Frame(0, (0.1, -0.2, 1.5), (1.0, 0.5))
STATUS = Status(State.HOLD, Reason.NO_TARGET, "no target", 0, 0, 0, 0.0, Numbers())


class Bench:
    """A sender, and a socket at the fish's address that keeps what it was sent."""

    def __init__(self) -> None:
        self.fish, self.station = (link.bind("127.0.0.1", 0) for _ in range(2))
        self.sender = Sender(KEY, self.station, self.fish.getsockname(), run=RUN)

    def got(self, kind: bytes) -> list[bytes]:
        """The datagrams of a kind that came since the last call."""
        return [data for data, _ in link.drain(self.fish) if data[:4] == kind]

    def ask(self, now: float, nonce: int = FISH, sequence: int = 1) -> None:
        self._say(link.ask_datagram(KEY, nonce, sequence, 0), now)

    def tell(self, now: float, sequence: int, nonce: int = FISH, **changed: Any) -> None:
        """A status, with the number of the newest order taken as `order`."""
        self._say(status_datagram(KEY, RUN, nonce, sequence, replace(STATUS, **changed)), now)

    def _say(self, data: bytes, now: float) -> None:
        self.fish.sendto(data, self.station.getsockname())
        self.sender.work(now)


@pytest.fixture
def bench() -> Iterator[Bench]:
    made = Bench()
    yield made
    made.fish.close()
    made.station.close()


def test_a_question_is_answered_with_the_pool_s_size_and_both_times(bench):
    bench.sender.pool = (4.0, 2.0)
    bench.ask(0.0)
    (told,) = bench.got(link.TELL)
    to = Receiver(KEY, nonce=FISH)
    to.take(told, time.monotonic_ns())
    assert to.room == (4.0, 2.0) and to.run == RUN and len(to.clock.echoes) == 1


def test_what_is_not_the_fish_s_is_counted_and_answered_with_nothing(bench):
    bench._say(b"hello", 0.0)
    assert bench.sender.rejected == {"not the fish's": 1} and not list(link.drain(bench.fish))


def test_a_sender_draws_a_run_of_its_own():
    station = link.bind("127.0.0.1", 0)
    runs = {Sender(KEY, station, ("127.0.0.1", 9)).run for _ in range(20)}
    station.close()
    assert len(runs) == 20 and all(0 < run < 2**64 for run in runs)  # 0 means that none is heard


def test_the_newest_frame_with_the_fish_in_it_is_kept(bench):
    bench.sender.show(FRAME)
    bench.sender.show(replace(FRAME, captured=1, fish=None))
    assert bench.sender.seen == FRAME and len(bench.sender.frames) == 2


def test_frames_are_numbered_and_carry_the_two_before(bench):
    bench.ask(0.0)
    to = Receiver(KEY, nonce=FISH)
    for k in range(4):
        bench.sender.show(replace(FRAME, captured=k))
    for data in bench.got(link.POSES):
        to.take(data, 0)
    assert to.accepted == 4 and [one.captured for one in to.frames] == [3, 2, 1]
    assert to.loss.share() == 0


def test_an_order_goes_out_at_once_and_every_50_ms_until_the_status_shows_it_taken(bench):
    bench.tell(0.0, 1)
    bench.sender.order(Order.ARM, 0.0)
    assert len(bench.got(link.ORDER)) == 1 and bench.sender.said == "ARM sent"
    for now, sent in ((0.049, 0), (0.05, 1), (0.099, 0), (0.101, 1)):
        bench.sender.work(now)
        assert len(bench.got(link.ORDER)) == sent, now
    bench.tell(0.12, 2, order=1)
    bench.sender.work(1.0)
    assert bench.sender.said == "ARM refused: no target" and not bench.got(link.ORDER)


def test_no_order_counts_as_taken_before_a_fish_was_heard(bench):
    bench.ask(0.0)
    bench.sender.order(Order.ARM, 0.0)
    assert bench.sender.said == "ARM sent" and len(bench.sender.pending) == 1


def test_an_order_is_given_up_after_three_seconds(bench):
    bench.ask(0.0)
    bench.sender.order(Order.ARM, 10.0)
    bench.sender.work(13.0)
    assert bench.sender.pending
    bench.sender.work(13.1)
    assert not bench.sender.pending
    assert bench.sender.said == "ARM not taken: the fish does not answer"


@pytest.mark.parametrize(
    ("order", "state", "text", "said", "bad"),
    [
        (Order.ARM, State.ARMED, "armed", "ARM done: armed", False),
        (Order.ARM, State.DISARMED, "no pose for 400 ms", "ARM refused: no pose for 400 ms", True),
        (Order.ARM, State.STOP, "servo at 80 deg C", "ARM refused: servo at 80 deg C; disarm first",
         True),
        (Order.ARM, State.TEST, "sign test: the tail beats", "ARM done: test", False),
        (Order.SWIM, State.TEST, "sign test: the tail beats", "SWIM done: test", False),
        (Order.SWIM, State.RUN, "swimming", "SWIM done: run", False),
        (Order.SWIM, State.HOLD, "no target", "SWIM refused: no target", True),
        (Order.DISARM, State.DISARMED, "not armed yet", "DISARM done: disarmed", False),
        (Order.STOP, State.STOP, "stop asked by the operator page", "STOP done: stop", False),
        (Order.STOP, State.DISARMED, "not armed yet", "STOP done: disarmed", False),
    ],
)  # fmt: skip
def test_an_outcome_is_what_the_robot_did_and_names_who_asked(bench, order, state, text, said, bad):
    bench.tell(0.0, 1)
    bench.sender.order(order, 0.0, "a page")
    bench.tell(0.1, 2, order=1, state=state, text=text)
    sent, done = bench.sender.outcomes
    assert (sent.text, sent.asker, sent.number) == (f"{order.name} sent", "a page", 1)
    assert done == Outcome(2, "a page", said, bad)


def test_an_order_that_another_replaced_is_told_to_who_gave_it(bench):
    bench.tell(0.0, 1)
    bench.sender.order(Order.ARM, 0.0, "a")
    bench.sender.order(Order.STOP, 0.0, "b")
    found = [(one.asker, one.text) for one in bench.sender.outcomes]
    assert ("a", "ARM not taken: STOP was ordered") in found and found[-1] == ("b", "STOP sent")
    bench.tell(0.2, 1, nonce=6)
    assert bench.sender.said == "STOP not taken: the fish started again"


@pytest.mark.parametrize("which", [Order.STOP, Order.DISARM])
def test_to_stop_and_to_disarm_go_before_what_waits(bench, which):
    bench.tell(0.0, 1)
    for order in (Order.ARM, Order.SWIM, which):
        bench.sender.order(order, 0.0)
    assert [one.order for one in bench.sender.pending] == [which]


def test_a_fish_that_starts_anew_gets_no_order_that_was_given_to_the_one_before(bench):
    bench.tell(0.0, 1)
    bench.sender.order(Order.SWIM, 0.1)
    bench.got(link.ORDER)
    bench.tell(0.2, 1, nonce=6)
    bench.sender.work(1.0)
    assert not bench.sender.pending and not bench.got(link.ORDER) and bench.sender.nonce == 6


def test_a_question_of_another_start_is_heard_once_the_fish_is_silent_for_a_second(bench):
    bench.tell(10.0, 1)
    bench.ask(11.0, nonce=6)
    assert bench.sender.nonce == FISH
    bench.ask(11.1, nonce=6)
    assert bench.sender.nonce == 6
    bench.tell(11.2, 1, nonce=6)
    bench.ask(19.0, nonce=FISH)  # a recording of the start that ended
    assert bench.sender.nonce == 6


def test_statuses_that_are_old_or_of_an_ended_start_are_not_believed(bench):
    bench.tell(0.0, 3)
    bench.tell(0.1, 3, missed=9)
    bench.tell(0.2, 2, missed=9)
    bench.tell(0.3, 1, nonce=6)  # the fish starts anew, and its numbers with it
    bench.tell(0.4, 4, missed=9)
    assert bench.sender.rejected == {"old": 3} and bench.sender.heard == 0.3
    assert bench.sender.status == replace(STATUS, numbers=bench.sender.status.numbers)


def test_the_share_of_statuses_lost_is_of_the_last_fifty_of_this_start(bench):
    bench.tell(0.0, 1)
    bench.tell(0.1, 1, nonce=6)
    for sequence in range(3, 52):
        bench.tell(0.1 * sequence, sequence, nonce=6)
    assert bench.sender.loss.share() == pytest.approx(1 / 50)
    bench.tell(5.2, 52, nonce=6)
    assert bench.sender.loss.share() == 0


def test_a_network_that_is_down_stops_nothing(bench):
    bench.tell(0.0, 1)
    bench.station.close()
    bench.sender.show(FRAME)
    assert bench.sender.sequence == 1
