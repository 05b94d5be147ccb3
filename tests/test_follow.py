"""A target by the clock: what the station sends over real sockets, how fast the page thinks that it
moves, and what comes of a swim."""

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tailbeat.cli.progress import counting
from tailbeat.control.actions import PERIOD
from tailbeat.control.measure import PAPER, Measure
from tailbeat.control.policy import load_policy
from tailbeat.env.curriculum import MOVING, trained_speed
from tailbeat.evaluate.evaluation import EvaluationConfig, pool_of
from tailbeat.evaluate.following import (
    FollowConfig,
    Followed,
    _entered,
    direct,
    live,
    result,
    track,
)
from tailbeat.evaluate.path_start import TEST_SWIM, behind
from tailbeat.evaluate.store import read_record
from tailbeat.files import BadInput
from tailbeat.link import datagrams as link
from tailbeat.link.datagrams import SECOND, Frame, Order, Receiver
from tailbeat.link.reasons import Reason
from tailbeat.link.sender import Sender
from tailbeat.link.status import Numbers, State, Status, status_datagram
from tailbeat.operator import leader as leaders
from tailbeat.operator.follow import Follow, FollowRecord, Hold
from tailbeat.operator.leader import Leader, chosen_leader
from tailbeat.operator.target_motion import Trace, velocity
from tailbeat.operator.target_path import EIGHT, PathAsked, target_path
from tailbeat.report import following as page
from tailbeat.report.film_frames import Shot

KEY, RUN, POOL = bytes(range(32)), 77, (5.5, 2.7)
POLICY = load_policy("pulley-fish-pool-generator")
ASKED = PathAsked("circle", speed=0.2, seconds=8.0)
CIRCLE = target_path(ASKED)


# ---- what the station sends ---------------------------------------------------------------------


@dataclass
class Chain:
    """A station's sender and leader, and the sockets of a fish that says it is in a `state`."""

    sender: Sender
    leader: Leader
    fish: Any
    receiver: Receiver
    state: State = State.DISARMED
    text: str = "so it is"
    now: float = 1000.0
    count: int = 0
    said: tuple[str, ...] = ()

    def turn(
        self,
        seconds: float,
        state: State,
        text: str = "so it is",
        reason: Reason = Reason.SWIMMING,
    ) -> list[Frame]:
        """Camera frames, 60 a second, while the fish is in a state; returns what the fish got."""
        got = []
        for _ in range(round(60 * seconds)):
            self.now += 1 / 60
            self.count += 1
            self._speak(state, text, reason)
            self.sender.work(self.now)
            filmed = self.now - 0.03
            pose = (0.5, 0.1, 1.0)
            self.leader.lead(self.sender, pose, self.now, self._say, filmed)
            self.sender.show(Frame(round(filmed * SECOND), pose, (2.5, 1.0)))
            for data, _ in link.drain(self.fish):
                self.receiver.take(data, round(self.now * SECOND))
            got += [self.receiver.frames[0]] if self.receiver.frames else []
        return got

    def orders(self) -> list[Order]:
        return self.receiver.take_orders()

    def _say(self, text: str) -> None:
        self.said = (*self.said, text)

    def _speak(self, state: State, text: str, reason: Reason) -> None:
        to, there = self.receiver, self.sender.socket.getsockname()
        asked = link.ask_datagram(KEY, to.nonce, self.count, round(self.now * SECOND))
        taken = to.ordered.get(RUN, 0)
        status = Status(state, reason, text, 0, 0, taken, 0.0, Numbers())
        self.fish.sendto(asked, there)
        self.fish.sendto(status_datagram(KEY, RUN, to.nonce, self.count, status), there)


@pytest.fixture
def chain() -> Iterator[Chain]:
    fish, station = link.bind("127.0.0.1", 0), link.bind("127.0.0.1", 0)
    sender = Sender(KEY, station, fish.getsockname(), run=RUN)
    sender.clock = lambda: round(made.now * SECOND)
    made = Chain(sender, Leader(None, follow=Follow(CIRCLE)), fish, Receiver(KEY, POOL))
    yield made
    fish.close()
    station.close()


