"""Which readings are believed, and how the loop's punctuality is counted."""

import math
import time

import numpy as np
import pytest

pytest.importorskip("serial", reason="the robot extra is not installed")

from tailbeat.link.datagrams import SECOND, Frame
from tailbeat.robot.plausible import (
    Bounds,
    Gate,
    clock_step,
    gated,
    pose_follows,
    shaft_follows,
)
from tailbeat.robot.timing import Spread, sleep_until

BOUNDS = Bounds()


def believed(rates: list[float]) -> tuple[list[float], int]:
    gate, taken = Gate(), []
    for rate in rates:
        gate, good = gated(gate, rate, BOUNDS)
        taken += [rate] if good else []
    return taken, gate.count


def test_a_swim_s_own_rates_all_pass():
    rates = (2.0 * np.sin(2 * np.pi * 2.0 * 0.02 * np.arange(100))).tolist()
    assert believed(rates) == (rates, 0)


def test_a_spike_passes_by_and_spikes_in_every_second_reading_do_too():
    assert believed([0.1, 20.0, 0.2, -0.1]) == ([0.1, 0.2, -0.1], 1)
    assert believed([0.1, 5.0, 0.2, 5.0, 0.3]) == ([0.1, 0.2, 0.3], 2)


def test_a_real_change_is_taken_one_reading_late_and_the_impossible_never():
    assert believed([0.0, 5.0, 5.1, 5.2]) == ([0.0, 5.1, 5.2], 1)
    assert believed([0.0, 20.0, 20.0, 20.0]) == ([0.0], 3)
    assert believed([math.nan, 0.1]) == ([0.1], 1)


def frame(seconds: float, x: float, yaw: float) -> Frame:
    return Frame(round(seconds * SECOND), (x, 0.0, yaw), None)


@pytest.mark.parametrize(
    ("new", "follows"),
    [
        (frame(0.017, 0.02, 0.1), True),
        (frame(0.017, 0.2, 0.1), False),  # 11 m/s
        (frame(0.017, 0.0, math.pi), False),  # a tag read the wrong way round
        (frame(1.0, 0.6, 3.0), True),  # after a second without frames
        (frame(0.017, 0.0, 2 * math.pi - 0.1), True),  # the same heading, once round
    ],
)
def test_a_pose_must_be_where_a_fish_can_come(new, follows):
    assert pose_follows(frame(0.0, 0.0, 0.0), new, BOUNDS) is follows


def readings(asked: list[float], seen: list[float], period: float = 0.02):
    return [(3.0 + period * k, *pair) for k, pair in enumerate(zip(asked, seen, strict=True))]


def test_a_shaft_that_is_asked_to_move_must():
    asked = [0.05 * k for k in range(30)]
    assert not shaft_follows(readings(asked, [0.1] * 30), BOUNDS)
    assert shaft_follows(readings(asked, [0.04 * k for k in range(30)]), BOUNDS)
    assert shaft_follows(readings([0.3] * 30, [0.1] * 30), BOUNDS)  # held: nothing is asked
    assert shaft_follows([], BOUNDS)
    assert shaft_follows(readings(asked[:24], [0.1] * 24), BOUNDS)  # not yet half a second
    sudden = [0.0] * 27 + [0.2, 0.4, 0.6]  # a beat that begins: nothing could follow yet
    assert shaft_follows(readings(sudden, [0.0] * 30), BOUNDS)
    assert not shaft_follows(readings(sudden + [0.6] * 8, [0.0] * 38), BOUNDS)


@pytest.mark.parametrize(("kept", "latest"), [(0.2, 4.2), (0.4, 3.8), (0.9, 3.7)])
def test_lost_readings_hide_no_jam_and_make_none(kept, latest):
    """A jam was told from 25 readings, whatever time they took: here at 5.1, 4.1 and 3.5 s."""
    random = np.random.default_rng(5)
    at = 0.02 * np.flatnonzero(random.random(400) < kept)
    asked, late = (0.5 * np.sin(2 * np.pi * 2.0 * (at - delay)) for delay in (0.0, 0.06))
    swims = list(zip(at, asked, late, strict=True))
    jammed = list(zip(at, asked, np.where(at < 3.0, late, 0.2), strict=True))
    told = [at[k] for k in range(len(at)) if not shaft_follows(jammed[: k + 1], BOUNDS)]
    assert all(shaft_follows(swims[: k + 1], BOUNDS) for k in range(len(at)))
    assert 3.3 < told[0] < latest


def test_a_step_of_the_clock_is_told_from_slow_echoes_and_drift():
    ms = SECOND // 1000
    quiet = [(k * 250 * ms, 37 * SECOND + k * 5000, 2 * ms) for k in range(20)]  # 20 ppm
    assert clock_step(quiet, BOUNDS) == 0
    late = [*quiet, (5 * SECOND, 37 * SECOND + 100 * ms, 210 * ms)]  # one way slow: explained
    assert clock_step(late, BOUNDS) == 0
    assert clock_step([*quiet, (5 * SECOND, 42 * SECOND, 2 * ms)], BOUNDS) == 5 * SECOND
    assert clock_step([*quiet, (5 * SECOND, 32 * SECOND, 2 * ms)], BOUNDS) == -5 * SECOND
    assert clock_step(quiet[:1], BOUNDS) == 0


def test_quantiles_of_counted_durations_are_those_of_the_durations():
    rng, spread = np.random.default_rng(0), Spread()
    durations = rng.exponential(1e-3, 20_000)
    for one in durations:
        spread.add(float(one))
    for share in (0.5, 0.99, 0.999):
        exact = float(np.quantile(durations, share))
        assert spread.quantile(share) == pytest.approx(exact, abs=1.1e-5 + 0.01 * exact)
    assert spread.most == durations.max() and math.isnan(Spread().quantile(0.5))


def test_waiting_never_ends_early():
    for wait in (0.0, 0.0001, 0.003):
        due = time.monotonic() + wait
        sleep_until(due)
        assert time.monotonic() >= due
