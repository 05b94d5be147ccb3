"""Do the robot's signals agree? Each statistic on signals of which the truth is known, the sign
test's verdict for each thing that may be wrong, and the shipped policy's tours in the pool."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tailbeat.control import consistency as at
from tailbeat.control import expected as looks
from tailbeat.control import sign_test
from tailbeat.control.actions import PERIOD, Direct
from tailbeat.control.consistency import Signs, signs
from tailbeat.control.expected import Expected, ShaftModel
from tailbeat.control.measure import SPEED
from tailbeat.control.policy import decide, load_policy
from tailbeat.control.sign_test import Answers, answers, verdict
from tailbeat.env.tours import Tours, settings, tours
from tailbeat.env.world import World, seeds_from
from tailbeat.fish.store import load_fish
from tailbeat.link.places import POOL
from tailbeat.operator.target_path import NAMES as PATHS
from tailbeat.operator.target_path import PathAsked, target_path
from tailbeat.pool.plant import Surroundings
from tailbeat.pool.simulator import PoolSimulator
from tailbeat.pool.water import Water
from tailbeat.robot.checks import ASIDE, CHECKS, SAME, TIMES, WANDER
from tailbeat.robot.signals import NAMES, WALL, Signals
from tailbeat.train import expect

POLICY = load_policy("pulley-fish-pool-generator")
FISH = load_fish("pulley-fish")  # the pool's, which no policy was trained in
LOW, HIGH = FISH.motor.range or (0.0, 0.0)


@pytest.fixture(scope="module")
def known() -> Expected:
    assert POLICY.expected is not None
    return POLICY.expected


def pool(count: int, actions, seconds: float, walls=None) -> World:
    water = PoolSimulator(FISH, [Water()] * count, [Surroundings(walls=walls)] * count)
    asked = settings(replace(POLICY.contract, actions=actions), seconds)
    return World(FISH, asked, seeds_from(5, count), simulator=water)


@pytest.fixture(scope="module")
def tested(known) -> tuple[sign_test.Program, np.ndarray]:
    """Rows of the sign test of six fish in the pool's water, with everyday noise."""
    plan, step = sign_test.program(FISH.band, LOW, HIGH), [0]

    def play(seen):
        angle = plan.setpoints[min(step[0], len(plan.setpoints) - 1)]
        step[0] += 1
        return np.full((len(seen), 1), 2 * (angle - LOW) / (HIGH - LOW) - 1)

    world = pool(6, Direct(LOW, HIGH), PERIOD * (len(plan.setpoints) + 2))
    return plan, expect.rows(known, tours(play, world, 0))[:, : len(plan.setpoints)]


@pytest.fixture(scope="module")
def toured(known) -> tuple[Tours, np.ndarray]:
    """Eight fish of the pool that tour for half a minute, with everyday noise."""
    space = POLICY.contract.actions
    swum = tours(lambda seen: decide(POLICY, seen), pool(8, space, 30.0, POOL), 3)
    return swum, expect.rows(known, swum)


# ---- the shaft's model --------------------------------------------------------------------------


def test_the_modelled_shaft_rests_where_springs_say_and_no_faster_than_its_delay():
    model = ShaftModel(5.0, 0.0, 2.0, 0.05, 0.0, 0.01, 0.5, 1.0)
    state, path = looks.held(model, 0.0), []
    for _ in range(200):
        state = looks.turn(model, state, 0.3)
        path.append(state.angle)
    assert path[-1] == pytest.approx(0.3 * 5 / 6, rel=1e-3)  # kp against the tail's stiffness
    assert path[1] == 0.0 and path[2] > 0.0  # 50 ms are two and a half periods


def test_the_shaft_s_torque_ends_at_its_limit():
    model = ShaftModel(50.0, 0.0, 0.2, 0.0, 0.0, 0.01, 0.5, 1.0)
    state = looks.held(model, 0.0)
    for _ in range(500):
        state = looks.turn(model, state, 1.0)
    assert state.angle == pytest.approx(0.2, rel=1e-3)  # limit over stiffness


@pytest.mark.thorough
def test_one_period_at_a_time_is_the_whole_swim(known, toured):
    swum, rows = toured
    state = looks.held(known.shaft, 0.0)
    for sent, angle in zip(swum.sent[0], rows[0, :, at.MODELLED], strict=True):
        state = looks.turn(known.shaft, state, float(sent))
        assert state.angle == pytest.approx(angle, abs=1e-12)


# ---- statistics ---------------------------------------------------------------------------------