def test_the_target_rests_until_the_fish_swims_and_then_goes_by_the_clock(chain):
    before = [*chain.turn(1.0, State.DISARMED), *chain.turn(2.5, State.ARMED)]
    before += chain.turn(2.0, State.TEST)
    assert len(before) > 200
    assert np.abs(np.array([one.target for one in before]) - CIRCLE.at(0.0)).max() < 1e-6
    assert chain.orders()[:2] == [Order.ARM, Order.SWIM]
    moving = chain.turn(3.0, State.RUN)
    began = chain.leader.follow.began
    assert began is not None
    for one in moving[5:]:
        at = CIRCLE.at(one.captured / SECOND - began)
        assert one.target == pytest.approx(at, abs=1e-6)
    steps = np.diff([one.captured for one in moving]) / SECOND
    assert steps.max() < 0.05  # 20 places a second and more


def test_a_target_by_the_clock_waits_for_no_fish_and_its_holds_are_counted(chain, monkeypatch):
    chain.turn(0.5, State.ARMED)
    chain.turn(1.0, State.RUN)
    began = chain.leader.follow.began
    held = chain.turn(4.0, State.HOLD, "no pose for 400 ms")
    assert held[-1].target == pytest.approx(CIRCLE.at(chain.now - 0.03 - began), abs=1e-6)
    assert Order.ARM in chain.orders()[-2:]  # it is armed again
    chain.sender.target = (-1.0, -1.0)  # the operator drags it: the next frame is on the path
    swum = chain.turn(1.0, State.RUN)
    assert swum[-1].target == pytest.approx(CIRCLE.at(chain.now - 0.03 - began), abs=1e-6)
    assert not chain.leader.follow.record().finished
    chain.turn(3.0, State.RUN)
    record = chain.leader.follow.record()
    assert [(one.state, one.reason) for one in record.holds] == [("hold", "no pose for 400 ms")]
    assert record.holds[0].after == pytest.approx(1.0, abs=0.1)
    assert record.finished and len(record.seen) > 500
    monkeypatch.setattr(time, "monotonic", lambda: chain.now)
    assert chain.leader.over()


def test_a_path_ends_if_the_fish_never_swims(chain, monkeypatch):
    monkeypatch.setattr(time, "monotonic", lambda: chain.now)
    chain.leader.ran = chain.now + leaders.STARTING
    chain.turn(2.0, State.STOP, "the tail bends to the wrong side")
    assert not chain.leader.over()
    chain.now += leaders.STARTING + leaders.STUCK
    assert chain.leader.over()
    record = chain.leader.follow.record()
    assert record.began is None and not record.finished and not record.seen
    assert record.last == "stop: the tail bends to the wrong side"


@pytest.mark.parametrize(
    "reason", [Reason.STOP_ASKED, Reason.SHAFT_STUCK, Reason.OVERCURRENT, Reason.SIGN_TEST]
)
def test_a_fish_that_stopped_is_left_to_a_person(chain, reason):
    """Every frame, a tour used to disarm and arm what the operator had just stopped."""
    chain.turn(3.0, State.ARMED)
    chain.turn(1.0, State.RUN)
    chain.orders()
    chain.turn(10.0, State.STOP, reason=reason)
    assert chain.orders() == [] and chain.leader.rearmed == 0
    chain.turn(5.0, State.DISARMED, reason=Reason.NOT_ARMED)  # somebody looks after it
    assert chain.orders() == []
    chain.turn(2.5, State.ARMED)
    assert chain.orders() == [Order.SWIM]


def test_a_fish_that_the_camera_lost_is_disarmed_and_armed_again(chain):
    chain.turn(3.0, State.ARMED)
    chain.turn(1.0, State.RUN)
    chain.orders()
    chain.turn(2.5, State.STOP, reason=Reason.POSE_LOST)
    assert chain.orders()[0] is Order.DISARM
    chain.turn(2.5, State.DISARMED, reason=Reason.NOT_ARMED)
    assert chain.orders()[0] is Order.ARM and chain.leader.rearmed == 1
    chain.turn(2.5, State.ARMED)
    assert chain.orders()[0] is Order.SWIM


def test_a_fish_that_somebody_disarmed_is_not_armed(chain):
    chain.turn(3.0, State.ARMED)
    chain.turn(1.0, State.RUN)
    chain.orders()
    chain.turn(10.0, State.DISARMED, reason=Reason.NOT_ARMED)
    assert chain.orders() == []


