"""The link: what is taken, what is dropped and why, and what the clocks say of each other."""

import math
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from support import until
from tailbeat.env import errors
from tailbeat.files import BadInput
from tailbeat.link import datagrams as link
from tailbeat.link.datagrams import (
    FRAMES,
    LENGTHS,
    NO_CAMERA,
    POSES,
    SECOND,
    Clock,
    Frame,
    Receiver,
    ask_datagram,
    bind,
    camera_datagram,
    drain,
    free_address,
    make_key,
    pose_datagram,
    read_key,
    stop_datagram,
    tell_datagram,
)  # fmt: skip
from tailbeat.pool.mess import lab_at

KEY, ROOM, RUN = bytes(range(32)), (5.5, 2.7), 77


def frames(first: int = 0) -> list[Frame]:
    return [Frame(first + k * 16_000_000, (0.1 * k, -0.2, 1.5), (1.0, 0.5)) for k in range(FRAMES)]


def receiver() -> Receiver:
    return Receiver(KEY, ROOM)


def sent(to: Receiver, sequence: int, given: list[Frame] | None = None, run: int = RUN) -> bytes:
    return pose_datagram(KEY, run, to.nonce, sequence, given or frames(sequence * 16_000_000))


def test_three_frames_arrive_newest_first_and_what_was_not_seen_is_none():
    to = receiver()
    given = [frames()[0], replace(frames()[1], target=None), replace(frames()[2], fish=None)]
    to.take(sent(to, 1, given), 0)
    assert to.accepted == 1 and [one.captured for one in to.frames] == [32_000_000, 16_000_000, 0]
    assert to.frames[0].fish is None and to.frames[1].target is None
    assert to.frames[1].fish == pytest.approx((0.1, -0.2, 1.5))
    assert len(sent(to, 2)) == LENGTHS[POSES] == 131


def test_old_repeated_and_reordered_datagrams_change_nothing():
    to = receiver()
    packets = [sent(to, k) for k in range(5)]
    for packet in (packets[0], packets[3], packets[3], packets[1], packets[2]):
        to.take(packet, 0)
    assert to.accepted == 2 and to.rejected == {"old": 3}
    assert to.frames[0].captured == frames(3 * 16_000_000)[-1].captured
    to.take(packets[4], 0)
    assert to.accepted == 3


def test_a_recording_of_an_earlier_start_is_of_no_use():
    before, after = receiver(), receiver()
    after.take(sent(before, 9), 0)
    assert after.rejected == {"another start's": 1} and not after.frames


def test_a_sender_that_restarts_is_taken_up_at_once():
    to = receiver()
    to.take(sent(to, 500, frames(10**12)), 0)
    to.take(sent(to, 0, frames(0), run=78), 0)
    assert to.accepted == 2 and to.frames[0].captured == 32_000_000


def test_every_single_flipped_bit_is_refused():
    to = receiver()
    packet = sent(to, 1)
    for place in range(len(packet)):
        for bit in (0, 5):
            forged = bytearray(packet)
            forged[place] ^= 1 << bit
            to.take(bytes(forged), 0)
    assert to.accepted == 0 and not to.frames and not to.orders
    assert set(to.rejected) == {"not ours", "signature"}


@pytest.mark.parametrize(
    "count", [100_000, pytest.param(1_000_000, marks=pytest.mark.slow)], ids=["few", "million"]
)
def test_random_datagrams_move_nothing(count):
    to, rng = receiver(), np.random.default_rng(0)
    heads, lengths = list(LENGTHS), list(LENGTHS.values())
    noise = rng.bytes(4096)
    for k in range(count):
        start = int(rng.integers(2000))
        size = lengths[k % 4] if k % 2 else int(rng.integers(0, 200))
        body = noise[start : start + size]
        to.take(heads[k % 4] + body[4:] if k % 3 else body, k)
    assert to.accepted == 0 and not to.frames and not to.orders and not to.clock.echoes
    assert sum(to.rejected.values()) == count