def test_nothing_is_said_of_a_short_window_or_a_fish_at_rest(known, toured):
    assert all(map(math.isnan, vars(signs(toured[1][0, :50], known)).values()))
    still = toured[1][0, :200].copy()
    still[:, [at.ANGLE, at.MODELLED, at.RATE]] = 0.0
    found = signs(still, known)
    assert all(map(math.isnan, (found.stroke, found.recoil, found.progress)))


SPOILT: dict[str, Callable[[np.ndarray], Any]] = {
    "turning": lambda w: biased(w, 0.5),
    "drifting": lambda w: camera_drifts(w, 0.03),
    "stroke": lambda w: w[:, at.ANGLE].__imul__(0.3),
    "weakening": lambda w: w[-100:, at.ANGLE].__imul__(0.5),
    "recoil": lambda w: w[:, at.RATE].__imul__(0.1),
    "progress": lambda w: w[:, at.X : at.Y + 1].__imul__(0.0),
    "same": lambda w: w[-40:, at.X : at.YAW + 1].__setitem__(slice(None), w[-1, at.X : at.YAW + 1]),
    "wander": lambda w: w[:, at.TARGET].__iadd__(np.tile([0.3, -0.3], len(w))[: len(w)]),
}


def biased(window: np.ndarray, rate: float) -> None:
    window[:, at.RATE] += rate
    window[:, at.TURNED] += rate * window[:, at.TIME]


def camera_drifts(window: np.ndarray, rate: float) -> None:
    window[:, at.YAW] += rate * np.maximum(window[:, at.STAMP] - window[-1, at.TIME] + 2.5, 0)


def broken(found: Signs, known: Expected) -> list[str]:
    return [
        one.sign
        for one in CHECKS
        if math.isfinite(value := getattr(found, one.sign, math.nan))
        and one.broken(value, known.limits, POLICY.contract.measure)
    ]


@pytest.mark.parametrize("sign", SPOILT)
def test_each_fault_breaks_its_check_in_most_windows(known, toured, sign):
    """The same windows without the fault break none: see the tours below."""
    seen = 0
    for fish in toured[1]:
        window = fish[400:1000].copy()
        SPOILT[sign](window)
        seen += sign in broken(signs(window, known), known)
    assert seen >= 7  # of 8


def test_no_check_is_broken_in_tours_of_the_pool(known, toured):
    """30 targets or so; `results/robot` counts hundreds. Beside a wall the robot asks less."""
    swum, rows = toured
    assert swum.reached > 20
    for fish in rows:
        own = Signals(known, POLICY.contract.band, (LOW, HIGH), POLICY.contract.measure)
        own.begin(0.0)
        for row in fish:
            own.window.add(tuple(row))
            own.look(POOL)
            assert not own.trouble and not own.warned


CUT, WITHIN = 9.0, 3.0  # s


@pytest.mark.thorough
def test_tendons_that_are_cut_on_a_tour_are_told_within_three_seconds(known):
    """At one moment of twenty tours, a third of them beside a wall. Those whose tail rests at a
    target have nothing to compare."""
    world, steps = pool(20, POLICY.contract.actions, CUT + WITHIN, POOL), [0]

    def go(seen):
        steps[0] += 1
        if steps[0] == round(CUT / PERIOD):
            tendon = world.simulator.plant.own.tendon
            tendon["stiffness"][:] = tendon["damping"][:] = 0.0
        return decide(POLICY, seen)

    rows = expect.rows(known, tours(go, world, 3))
    said = [look(known, fish) for fish in rows]
    assert not any(any(one[: round(CUT / PERIOD)]) for one in said)
    beating = [math.isfinite(at.sign("recoil", fish, known)) for fish in rows]
    told = [bool(one[-1]) for one in said]
    assert sum(beating) >= 17 and sum(told) >= 18
    assert sum(t for t, b in zip(told, beating, strict=True) if b) == sum(beating)


@pytest.mark.thorough
def test_setpoints_that_are_halved_on_a_tour_are_told_by_the_robot_s_own_stroke_before(known):
    """At one moment of twenty tours. A saturated servo moves four fifths of its stroke even so,
    which an everyday lab's does too: those are not told. (10 are, 4 without this check.)"""
    world, steps = pool(20, POLICY.contract.actions, CUT + WITHIN, POOL), [0]
    sound = world.simulator.advance

    def weak(setpoints, pushes):
        steps[0] += 1
        return sound(setpoints * (0.5 if steps[0] > CUT / PERIOD else 1.0), pushes)

    world.simulator.advance = weak
    rows = expect.rows(known, tours(lambda seen: decide(POLICY, seen), world, 3))
    said = [look(known, fish) for fish in rows]
    assert not any(any(one[: round(CUT / PERIOD)]) for one in said)
    assert sum(any(one) for one in said) >= 8
    assert sum(any("moved before" in words for words in one) for one in said) >= 6


