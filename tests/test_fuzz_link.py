"""Whatever arrives at a port: nothing is raised, and no wrong pose or order is believed.

`test_link.py` sends noise and flipped bits. Here the signature is right and the content odd: a
station with a fault, or somebody who has the key.
"""

import math

import pytest
from hypothesis import given, settings
from hypothesis import seed as seeded
from hypothesis import strategies as st

from tailbeat.link import datagrams as link
from tailbeat.link.datagrams import (
    CAMERA,
    FRAMES,
    HEAD,
    LENGTHS,
    MAC_BYTES,
    MARGIN,
    ORDER,
    ORDERED,
    POOL_SIZE,
    POSES,
    TELL,
    TIMES,
    YAW,
    Frame,
    Order,
    Receiver,
    drain,
    sign,
)  # fmt: skip
from tailbeat.link.places import LARGEST
from tailbeat.link.sender import Sender
from tailbeat.link.status import LENGTH, STATUS, State, read_status

KEY = bytes(range(32))
BIG = st.integers(0, 2**64 - 1) | st.sampled_from([0, 1, 2**63, 2**64 - 1])
SINGLE = st.floats(width=32) | st.sampled_from([math.nan, math.inf, -math.inf, 3e38, -0.0])
HEADS = st.tuples(st.sampled_from([0, 77, 78, 2**64 - 1]), st.booleans(), BIG)


def runs(few: int, many: int):
    return pytest.mark.parametrize(
        "count", [few, pytest.param(many, marks=pytest.mark.slow)], ids=["few", "many"]
    )


def fuzzed(count: int):
    return lambda test: seeded(0)(settings(max_examples=count, deadline=None, database=None)(test))


@st.composite
def bodies(draw) -> tuple[bytes, bytes]:
    """The kind and the content of a datagram, of the right length or not."""
    kind = draw(st.sampled_from([POSES, TELL, ORDER, CAMERA, STATUS, b"tbX9"]))
    if kind == POSES:
        frames = [(draw(BIG), draw(st.integers(0, 255)), *(draw(SINGLE) for _ in range(5)))
                  for _ in range(FRAMES)]  # fmt: skip
        body = b"".join(link.FRAME.pack(*one) for one in frames)
    elif kind == TELL:
        body = TIMES.pack(*(draw(BIG) for _ in range(3)))
        body += POOL_SIZE.pack(draw(SINGLE), draw(SINGLE))
    elif kind == ORDER:
        body = ORDERED.pack(draw(BIG), draw(st.integers(0, 255)))
    elif kind == CAMERA:
        body = draw(st.binary(min_size=32, max_size=32))
    else:
        body = draw(st.binary(max_size=200))
    return kind, body[: draw(st.sampled_from([None, None, None, -1, 0, 7]))]


def believable(frame: Frame, room: tuple[float, float]) -> bool:
    places = [p for p in (frame.fish and frame.fish[:2], frame.target) if p]
    margin = MARGIN * max(room)
    inside = [abs(v) <= side / 2 + margin for p in places for v, side in zip(p, room, strict=True)]
    return all(inside) and (frame.fish is None or abs(frame.fish[2]) <= YAW)


@pytest.mark.thorough
@runs(500, 200_000)
def test_signed_datagrams_with_odd_content_never_raise_and_no_wrong_pose_is_believed(count):
    @fuzzed(count)
    @given(st.lists(st.tuples(HEADS, bodies(), st.booleans(), BIG), max_size=8))
    def held(datagrams):
        to = Receiver(KEY)
        for (run, ours, number), (kind, body), signed, now in datagrams:
            head = HEAD.pack(kind, run, to.nonce if ours else number, number)
            rooms = to.room
            to.take(sign(KEY, head + body) if signed else head + body, now % 2**63)
            assert all(believable(one, rooms) for one in to.frames)
            assert all(0 < side <= LARGEST for side in to.room)
            assert all(one in tuple(Order) for one in to.orders)
            offset = to.clock.offset(now % 2**63)
            assert offset is None or all(map(math.isfinite, offset))
            for one in to.frames:
                age = to.age(one, now % 2**63)
                assert age is None or math.isfinite(age)
        assert sum(to.rejected.values()) + to.accepted <= len(datagrams)

    held()


STATUS_BODY = LENGTH - HEAD.size - MAC_BYTES
ASK_BODY = LENGTHS[link.ASK] - HEAD.size - MAC_BYTES
received = st.tuples(
    BIG, BIG, BIG, st.binary(min_size=STATUS_BODY, max_size=STATUS_BODY), st.booleans()
)


@pytest.mark.thorough
@runs(500, 50_000)
def test_a_station_that_is_sent_odd_statuses_and_questions_goes_on(count):
    with link.bind("127.0.0.1", 0) as station, link.bind("127.0.0.1", 0) as fish:

        @fuzzed(count)
        @given(st.lists(received, max_size=5))
        def held(given_):
            made = Sender(KEY, station, fish.getsockname(), run=7)
            made.order(Order.STOP, 0.0)
            for run, nonce, number, body, asks in given_:
                kind, size = (link.ASK, ASK_BODY) if asks else (STATUS, STATUS_BODY)
                head = HEAD.pack(kind, 7 if run % 2 else run, nonce, number)
                fish.sendto(sign(KEY, head + body[:size]), station.getsockname())
                made.work(0.1)
                made.show(Frame(1, None, None))
            assert made.status is None or made.status.state in tuple(State)
            list(drain(fish))

        held()


@pytest.mark.parametrize("place", [0, 1], ids=["state", "reason"])
def test_a_status_of_a_later_version_is_no_status(place):
    body = bytearray(STATUS_BODY)
    assert read_status(KEY, sign(KEY, HEAD.pack(STATUS, 7, 1, 1) + body)) is not None
    body[place] = 200
    assert read_status(KEY, sign(KEY, HEAD.pack(STATUS, 7, 1, 1) + body)) is None


def test_an_answer_that_took_longer_at_the_station_than_in_all_is_refused():
    to = Receiver(KEY)
    asked = link.ask_datagram(KEY, to.nonce, 1, 1000)
    told = link.tell_datagram(KEY, 7, asked, 0, 10**9)
    assert told is not None
    to.take(told, 2000)
    assert to.rejected == {"implausible": 1} and to.clock.offset(2000) is None


def test_a_yaw_that_no_float32_tells_is_refused():
    to = Receiver(KEY)
    to.take(link.pose_datagram(KEY, 7, to.nonce, 1, [Frame(0, (0.0, 0.0, 1e30), None)]), 0)
    assert to.rejected == {"implausible": 1} and not to.frames