def test_a_leader_has_a_tour_or_a_path():
    asked = PathAsked("circle")
    made = chosen_leader(0, 0, None, POOL, asked=asked)
    assert made is not None and made.attends and made.follow is not None
    with pytest.raises(ValueError, match="--path circle: give it without --tour and --begin"):
        chosen_leader(3, 0, None, POOL, asked=asked)


# ---- how fast it moves --------------------------------------------------------------------------


def test_the_velocity_is_the_slope_of_the_last_half_second():
    at = np.arange(0, 2.0, 1 / 60)
    noise = np.random.default_rng(0).normal(scale=2e-3, size=(len(at), 2))
    line = np.column_stack([1.0 - 0.12 * at, 0.3 * at])
    assert velocity(at, line) == pytest.approx((-0.12, 0.3), abs=1e-9)
    assert velocity(at, line + noise) == pytest.approx((-0.12, 0.3), abs=0.02)
    turned = np.where(at[:, None] < 1.4, [0.0, 0.0], [1.0, 1.0]) + line
    assert velocity(at, turned) == pytest.approx((-0.12, 0.3), abs=1e-9)
    held = line[::3].repeat(3, axis=0)[: len(at)]  # a page sends twenty places a second
    assert velocity(at, held) == pytest.approx((-0.12, 0.3), abs=0.02)


def test_without_enough_places_there_is_no_velocity():
    assert velocity([], []) is None and velocity([0.0], [(1.0, 1.0)]) is None
    assert velocity([0.0, 0.01, 0.02, 0.03], np.zeros((4, 2))) is None  # too short
    assert velocity([0.0, 0.2, 0.4], np.zeros((3, 2))) is None  # too few


def test_a_trace_keeps_each_frame_once_forgets_old_ones_and_begins_anew():
    trace = Trace()
    for k in range(40):
        frame = Frame(round(k * SECOND / 60), None, (0.001 * k, 0.0))
        trace.add(frame)
        trace.add(frame)
    assert len(trace.times) == 40
    assert trace.velocity(0.7) == pytest.approx((0.06, 0.0), abs=1e-6)
    assert trace.velocity(1.3) is None  # nothing new for half a second
    trace.add(Frame(0, None, (5.0, 0.0)))  # the clock was set back
    trace.add(Frame(SECOND, (0.0, 0.0, 0.0), None))
    assert list(trace.places) == [(5.0, 0.0)]


# ---- what comes of a swim -----------------------------------------------------------------------


def followed(name: str, away: float, holds: tuple[Hold, ...] = (), gap: bool = False) -> Followed:
    """A swim of one lap by a fish that stays behind the target by `away` [m] of the path."""
    path = target_path(PathAsked(name))
    after = np.arange(0.0, path.seconds, 1 / 60)
    tag, target = path.along(after - away / path.speed + path.lap), path.along(after)
    rows = np.column_stack([after, tag, np.zeros(len(after)), target])
    if gap:
        rows[600:700, 1:4] = math.nan
    seen = tuple(tuple(None if math.isnan(x) else x for x in row) for row in rows.tolist())
    pool = pool_of(POLICY, EvaluationConfig("pulley-fish", episodes=2))
    config = FollowConfig("policy", PathAsked(name))
    record = FollowRecord(5.0, True, holds, seen)
    return Followed(path, record, Path("swim.mcap"), config, POLICY, pool)


def test_a_fish_close_behind_its_target_keeps_it_and_crosses_the_eight_twice():
    done = result(followed(EIGHT, 0.2))
    assert done.kept and done.finished and not done.faults
    assert done.median_distance == pytest.approx(0.2, abs=0.01)
    assert done.mean_distance <= done.p95_distance <= done.largest_distance < 0.21
    assert done.aside_rms < 0.01 and (done.crossings, done.of) == (2, 2)
    assert done.crossings_over_2_s == 2
    assert done.target_speed == pytest.approx(8.61 / 73, rel=0.01)
    assert done.kept_within == pytest.approx(0.6 * PAPER.reach)


def test_a_fish_that_is_far_behind_or_held_is_said_to_be():
    far = result(followed("circle", 0.9))
    assert not far.kept and far.crossings is None
    assert "the target was not kept: up to 0.8" in far.faults[0] and len(far.faults) == 1
    hold = Hold(7.25, "hold", "no pose for 400 ms")
    held = result(followed("circle", 0.2, (hold,)))
    assert held.kept and held.faults == ("hold after 7.2 s: no pose for 400 ms",)


