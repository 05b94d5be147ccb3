"""Orders and status: what the fish obeys, what the station believes, over real sockets."""

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from tailbeat.link import datagrams as link
from tailbeat.link.datagrams import SECOND, Frame, Order, Receiver, order_datagram
from tailbeat.link.reasons import REASONS, Reason, text_of
from tailbeat.link.sender import GIVE_UP, LIVE, Sender
from tailbeat.link.status import (
    LENGTH,
    STATUS,
    TEXT_BYTES,
    Numbers,
    State,
    Status,
    read_status,
    status_datagram,
)
from tailbeat.robot.reporter import Reporter
from tailbeat.robot.safety import SafetyLimits

pytestmark = pytest.mark.realtime

KEY, RUN = bytes(range(32)), 77
FRAME = Frame(0, (0.1, -0.2, 1.5), (1.0, 0.5))
STAND = Status(
    State.RUN, Reason.SWIMMING, "swimming", 3, 12, 5, 37.25, Numbers(0.05, 0.3, 2.0, target_x=1.5)
)


def followed(run: int = RUN) -> Receiver:
    """A receiver that hears this run."""
    to = Receiver(KEY, (5.5, 2.7))
    to.take(link.pose_datagram(KEY, run, to.nonce, 1, [FRAME]), 0)
    assert to.run == run
    return to


def order(to: Receiver, number: int, which: Order, run: int = RUN, key: bytes = KEY) -> bytes:
    return order_datagram(key, run, to.nonce, number, which, 0)


# ---- the fish's side ----------------------------------------------------------------------------


def test_orders_come_in_turn_and_an_old_or_repeated_one_does_nothing():
    to = followed()
    packets = [order(to, k, which) for k, which in enumerate(Order, 1)]
    for packet in (packets[0], packets[0], packets[2], packets[1], packets[0], packets[3]):
        to.take(packet, 0)
    assert to.take_orders() == [Order.ARM, Order.DISARM, Order.STOP] and to.take_orders() == []
    assert to.rejected == {"old": 2}  # what the sender repeats by itself does not count


def test_an_order_needs_the_key_this_start_and_the_sender_that_is_heard():
    to = followed()
    to.take(order(to, 1, Order.ARM, key=bytes(32)), 0)
    to.take(order_datagram(KEY, RUN, to.nonce + 1, 1, Order.ARM, 0), 0)
    to.take(order(to, 1, Order.ARM, run=78), 0)
    to.take(order_datagram(KEY, RUN, to.nonce, 1, 9, 0), 0)  # type: ignore[arg-type]
    assert not to.orders
    assert to.rejected == {"signature": 1, "another start's": 1, "old": 1, "implausible": 1}


def test_whoever_has_the_key_may_stop_but_a_recorded_stop_is_none():
    to = followed()
    stop = order(to, 4, Order.STOP, run=78)
    for _ in range(2):
        to.take(stop, 0)
    to.take(order(to, 3, Order.STOP, run=78), 0)
    assert to.take_orders() == [Order.STOP] and to.run == RUN


def test_a_run_that_another_followed_is_never_heard_again():
    """Neither its poses nor its orders: they may be recordings that never arrived."""
    to = followed()
    held_back = [link.pose_datagram(KEY, RUN, to.nonce, 9, [FRAME]), order(to, 1, Order.ARM)]
    to.take(link.pose_datagram(KEY, 78, to.nonce, 1, [FRAME]), 0)
    for packet in held_back:
        to.take(packet, 0)
    assert to.run == 78 and not to.orders and to.rejected == {"old": 2}


def test_an_order_to_move_that_was_held_back_is_late_one_to_stop_is_not():
    to = followed()
    to.clock.add(0, 1000, 1000, 10)
    for number, which in enumerate(Order, 1):
        to.take(order(to, number, which), 5 * SECOND)
    assert to.take_orders() == [Order.DISARM, Order.STOP] and to.rejected == {"late": 2}


@pytest.mark.parametrize(("ahead", "taken"), [(2 * SECOND, 1), (2 * SECOND + 1, 0)])
@pytest.mark.parametrize("sign", [1, -1], ids=["late", "early"])
def test_an_order_to_move_may_be_two_seconds_old_by_the_sender_s_clock(ahead, taken, sign):
    to = followed()
    to.clock.add(0, 40 * SECOND, 40 * SECOND, 0)  # the sender's clock is 40 s ahead
    sent = order_datagram(KEY, RUN, to.nonce, 1, Order.ARM, 41 * SECOND)
    to.take(sent, SECOND + sign * ahead)
    assert len(to.take_orders()) == taken


