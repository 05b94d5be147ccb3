"""The clocks' offset from single echoes and over sockets, and the share of datagrams lost."""

import math
import sys
import time
from functools import partial

import pytest

from support import until
from tailbeat.link import datagrams as link
from tailbeat.link.arrival import arrived
from tailbeat.link.clock import SECOND, Clock, Loss
from tailbeat.link.sender import Sender

KEY = bytes(range(32))
WAY, WORK = 1000, 500  # ns that an echo takes one way, and between being heard and sent back


def echo(clock: Clock, now: int, ahead: int, back: int = WAY) -> None:
    """An echo that is heard at `now` [ns]; the sender's clock is `ahead` of ours."""
    asked = now - back - WORK - WAY
    clock.add(asked, asked + WAY + ahead, asked + WAY + WORK + ahead, now)


def test_an_echo_with_equal_ways_gives_the_offset_and_half_its_round_trip_as_doubt():
    clock = Clock()
    assert clock.offset(0) is None
    echo(clock, 7 * SECOND, ahead=40)
    assert clock.offset(7 * SECOND) == (40, WAY)
    assert all(isinstance(number, int) for number in clock.offset(7 * SECOND) or ())


def test_the_offset_is_wrong_by_no_more_than_the_doubt_when_the_ways_differ():
    clock = Clock()
    echo(clock, SECOND, ahead=-300, back=9 * WAY)
    offset, doubt = clock.offset(SECOND) or (0, 0)
    assert offset == -300 - 4 * WAY and doubt == 5 * WAY


def test_the_echo_with_the_shortest_way_counts_and_its_doubt_grows_by_50_us_a_second():
    clock = Clock()
    echo(clock, SECOND, ahead=0)
    echo(clock, 3 * SECOND, ahead=5, back=3 * WAY)
    assert clock.offset(3 * SECOND) == (0, WAY + 100_000)


def test_an_echo_is_kept_for_twenty_seconds():
    clock = Clock()
    echo(clock, SECOND, ahead=0)
    echo(clock, 21 * SECOND, ahead=0)
    assert len(clock.echoes) == 2
    echo(clock, 21 * SECOND + 1, ahead=0)
    assert len(clock.echoes) == 2  # the first is gone


def waited_for(end: float) -> bool:
    return time.monotonic() > end


@pytest.mark.skipif(sys.platform != "linux", reason="the kernel's stamps are Linux's")
def test_an_echo_that_waits_for_the_loop_does_not_shift_the_clock():
    """The fish reads its socket every 20 ms, so the station's clock seemed 10 ms behind."""
    to, ours, theirs = link.Receiver(KEY), *(link.bind("127.0.0.1", 0) for _ in range(2))
    station = Sender(KEY, theirs, ours.getsockname())
    for number in range(1, 4):
        asked = time.monotonic()
        question = link.ask_datagram(KEY, to.nonce, number, time.monotonic_ns())
        ours.sendto(question, theirs.getsockname())
        station.work(asked)
        until(partial(waited_for, asked + 0.05))
        for data, waited in arrived(ours):
            to.take(data, time.monotonic_ns(), waited)
    ours.close()
    theirs.close()
    offset, doubt = to.clock.offset(time.monotonic_ns()) or (SECOND, SECOND)
    assert abs(offset) < 0.005 * SECOND and doubt < 0.005 * SECOND


def test_the_share_lost_is_of_the_last_three_hundred_that_came():
    loss = Loss()
    loss.add(5)
    assert math.isnan(loss.share())
    loss.add(9)  # 6, 7 and 8 did not come: one of four did
    assert loss.share() == pytest.approx(3 / 4)
    for sequence in range(10, 10 + 298):
        loss.add(sequence)
    assert loss.share() == pytest.approx(3 / 302)
    loss.add(308)  # the 5 is forgotten, and the gap behind it
    assert loss.share() == 0