def test_a_quick_fish_has_less_time_to_settle():
    """It is 1 m ahead of its target in the first 4 s."""
    swim = followed("circle", 0.1)
    rows = np.array(swim.record.seen, float)
    rows[rows[:, 0] < 4, 1] += 1
    record = replace(swim.record, seen=tuple(map(tuple, rows.tolist())))
    pools = [replace(swim.pool, measure=m) for m in (PAPER, Measure(speed=2.0))]
    kept = [result(replace(swim, record=record, pool=pool)).kept for pool in pools]
    assert kept == [True, False]


@pytest.mark.parametrize("seconds", [3.0, 5.9])
def test_a_swim_of_which_nothing_counts_is_refused_before_it(tmp_path, seconds):
    asked = PathAsked("circle", seconds=seconds)
    with pytest.raises(BadInput, match=r"--path circle: the target moves for .* for 6 s or more"):
        live(FollowConfig("pulley-fish-pool-follow", asked), tmp_path, lambda _: None)
    assert not list(tmp_path.iterdir())


def test_where_the_fish_was_not_seen_no_place_is_guessed():
    swim = followed("circle", 0.3, gap=True)
    whole = track(swim.path, swim.record)
    hidden = np.isnan(whole.tag[:, 0])
    assert 1.5 < PERIOD * hidden.sum() < 1.75 and abs(whole.after[hidden][0] - 10.0) < 0.05
    assert result(swim).median_distance == pytest.approx(0.3, abs=0.01)


# ---- in process ---------------------------------------------------------------------------------


def test_a_swim_in_process_has_the_path_and_the_files_of_one_in_real_time(tmp_path, monkeypatch):
    """The shipped follower, 7 s in the plant; `test_follow_policy` asks how well it follows."""
    filmed: list[Shot] = []

    def not_rendered(shot: Shot, path: Path, _: object) -> None:
        filmed.append(shot)
        path.touch()

    monkeypatch.setattr(page.film, "write", not_rendered)
    said: list[str] = []
    asked = FollowConfig("pulley-fish-pool-follow", replace(ASKED, seconds=7.0))
    swum = direct(asked, counting, said.append)
    assert said == []  # 0.2 m/s: it was trained for that
    whole = track(swum.path, swum.record)
    assert whole.target == pytest.approx(swum.path.along(whole.after), abs=1e-6)
    x, y, _ = behind(swum.path, PAPER)
    nearer = np.hypot(*(swum.path.places[0] - (x, y))) - TEST_SWIM
    assert whole.distance[0] == pytest.approx(nearer, abs=0.01) and nearer > 0.2
    done = page.write(swum, tmp_path, counting, 0.5)
    assert done.log is None and done.result.kept and done.result.finished
    (shot,) = filmed
    assert shot.motion.tag[0] == pytest.approx(swum.record.seen[0][1:4], abs=1e-6)
    assert shot.motion.frames == round(0.5 * shot.motion.rate)
    for name in ("summary.json", "path.json", "report.html", "figures/path.svg"):
        assert (tmp_path / name).stat().st_size > 1000
    assert read_record(FollowRecord, tmp_path / "path.json").seen == swum.record.seen


def test_a_target_faster_than_those_of_the_training_is_said_and_one_faster_than_the_fish_refused():
    def said(policy: str, speed: float) -> list[str]:
        heard: list[str] = []
        _entered(FollowConfig(policy, PathAsked("circle", speed=speed)), heard.append)
        return heard

    assert said("pulley-fish-pool-follow", 0.25) == []
    (line,) = said("pulley-fish-pool-follow", 0.3)
    assert "moves at up to 0.30 m/s" in line and "was trained with at most 0.25 m/s" in line
    (line,) = said("pulley-fish-pool-generator", 0.1)
    assert "was trained with targets that stay" in line
    with pytest.raises(BadInput, match=r"--speed 0\.5: allowed are speeds above 0 and up to 0\.45"):
        said("pulley-fish-pool-follow", 0.5)


@pytest.mark.parametrize(("told", "speed"), [({}, 0.25), ({"target_speed": 0.1}, 0.1)])
def test_the_contract_s_own_speed_counts_before_that_of_the_task(told, speed):
    """A policy of an earlier version was exported without the number."""
    contract = load_policy("pulley-fish-pool-follow").contract
    assert trained_speed(contract) == MOVING.target_speed == 0.25
    assert trained_speed(replace(contract, training=told)) == speed