@pytest.mark.parametrize(
    "frame",
    [
        Frame(0, (0.0, float("nan"), 0.0), None),
        Frame(0, (0.0, 0.0, float("inf")), None),
        Frame(0, None, (0.0, float("inf"))),
    ],
)
def test_signed_nonsense_is_dropped_too(frame):
    to = receiver()
    to.take(sent(to, 1, [frame]), 0)
    assert to.rejected == {"implausible": 1} and not to.frames


@pytest.mark.parametrize("place", [(3.4, 2.0), (-3.4, -2.0)])
def test_a_pose_may_lie_an_eighth_of_the_pool_beyond_its_walls(place):
    to, (x, y) = receiver(), place
    to.take(sent(to, 1, [Frame(0, (x, y, 0.0), place)]), 0)
    assert to.accepted == 1 and to.far is None
    for fish, target in (((1.02 * x, y, 0.0), None), ((x, 1.03 * y, 0.0), None),
                         (None, (1.02 * x, y)), (None, (x, 1.03 * y))):  # fmt: skip
        to.take(sent(to, 2, [Frame(0, fish, target)]), 0)
    assert to.accepted == 1 and to.rejected == {"outside the pool": 4}
    assert to.far == pytest.approx((x, 1.03 * y))
    to.take(sent(to, 3, [Frame(0, (x, y, 0.0), place)]), 0)
    assert to.accepted == 2 and to.far is None


@pytest.mark.parametrize("level", ["everyday", "rough", "wrecked"])
def test_a_camera_of_a_messy_lab_never_puts_a_fish_at_a_wall_outside_the_pool(level):
    """Else the robot has no pose until somebody moves the fish: with 3 cm allowed, a tour of an
    everyday lab ended there after 20 of 50 targets."""
    wrong = errors.rows([lab_at(level, seed).errors for seed in range(300)])
    sides = np.array(ROOM) / 2 - 0.1  # the tag is so far from the nose
    for corner in (sides * (-1, -1), sides * (-1, 1), sides * (1, -1), sides * (1, 1)):
        found = errors.filmed(wrong, np.tile([*corner, 0.3], (300, 1)))
        to = receiver()
        for number, (x, y, yaw) in enumerate(found):
            to.take(sent(to, number, [Frame(0, (x, y, yaw), None)]), 0)
        assert to.accepted == 300


def test_time_that_runs_backwards_within_a_run_is_dropped():
    to = receiver()
    to.take(sent(to, 1, frames(5 * SECOND)), 0)
    to.take(sent(to, 2, frames(4 * SECOND)), 0)
    assert to.rejected == {"time runs backwards": 1}
    to.take(sent(to, 3, frames(5 * SECOND)), 0)  # the camera gave no new frame
    assert to.accepted == 2


def test_the_numbers_on_the_wire_stay_what_they_are():
    """A station and a fish of two versions must understand each other."""
    assert [one.value for one in link.Order] == [1, 2, 3, 4]
    assert list(LENGTHS.values()) == [131, 68, 76, 53, 76]
    head, first = 28, sent(receiver(), 7, [Frame(9, None, (1.0, 0.5))])[28:57]
    assert link.HEAD.size == head and link.FRAME.unpack(first) == (9, 2, 0, 0, 0, 1.0, 0.5)


def test_a_whole_datagram_that_is_cut_or_of_another_kind_is_not_ours():
    to = receiver()
    packet = sent(to, 1)
    for data in (
        packet[:-1],
        packet + b"x",
        b"",
        link.sign(KEY, packet[:-20]),
        b"tbX9" + packet[4:],
    ):
        to.take(data, 0)
    assert to.rejected == {"not ours": 5}
    assert link.is_signed(KEY, packet, POSES, len(packet))
    assert not link.is_signed(KEY, packet, link.ORDER, len(packet))
    assert not link.is_signed(KEY, packet, POSES, len(packet) + 1)
    assert [len(link.sign(KEY, b"x")), link.sign(KEY, b"x")[:1]] == [17, b"x"]


