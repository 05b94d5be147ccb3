"""The robot's models and statistics on signals whose exact answer is known: no fish swims."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tailbeat.control import consistency as at
from tailbeat.control import expected as looks
from tailbeat.control import sign_test
from tailbeat.control.actions import PERIOD
from tailbeat.control.expected import Expected, Limits, ShaftModel, ShaftState
from tailbeat.files import BadInput

LIMITS = Limits(0.1, 0.1, 0.5, 1.5, 0.5, 1.5, 0.01)
FREE = ShaftModel(0.0, 0.0, 1e9, 0.0, 0.0, 0.05, 0.0, 0.0)  # an inertia alone


def expecting(*recoil: float, angle: float = 0.0, rate: float = 0.0) -> Expected:
    return Expected(FREE, recoil, LIMITS, angle, rate, 60.0)


def path(model: ShaftModel, setpoint: float, periods: int) -> np.ndarray:
    state, found = looks.held(model, 0.0), []
    for _ in range(periods):
        state = looks.turn(model, state, setpoint)
        found.append(state.angle)
    return np.array(found)


# ---- the shaft's model --------------------------------------------------------------------------


@pytest.mark.parametrize("delay", [0.0, 0.006, 0.02, 0.054])
def test_the_modelled_shaft_swings_as_a_damped_spring_does(delay: float) -> None:
    """A step on m x'' + (kv + damping) x' + (kp + stiffness) x = kp u, by its exact solution."""
    model = ShaftModel(4.0, 0.05, 1e9, delay, 0.0, 0.05, 0.15, 1.0)
    time = np.maximum(PERIOD * np.arange(1, 61) - delay, 0.0)
    decay, beat = 0.2 / (2 * 0.05), math.sqrt(5.0 / 0.05)
    damped = math.sqrt(beat**2 - decay**2)
    swing = np.cos(damped * time) + decay / damped * np.sin(damped * time)
    exact = 0.3 * 4 / 5 * (1 - np.exp(-decay * time) * swing)
    assert path(model, 0.3, 60) == pytest.approx(exact, abs=0.002)


def test_no_spring_is_too_stiff_for_the_modelled_shaft() -> None:
    model = ShaftModel(2e4, 0.0, 1e9, 0.0, 0.0, 1e-3, 0.4, 2e4)
    assert path(model, 0.3, 300)[-1] == pytest.approx(0.15, rel=1e-3)
    damped = ShaftModel(1.0, 30.0, 1e9, 0.0, 0.0, 1e-3, 30.0, 1.0)
    assert 0 < path(damped, 0.3, 200)[-1] < 0.15  # it creeps


def test_dry_friction_stops_a_free_shaft_in_its_time() -> None:
    """At 1 rad/s, 0.1 N m of friction and 0.05 kg m^2: half a second, a quarter radian."""
    model = ShaftModel(0.0, 0.0, 1e9, 0.0, 0.1, 0.05, 0.0, 0.0)
    state = ShaftState(0.0, 1.0, (0.0, 0.0))
    for _ in range(20):
        state = looks.turn(model, state, 0.0)
    assert state.velocity == pytest.approx(0.2, abs=0.01)  # after 0.4 s
    for _ in range(20):
        state = looks.turn(model, state, 0.0)
    assert abs(state.velocity) < 0.01 and state.angle == pytest.approx(0.25, abs=0.01)


# ---- statistics ---------------------------------------------------------------------------------