def look(known: Expected, fish: np.ndarray) -> list[str]:
    """What the monitors say in every period of a tour."""
    own = Signals(known, POLICY.contract.band, (LOW, HIGH), POLICY.contract.measure)
    own.begin(0.0)
    said = []
    for row in fish:
        own.window.add(tuple(row))
        own.look(POOL)
        said.append(own.trouble)
    return said


def test_places_mirrored_under_right_headings_are_told_within_three_seconds(known, toured):
    """Whenever the fish swam more than 40 degrees off the mirror's axis for the last 3 s."""
    seconds, asked, told = round(3.0 / PERIOD), 0, 0
    for fish in toured[1]:
        wrong = fish.copy()
        wrong[:, at.Y] *= -1
        said = look(known, wrong)
        away = np.abs(np.sin(wrong[:, at.YAW])) > math.sin(math.radians(40))
        free = (np.abs(wrong[:, at.X : at.Y + 1]) < np.array(POOL) / 2 - WALL).all(axis=1)
        for last in range(seconds, len(fish)):
            if (away & free)[last - seconds : last].all():
                asked += 1
                told += "off its heading" in said[last]
    assert asked > 100 and told > 0.95 * asked


def test_a_course_is_seen_from_the_heading_and_needs_speed():
    """Two seconds to the left of a heading of 1 rad, by 0.3 rad, at 0.3 m/s."""
    frames = np.zeros((100, len(at.COLUMNS)))
    stamp = PERIOD * np.arange(100.0)
    frames[:, at.STAMP], frames[:, at.YAW] = stamp, 1.0 + 0.4 * np.sin(20 * stamp)
    frames[:, at.X], frames[:, at.Y] = 0.3 * stamp * np.cos(1.3), 0.3 * stamp * np.sin(1.3)
    assert at.course(frames, 0.2) == pytest.approx(0.3, abs=0.02)
    assert math.isnan(at.course(frames, 0.31)) and math.isnan(at.course(frames[:5], 0.2))
    frames[:, at.YAW] += math.tau
    assert at.course(frames, 0.2) == pytest.approx(0.3, abs=0.02)


def test_a_check_must_be_broken_several_times_in_a_row(known, toured):
    own = Signals(known, POLICY.contract.band, (LOW, HIGH), POLICY.contract.measure)
    own.begin(0.0)
    window = toured[1][0, :150].copy()
    SPOILT["stroke"](window)
    for row in window:
        own.window.add(tuple(row))
    names, said = len(NAMES), []
    for _ in range(names * TIMES):
        own.look(None)
        said.append(bool(own.trouble))
    assert not any(said[: names * (TIMES - 1)]) and said[-1]


def test_without_expectations_nothing_is_tested(toured):
    own = Signals(None, POLICY.contract.band, (LOW, HIGH))
    own.begin(0.0)
    own.add(0.0, 0.0, (0.0, 0.0), 0.0, None, (0.0, 0.0))
    own.look(POOL)
    assert not own.wanted and not own.trouble and own.window.count == 0


# ---- the fish's monitor of the target -----------------------------------------------------------


def trouble(places: np.ndarray) -> str:
    """What the monitors say of targets (k, 2) [m], one each period."""
    assert POLICY.expected is not None
    own = Signals(POLICY.expected, POLICY.contract.band, (-1.0, 1.0))
    own.begin(0.0)
    rng = np.random.default_rng(0)
    for k, (x, y) in enumerate(places.tolist()):
        pose = tuple(rng.normal(scale=1e-3, size=3).tolist())
        own.add(PERIOD * k, 0.0, (0.0, 0.0), 0.0, (PERIOD * k, PERIOD * k, pose), (x, y))
    for _ in range(TIMES * len(NAMES)):
        own.look(POOL)
    return own.trouble


@pytest.mark.parametrize("name", PATHS)
def test_a_target_by_the_clock_as_fast_as_the_fish_is_no_jump(name):
    path = target_path(PathAsked(name, speed=SPEED))
    for first in np.arange(0.0, path.lap, 2.0):
        assert trouble(path.along(first + PERIOD * np.arange(150))) == ""