def test_more_than_three_frames_send_the_newest_three():
    to = receiver()
    to.take(sent(to, 1, [*frames(), Frame(48_000_000, None, None)]), 0)
    assert [one.captured for one in to.frames] == [48_000_000, 32_000_000, 16_000_000]


def test_the_first_poses_after_an_answer_may_have_number_0():
    to = receiver()
    answer = tell_datagram(KEY, RUN, ask_datagram(KEY, to.nonce, 0, 0), 200, 210)
    assert answer is not None
    to.take(answer, 20)
    to.take(sent(to, 0), 20)
    assert to.accepted == 1 and not to.rejected


def test_a_socket_gives_no_more_than_asked_and_never_waits():
    fish, station = bind("127.0.0.1", 0), bind(*free_address())
    assert not fish.getblocking() and list(drain(fish)) == []
    for _ in range(5):
        station.sendto(b"x", fish.getsockname())
    assert len(list(drain(fish, 3))) == 3 and len(list(drain(fish))) == 2
    assert free_address()[1] > 1023  # the system chose it
    for one in (fish, station):
        one.close()


def test_stop_waits_for_the_loop_and_needs_the_key_and_this_start():
    to = receiver()
    to.take(stop_datagram(bytes(32), RUN, to.nonce, 1), 0)
    to.take(stop_datagram(KEY, RUN, to.nonce + 1, 1), 0)
    assert not to.take_orders()
    to.take(stop_datagram(KEY, RUN, to.nonce, 1), 0)
    assert to.stopped and to.take_orders() == [link.Order.STOP]


def test_a_sender_answers_signed_questions_only():
    asked = ask_datagram(KEY, 5, 1, 100)
    assert tell_datagram(KEY, RUN, asked, 200, 210) is not None
    assert tell_datagram(bytes(32), RUN, asked, 200, 210) is None
    assert tell_datagram(KEY, RUN, asked[:-1] + b"x", 200, 210) is None


def test_an_answer_counts_once_and_only_with_times_that_can_be():
    to = receiver()

    def answer(sequence: int, asked: int, received: int, sent: int) -> bytes:
        packet = tell_datagram(
            KEY, RUN, ask_datagram(KEY, to.nonce, sequence, asked), received, sent
        )
        assert packet is not None
        return packet

    to.take(answer(1, 100, 900, 910), 200)
    assert len(to.clock.echoes) == 1
    to.take(answer(1, 100, 900, 910), 201)  # replayed
    to.take(answer(2, 300, 900, 910), 299)  # answered before it was asked
    to.take(answer(3, 250, 911, 910), 300)  # sent before it was received
    assert len(to.clock.echoes) == 1 and to.rejected["old"] == 3
    to.take(answer(4, 300, 920, 920), 300)  # at once is possible
    assert len(to.clock.echoes) == 2


def test_a_frame_s_age_is_right_though_the_clocks_differ_drift_and_the_net_is_uneven():
    """The station's clock is 40 s ahead and 30 ppm fast; ways of 1 to 40 ms, not the same there and
    back."""
    rng, to, ahead, fast = np.random.default_rng(2), receiver(), 40 * SECOND, 1 + 30e-6

    def theirs(now: float) -> int:
        return round(now * fast) + ahead

    worst = 0.0
    for k in range(100):
        asked = k * SECOND // 4
        there, back = (rng.exponential(8e6, 2) + 1e6).round()
        question = ask_datagram(KEY, to.nonce, k, asked)
        answer = tell_datagram(
            KEY, RUN, question, theirs(asked + there), theirs(asked + there + 5e4)
        )
        assert answer is not None
        now = round(asked + there + 5e4 + back)
        to.take(answer, now)
        found = to.clock.offset(now)
        assert found is not None
        assert abs(found[0] - (theirs(now) - now)) <= found[1]
        frame = Frame(theirs(now - 30e6), None, None)
        age = to.age(frame, now)
        assert age is not None
        worst = max(worst, abs(age - 0.030)) if k > 20 else worst
    assert worst < 0.003
    assert receiver().age(frames()[0], 0) is None  # no echo, no age