def window(seconds: float = 3.0) -> np.ndarray:
    """Rows of a fish that beats at 1.5 Hz and swims at 0.2 m/s; a frame every second period."""
    time = PERIOD * np.arange(round(seconds / PERIOD))
    rows = np.zeros((len(time), len(at.COLUMNS)))
    rows[:, at.TIME] = time
    rows[:, at.ANGLE] = rows[:, at.MODELLED] = 0.4 * np.sin(2 * np.pi * 1.5 * time)
    rows[:, at.STAMP] = 2 * PERIOD * (np.arange(len(time)) // 2)
    rows[:, at.X], rows[:, at.Y] = 0.12 * rows[:, at.STAMP], -0.16 * rows[:, at.STAMP]
    return rows


def test_the_turning_is_the_camera_s_less_the_imu_s() -> None:
    rows = window()
    rows[:, at.TURNED], rows[:, at.YAW] = 0.7 * rows[:, at.TIME], 0.5 * rows[:, at.STAMP] + 1
    assert at.turning(rows) == pytest.approx(-0.2)
    assert math.isnan(at.turning(rows[: 2 * at.FEWEST - 2]))  # too few frames
    rows = window(10.0)
    late = rows[:, at.STAMP] - (rows[-1, at.TIME] - at.NEWEST)
    rows[:, at.YAW] = 0.3 * rows[:, at.STAMP] + 0.1 * np.maximum(late, 0.0)
    assert at.drifting(rows) == pytest.approx(0.1, abs=1e-3)
    assert math.isnan(at.drifting(rows[-round(7 / PERIOD) :]))  # under 5 s came before


def test_a_late_camera_does_not_seem_to_turn_when_the_fish_begins_to() -> None:
    """40 ms more than its stamps say. Tours in everyday labs warned of this for whole minutes."""
    rows = window(20.0)
    time, lag = rows[:, at.TIME], 0.04
    rows[:, at.RATE] = np.where(time > 18.5, 1.5, 0.0) + np.sin(2 * np.pi * 1.5 * time)
    turned = np.concatenate([[0.0], np.cumsum((rows[1:, at.RATE] + rows[:-1, at.RATE]) / 2)])
    rows[:, at.TURNED] = PERIOD * turned
    rows[:, at.YAW] = np.interp(rows[:, at.STAMP] - lag, time, rows[:, at.TURNED])
    half = rows[time <= 17.5], rows[time > 17.5]
    assert abs(at.turning(half[1]) - at.turning(half[0])) > 0.02  # what was taken for a drift
    assert at.drifting(rows) == pytest.approx(0.0, abs=3e-3)
    rows[:, at.YAW] += 0.02 * np.maximum(rows[:, at.STAMP] - 17.5, 0.0)
    assert at.drifting(rows) == pytest.approx(0.02, abs=3e-3)


def test_the_stroke_is_compared_with_the_shaft_s_own_before() -> None:
    rows, expected = window(10.0), expecting()
    rows[:, at.ANGLE] *= 0.8
    rows[-round(at.SPAN / PERIOD) :, at.ANGLE] *= 0.5
    assert at.weakening(rows, expected) == pytest.approx(0.5, abs=1e-6)
    assert math.isnan(at.weakening(rows[-round(3.9 / PERIOD) :], expected))  # under 2 s before
    rows[: -round(at.SPAN / PERIOD), at.ANGLE] = 0.1  # frozen: the gain before is 0
    assert math.isnan(at.weakening(rows, expected))


def test_stroke_and_recoil_are_the_factors_that_were_put_in() -> None:
    rows, expected = window(), expecting(0.5, -0.2, 0.1)
    rows[:, at.ANGLE] = 0.3 * rows[:, at.MODELLED] + 0.2 + 0.1 * rows[:, at.TIME]  # lines are none
    assert at.stroke(rows, expected) == pytest.approx(0.3)
    rows[2:, at.RATE] = 0.6 * at.predicted(rows[:, at.ANGLE], expected)
    newest = rows[-1, at.ANGLE], rows[-2, at.ANGLE], rows[-3, at.ANGLE]
    assert rows[-1, at.RATE] == pytest.approx(0.6 * np.dot(newest, [0.5, -0.2, 0.1]))
    assert at.recoil(rows, expected) == pytest.approx(0.6)
    rms = float(np.std(at.straightened(rows[:, at.MODELLED])))
    assert at.stroke(rows, expecting(1.0, angle=0.99 * rms)) == pytest.approx(0.3)
    assert math.isnan(at.stroke(rows, expecting(1.0, angle=1.01 * rms)))


def test_a_window_says_nothing_until_it_is_long_enough_and_forgets_what_is_old() -> None:
    rows, expected = window(6.0), expecting(0.5, -0.2, 0.1)
    rows[:, at.TIME] += 100.0
    rows[:, at.STAMP] += 100.0
    rows[2:, at.RATE] = at.predicted(rows[:, at.ANGLE], expected)
    short, long = (rows[-round(span / PERIOD) :] for span in (at.SPAN, at.SPAN + 0.04))
    assert all(map(math.isnan, vars(at.signs(short, expected)).values()))
    assert all(map(math.isnan, vars(at.signs(rows[:1], expected)).values()))
    found = at.signs(long, expected)
    assert found.stroke == found.recoil == pytest.approx(1.0)
    assert math.isnan(found.drifting) and found.turning == pytest.approx(0.0, abs=1e-9)
    age = rows[-1, at.TIME] - rows[:, at.TIME]
    old = age > at.SHORT + PERIOD / 2
    rows[old, at.ANGLE] *= 0.5
    rows[old, at.TARGET] = 0.3 * (np.arange(old.sum()) % 4)
    rows[age > at.SPAN + PERIOD / 2, at.YAW] = 3.0
    later = at.signs(rows, expected)
    assert (later.stroke, later.wander) == pytest.approx((1.0, 0.0))
    assert later.turning == pytest.approx(0.0, abs=1e-9)


def test_a_line_is_straightened_to_nothing() -> None:
    assert at.straightened(3.0 - 0.5 * np.arange(6.0, dtype=np.float64)) == pytest.approx(
        np.zeros(6), abs=1e-12
    )
    assert at.slope(np.array([1.0, 2.0, 4.0]), np.array([1.0, 4.0, 10.0])) == pytest.approx(3.0)
    assert math.isnan(at.slope(np.ones(1), np.ones(1)))


def test_the_progress_is_the_speed_over_the_motor_s() -> None:
    rows = window()
    beat = np.std(np.diff(rows[:, at.ANGLE]) / PERIOD)
    expected = expecting(1.0, angle=0.2)
    frames = at.distinct(rows)
    assert at.progress(rows, frames, expected) == pytest.approx(0.2 / beat)
    assert math.isnan(at.progress(rows, frames[: at.FEWEST - 1], expected))
    assert math.isnan(at.progress(rows, frames, expecting(1.0, angle=0.3)))  # no beat so large


@pytest.mark.parametrize("count", [1, 2, 7])
def test_equal_poses_are_counted(count: int) -> None:
    frames = at.distinct(window())
    frames[-count:, at.X : at.YAW + 1] = frames[-1, at.X : at.YAW + 1]
    assert at.same_poses(frames) == count
    frames[:, at.X : at.YAW + 1] = 0.0
    assert at.same_poses(frames) == len(frames) and at.same_poses(frames[:0]) == 0


def test_a_target_wanders_by_its_path_less_its_displacement() -> None:
    frames = at.distinct(window())
    frames[:, at.TARGET] = 5 + 0.3 * np.arange(len(frames))
    assert at.wander(frames) == pytest.approx(0.0, abs=1e-9)
    frames[:, at.TARGET] = 0.3 * (np.arange(len(frames)) % 2)
    across = 0.3 * (len(frames) - 1)
    assert at.wander(frames) == pytest.approx(across - 0.3 * ((len(frames) - 1) % 2))
    assert at.wander(frames[:1]) == 0.0


# ---- the sign test ------------------------------------------------------------------------------


@pytest.mark.parametrize(("low", "high", "rest"), [(-0.3, 0.2, 0.0), (-1.4, 1.4, 0.0), (1, 2, 1.5)])
def test_the_program_beats_bends_and_goes_back(low: float, high: float, rest: float) -> None:
    plan = sign_test.program((1.0, 4.0), low, high)
    away, room = plan.setpoints - rest, sign_test.SHARE * (high - low) / 2
    stroke, bend = min(sign_test.STROKE, room), min(sign_test.HELD, room)
    assert not away[: plan.beats.start].any()
    assert np.abs(away[plan.beats]).max() == pytest.approx(stroke, rel=0.05)
    assert away[plan.bend][-1] == pytest.approx(bend)
    first, count = plan.bend.stop + round(sign_test.BACK / PERIOD), len(away[plan.bend])
    other = slice(first, first + count)  # the bend to the right
    back = away[plan.bend.stop - 1 : other.start]
    assert (np.diff(back) < 0).all() and back[-1] == pytest.approx(0.0, abs=1e-9)
    assert np.array_equal(away[other], -away[plan.bend])
    assert away[-1] == pytest.approx(0.0, abs=1e-9) and len(away) - other.stop == len(back) - 1
    spans = plan.beats.start, plan.bend.stop - plan.bend.start, len(back) - 1
    wanted = [sign_test.STILL, sign_test.BEND, sign_test.BACK]
    assert [PERIOD * span for span in spans] == pytest.approx(wanted)


def test_the_sign_test_measures_the_tag_s_motion_beyond_its_drift() -> None:
    """The camera's picture drifts sideways; the tag moves 50 mm at 30 degrees to its heading."""
    plan = sign_test.program((1.0, 4.0), -1.4, 1.4)
    time = PERIOD * np.arange(len(plan.setpoints))
    rows = np.zeros((len(time), len(at.COLUMNS)))
    rows[:, at.TIME] = rows[:, at.STAMP] = time
    share = np.clip((time - time[plan.beats.start]) / (time[plan.beats.stop] - time[0]), 0, 1)
    share = np.where(time > time[plan.beats.stop], 1.0, share)
    rows[:, at.X] = 0.05 * math.cos(0.5) * share + 0.02 * time
    rows[:, at.Y] = 0.05 * math.sin(0.5) * share - 0.01 * time
    rows[:, at.YAW] = 0.5 - math.radians(30)
    forward, askew = sign_test.motion(plan, rows)
    assert forward == pytest.approx(0.05) and askew == pytest.approx(math.radians(30))
    rows[plan.beats.stop :, at.STAMP] = np.nan  # the tag is gone
    assert all(map(math.isnan, sign_test.motion(plan, rows)))


# ---- in the policy's file -----------------------------------------------------------------------


def kept(taps: int, **shaft: float) -> Expected:
    """Expectations with so many weights and other numbers of the shaft."""
    sound = {"kp": 1.0, "force_limit": 1.0, **shaft}
    return replace(expecting(*[0.1] * taps), shaft=replace(FREE, **sound))


@pytest.mark.parametrize("fits", [kept(2), kept(100), kept(3, delay=0.2), kept(3, inertia=0.5)])
def test_expectations_are_read_as_they_were_written(fits: Expected) -> None:
    assert looks.read(Path("p"), looks.as_text(fits)) == fits
    assert looks.read(Path("p"), None) is None


@pytest.mark.parametrize(
    ("odd", "said"),
    [
        (kept(1), "its recoil is not one of a fish"),
        (kept(101), "its recoil is not one of a fish"),
        (kept(3, inertia=0.0), "inertia is 0.0, allowed is"),
        (kept(3, delay=-0.01), "a delay of -0.01 s"),
        (kept(3, delay=0.21), "a delay of 0.21 s"),
    ],
)
def test_expectations_that_no_swim_gives_are_refused(odd: Expected, said: str) -> None:
    with pytest.raises(BadInput, match=f"{said}.*policy expect"):
        looks.read(Path("p"), looks.as_text(odd))
    for word in ("NaN", '"a"', "null"):
        text = looks.as_text(kept(3)).replace('"seconds": 60.0', f'"seconds": {word}')
        with pytest.raises(BadInput, match=r"seconds is nan, allowed|a number is missing"):
            looks.read(Path("p"), text)