def test_every_flipped_bit_of_an_order_and_of_a_status_is_refused():
    to = followed()
    asked, told = order(to, 1, Order.ARM), status_datagram(KEY, RUN, 5, 1, STAND)
    for place in range(8 * len(asked)):
        to.take(flipped(asked, place), 0)
    assert not to.orders and to.ordered == {}
    assert all(read_status(KEY, flipped(told, place)) is None for place in range(8 * len(told)))


def flipped(packet: bytes, place: int) -> bytes:
    """One bit turned."""
    forged = bytearray(packet)
    forged[place // 8] ^= 1 << place % 8
    return bytes(forged)


# ---- the status ---------------------------------------------------------------------------------


def test_a_status_comes_back_as_it_went():
    found = read_status(KEY, status_datagram(KEY, RUN, 5, 9, STAND))
    assert found is not None
    run, nonce, sequence, status = found
    assert (run, nonce, sequence) == (RUN, 5, 9)
    assert replace(status, numbers=Numbers()) == pytest.approx(replace(STAND, numbers=Numbers()))
    assert status.numbers.pose_age == pytest.approx(0.05) and math.isnan(status.numbers.voltage)
    assert read_status(bytes(32), status_datagram(KEY, RUN, 5, 9, STAND)) is None


@pytest.mark.parametrize("reason", REASONS)
def test_every_reason_comes_back_as_a_value(reason):
    found = read_status(KEY, status_datagram(KEY, RUN, 5, 9, replace(STAND, reason=reason)))
    assert found is not None and found[3].reason is reason


def test_numbers_too_large_for_a_status_are_cut_and_times_are_said_in_milliseconds():
    packet = status_datagram(KEY, RUN, 5, 9, replace(STAND, missed=10**6, rejects=10**12))
    found = read_status(KEY, packet)
    assert found is not None and (found[3].missed, found[3].rejects) == (0xFFFF, 0xFFFF_FFFF)
    assert text_of(Reason.POSE_LATE, 1.234) == "no pose for 1234 ms"


@pytest.mark.parametrize("reason", ["", "°" * 95, "x" * 500])
def test_a_reason_of_any_length_is_cut_between_letters(reason):
    packet = status_datagram(KEY, RUN, 5, 9, replace(STAND, text=reason, missed=10**6))
    found = read_status(KEY, packet)
    assert found is not None and len(packet) == LENGTH
    assert reason.startswith(found[3].text) and found[3].missed == 0xFFFF
    assert len(found[3].text.encode()) == min(len(reason.encode()) // 2 * 2, TEXT_BYTES)


def row(now: float, **more: Any) -> dict[str, Any]:
    names = "command_rad motor_angle_rad pose_age_s clock_doubt_s temperature_deg_c voltage_v"
    numbers = dict.fromkeys([*names.split(), "current_a", "band_share"], math.inf)
    return {"time_s": now, "state": "hold", "reason": "no target", "cause": "no_target",
            "missed": 0, "busy_s": 0.0, **numbers, **more}  # fmt: skip


def test_a_reporter_speaks_ten_times_a_second_and_tells_the_worst_since():
    reporter, to, said = Reporter(), followed(), []
    for k in range(100):
        late = 0.007 if k == 52 else 0.001
        packet = reporter.report(
            row(0.02 * k, busy_s=1e-4 * k), late, to, SafetyLimits(), (1.0, 2.0)
        )
        said += [read_status(KEY, packet)] if packet else []
    statuses = [found[3] for found in said if found]
    assert len(statuses) == 20
    assert sum(status.numbers.late > 0.006 for status in statuses) == 1
    assert statuses[-1].numbers.busy == pytest.approx(9.5e-3)
    assert statuses[-1].state is State.HOLD and statuses[-1].reason is Reason.NO_TARGET
    assert statuses[-1].text == "no target"
    assert (statuses[-1].numbers.target_x, statuses[-1].numbers.pose_age) == (1.0, math.inf)


# ---- the station's side, against a fish of sockets ----------------------------------------------


@dataclass
class Pair:
    """A sender and what a fish's loop does with its socket; `deaf` drops what would arrive."""

    sender: Sender
    receiver: Receiver
    reporter: Reporter
    fish: Any
    now: float = 0.0
    questions: int = 0
    deaf: Callable[[], bool] = lambda: False
    heard: tuple[bytes, ...] = ()

    def turn(self, count: int = 1) -> None:
        """So many periods of 20 ms."""
        for _ in range(count):
            self.now += 0.02
            self.questions += 1
            to, there = self.receiver, self.sender.socket.getsockname()
            asked = link.ask_datagram(KEY, to.nonce, self.questions, time.monotonic_ns())
            said = self.reporter.report(row(self.now), 0.0, to, SafetyLimits(), None)
            for packet in filter(None, (asked, said)):
                self.fish.sendto(packet, there)
                self.heard = (*self.heard, packet)
            self.sender.work(self.now)
            for data, _ in link.drain(self.fish):
                if not self.deaf():
                    to.take(data, time.monotonic_ns())

    def restart(self) -> None:
        """The fish starts anew."""
        self.receiver, self.reporter = Receiver(KEY, (5.5, 2.7)), Reporter()
        self.reporter.due = -math.inf


@pytest.fixture
def pair() -> Iterator[Pair]:
    fish, station = link.bind("127.0.0.1", 0), link.bind("127.0.0.1", 0)
    sender = Sender(KEY, station, fish.getsockname(), run=RUN)
    yield Pair(sender, Receiver(KEY, (5.5, 2.7)), Reporter(), fish)
    fish.close()
    station.close()


def test_a_sender_meets_a_fish_shows_it_frames_and_hears_how_it_is(pair):
    pair.sender.show(FRAME)  # nobody asked yet: nothing is sent
    pair.turn(10)
    pair.sender.show(replace(FRAME, captured=time.monotonic_ns()))
    pair.turn(10)
    assert pair.receiver.accepted == 1 and pair.receiver.frames[0].target == (1.0, 0.5)
    assert pair.sender.status is not None and pair.sender.status.reason is Reason.NO_TARGET
    offset = pair.receiver.clock.offset(time.monotonic_ns())
    assert offset is not None and abs(offset[0]) <= offset[1]  # one clock here


def test_the_operator_s_target_goes_over_the_camera_s_until_it_is_taken_back(pair):
    pair.turn(10)
    for k, target in enumerate([(-1.5, 0.25), None]):
        pair.sender.target = target
        pair.sender.show(replace(FRAME, captured=k))
        pair.turn()
        assert pair.receiver.frames[0].target == (target or FRAME.target)


def test_an_order_is_repeated_through_loss_and_obeyed_once(pair):
    rng = np.random.default_rng(0)
    pair.turn(10)
    pair.deaf = lambda: rng.uniform() < 0.7
    pair.sender.order(Order.ARM, pair.now)
    pair.sender.order(Order.SWIM, pair.now)
    obeyed: list[Order] = []
    for _ in range(150):
        pair.turn()
        obeyed += pair.receiver.take_orders()
    assert obeyed == [Order.ARM, Order.SWIM] and not pair.sender.pending
    assert pair.sender.said == "SWIM refused: no target" and not pair.receiver.rejected


def test_stop_goes_before_what_waits_and_a_silent_fish_is_said(pair):
    pair.turn(10)
    pair.deaf = lambda: True
    for which in (Order.ARM, Order.SWIM, Order.STOP):
        pair.sender.order(which, pair.now)
    assert [one.order for one in pair.sender.pending] == [Order.STOP]
    pair.turn(round(GIVE_UP / 0.02) + 2)
    assert pair.sender.said == "STOP not taken: the fish does not answer"


def test_a_fish_that_restarts_is_met_again_and_recordings_of_it_are_not_believed(pair):
    pair.turn(20)
    before = pair.heard
    pair.restart()
    pair.turn(round(LIVE / 0.02) + 20)
    assert pair.sender.nonce == pair.receiver.nonce and pair.now - pair.sender.heard < 0.2
    status = pair.sender.status
    for packet in before:
        pair.fish.sendto(packet, pair.sender.socket.getsockname())
    pair.sender.work(pair.now)
    assert pair.sender.nonce == pair.receiver.nonce and pair.sender.status is status
    assert pair.sender.rejected["old"] == sum(packet[:4] == STATUS for packet in before)


def test_a_status_to_another_sender_or_forged_is_not_believed(pair):
    pair.turn(10)
    status, there = pair.sender.status, pair.sender.socket.getsockname()
    for run, key in ((RUN + 1, KEY), (RUN, bytes(32))):
        pair.fish.sendto(status_datagram(key, run, pair.receiver.nonce, 10**6, STAND), there)
    pair.sender.work(pair.now)
    assert pair.sender.status is status
    assert pair.sender.rejected == {"old": 1, "not the fish's": 1}


def test_lost_statuses_are_counted(pair):
    pair.turn(10)
    pair.reporter.sequence += 9
    pair.turn(10)
    came = len(pair.sender.loss.heard)
    assert pair.sender.loss.share() == pytest.approx(9 / (came + 8))