def test_echoes_are_forgotten_after_a_while():
    clock = Clock()
    clock.add(0, 1000, 1000, 10)
    clock.add(30 * SECOND, 30 * SECOND + 5000, 30 * SECOND + 5000, 30 * SECOND + 4000)
    assert len(clock.echoes) == 1


def test_datagrams_cross_a_real_socket_and_a_stranger_s_are_counted():
    fish, station = bind("127.0.0.1", 0), bind("127.0.0.1", 0)
    to = receiver()
    for k in range(10):
        station.sendto(sent(to, k), fish.getsockname())
        station.sendto(b"hello", fish.getsockname())

    def heard() -> bool:
        for data, _ in drain(fish):
            to.take(data, time.monotonic_ns())
        return to.accepted + to.rejected["not ours"] == 20

    until(heard)
    assert to.accepted == 10 and to.rejected == {"not ours": 10}
    with pytest.raises(BadInput, match="choose another address or port"):
        bind(*fish.getsockname())
    with pytest.raises(BadInput, match="give the address of one"):
        bind("0.0.0.0", 0)
    for one in (fish, station):
        one.close()


def test_the_pool_s_size_is_told_with_the_clock_and_bounds_the_poses():
    to, far = Receiver(KEY), [Frame(10, (4.5, 1.8, 0.0), None)]
    to.take(pose_datagram(KEY, RUN, to.nonce, 1, far), 0)
    assert to.rejected == {"outside the pool": 1}  # that is assumed
    question = ask_datagram(KEY, to.nonce, 1, 0)
    for told in ((10.0, 0.0), (math.nan, 4.0), (1e4, 4.0)):
        answer = tell_datagram(KEY, RUN, question, 200, 210, told)
        assert answer is not None
        to.take(answer, 20)
        assert to.room == (5.5, 2.7)
    answer = tell_datagram(KEY, RUN, question, 200, 210, (10.0, 4.0))
    assert answer is not None
    to.take(answer, 20)
    to.take(pose_datagram(KEY, RUN, to.nonce, 2, far), 30)
    assert to.room == (10.0, 4.0) and to.frames[0].fish is not None


def test_the_calibration_of_the_sender_that_is_followed_is_known():
    to, digest = Receiver(KEY), bytes(range(32))
    to.take(camera_datagram(KEY, RUN, to.nonce, 1, digest), 0)
    assert to.calibration is None and to.rejected == {"old": 1}  # nobody is followed yet
    for run in (RUN, RUN + 1):
        to.take(sent(to, 1, run=run), 0)
        assert to.calibration is None
        to.take(camera_datagram(KEY, run, to.nonce, 1, digest), 0)
        assert to.calibration == digest
    to.take(camera_datagram(KEY, RUN, to.nonce, 2, NO_CAMERA), 0)  # a sender that was replaced
    assert to.calibration == digest


def test_keys_are_private_whole_and_never_overwritten(tmp_path: Path):
    path = tmp_path / "fish.key"
    make_key(path)
    assert len(read_key(path)) == 32 and path.stat().st_mode & 0o777 == 0o600
    with pytest.raises(BadInput, match="exists already"):
        make_key(path)
    path.chmod(0o644)
    with pytest.raises(BadInput, match="other users may read"):
        read_key(path)
    path.chmod(0o600)
    path.write_bytes(b"short")
    with pytest.raises(BadInput, match="5 bytes"):
        read_key(path)
    with pytest.raises(BadInput, match="no key"):
        read_key(tmp_path / "none")