def test_a_target_that_a_hand_drags_to_and_fro_is_no_jump_but_one_that_flickers_is():
    time_ = PERIOD * np.arange(150)
    hand = np.floor(20 * time_) / 20  # the page sends twenty places a second
    dragged = np.column_stack([0.5 * np.sin(2 * np.pi * hand), 0.3 * np.cos(2 * np.pi * hand)])
    assert trouble(dragged) == ""
    waved = np.column_stack([0.5 * np.sin(2 * np.pi * 1.5 * hand), 0 * hand])
    assert trouble(waved) == ""
    rng = np.random.default_rng(1)
    assert "the target jumps" in trouble(rng.uniform(-0.5, 0.5, (150, 2)))
    flicker = np.where(np.arange(150)[:, None] // 5 % 2, [1.0, 0.0], [0.0, 0.0])
    assert "the target jumps" in trouble(flicker)


# ---- the sign test ------------------------------------------------------------------------------


def reversed_tail(rows: np.ndarray) -> None:
    """All that the body does is mirrored: it turns and moves to the other side."""
    rows[:, [at.RATE, at.TURNED, at.YAW, at.Y]] *= -1


def mirrored(rows: np.ndarray) -> None:
    rows[:, [at.YAW, at.Y]] *= -1


def turned_tag(rows: np.ndarray) -> None:
    rows[:, at.YAW] += math.pi / 2


def upside_down(rows: np.ndarray) -> None:
    rows[:, [at.RATE, at.TURNED]] *= -1


def one_way_encoder(rows: np.ndarray) -> None:
    rows[:, at.ANGLE] *= -1


def dead_body(rows: np.ndarray) -> None:
    noise = np.random.default_rng(0)
    rows[:, at.RATE] = 0.02 * noise.standard_normal(len(rows))
    rows[:, at.YAW] = 0.01 * noise.standard_normal(len(rows))


def other_axis(rows: np.ndarray) -> None:
    rows[:, at.RATE] = 0.02 * np.random.default_rng(0).standard_normal(len(rows))


WRONG = {
    reversed_tail: "wrong side",
    mirrored: "mirrored",
    turned_tag: "turn the tag",
    upside_down: "upside down",
    one_way_encoder: "of the stroke",
    dead_body: "does not answer",
    other_axis: "which axis",
}


def test_a_sound_fish_passes_the_sign_test(tested, known):
    plan, rows = tested
    assert [verdict(answers(plan, one, known)) for one in rows] == [""] * len(rows)


@pytest.mark.parametrize("spoil", WRONG, ids=lambda one: one.__name__)
def test_each_wrong_sign_is_named(tested, known, spoil):
    plan, rows = tested
    for one in rows:
        wrong = one.copy()
        spoil(wrong)
        assert WRONG[spoil] in verdict(answers(plan, wrong, known))


def test_what_the_tail_drives_is_told_from_its_load():
    sound = Answers(1.0, 1.0, 0.0, 0.0, 0.1, 0.0)
    assert "is it held" in verdict(sound)
    assert "tendons" in verdict(replace(sound, load=0.0))
    assert "did not move" in verdict(Answers(1.0, 1.0, 1.0, 1.0, 0.001, 0.0))
    assert "lost the tag" in verdict(Answers(1.0, 1.0, 1.0, 1.0, math.nan, math.nan))


def test_the_program_is_inside_the_range_and_the_band():
    plan = sign_test.program((1.0, 4.0), -0.3, 0.2)
    assert plan.setpoints.min() >= -0.3 and plan.setpoints.max() <= 0.2
    crossings = np.diff(np.sign(plan.setpoints[plan.beats] - plan.setpoints[0])) != 0
    assert crossings.sum() in (2 * sign_test.BEATS - 1, 2 * sign_test.BEATS)
    seconds = PERIOD * (plan.beats.stop - plan.beats.start)
    assert 1.0 <= sign_test.BEATS / seconds <= 4.0


def test_the_page_states_the_test_s_numbers():
    page = (Path(__file__).parents[1] / "docs/explain/safety.md").read_text("utf-8")
    stroke, held = (round(math.degrees(one)) for one in (sign_test.STROKE, sign_test.HELD))
    words = [
        f"waits for {sign_test.STILL:g} s", f"most {stroke}°",
        f"most {held}° for {sign_test.BEND:g} s",
        f"below {sign_test.ANSWER:g}", f"below {1e3 * sign_test.SEEN:g} mm",
        f"beyond {math.degrees(sign_test.ASKEW):.0f}°", f"{SAME} in a row are exactly equal",
        f"to and fro by {WANDER:g} m", f"{math.degrees(ASIDE):.0f}° apart",
        f"at {at.LEAST_SPEED:g} m/s or faster", f"Within {WALL:g} m of a wall",
    ]  # fmt: skip
    flat = " ".join(page.split())
    assert [one for one in words if one not in flat] == []
