"""What the servo's current says: pulls of the tendons and obeyed setpoints, of tours in the pool.

The current is that of the plant's torque, with noise, an offset and a wrong unit. Each fault is
made in everyday labs. What was known before, from stroke and the body's answer, is the baseline
beside it.
"""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from tailbeat.control import consistency as at
from tailbeat.control import sign_test
from tailbeat.control.actions import PERIOD, Direct
from tailbeat.control.expected import ShaftModel
from tailbeat.control.load import SHARES, Motor, obeyed, pulls
from tailbeat.control.policy import decide, load_policy
from tailbeat.control.sign_test import answers, verdict
from tailbeat.emulators.plant_shaft import PlantShaft
from tailbeat.emulators.servo import Dynamixel
from tailbeat.env.tours import settings, tours
from tailbeat.env.world import seeds_from
from tailbeat.evaluate.labs import world_in_labs
from tailbeat.fish.catalogue import profile
from tailbeat.fish.store import load_fish
from tailbeat.link.places import POOL
from tailbeat.pool.mess import lab_at
from tailbeat.pool.water import Water
from tailbeat.robot.fits import carried
from tailbeat.robot.models import motor_of
from tailbeat.robot.signals import Signals
from tailbeat.train import expect

POLICY = load_policy("pulley-fish-pool-generator")
assert POLICY.expected is not None
EXPECTED = POLICY.expected
FISH = load_fish("pulley-fish")
CUT, WITHIN, COUNT = 9.0, 3.0, 20  # s, s, tours
NOISE, OFFSET, UNIT = 0.03, 0.03, 1.1  # A, A, of a servo's current: chosen


def motor() -> Motor:
    assert FISH.hardware is not None
    found = motor_of(carried(POLICY.contract), FISH.hardware)
    assert found is not None
    return found


def cut(left: bool, right: bool) -> Callable:
    def make(simulator) -> None:
        tendon = simulator.plant.own.tendon
        tendon["left_cut"][:], tendon["right_cut"][:] = left, right

    return make


def halve(simulator) -> None:
    sound = simulator.advance
    simulator.advance = lambda setpoints, pushes: sound(0.5 * setpoints, pushes)


def swum(play: Callable, mess: str, seed: int, steps: int, actions=None) -> np.ndarray:
    """Rows (n, steps, 13) of fish in messy labs, with the servo's current. `play` gets the world's
    simulator, the step and what the policy sees, and gives actions."""
    labs = [(lab_at(mess, seed, number), Water()) for number in range(COUNT)]
    contract = replace(POLICY.contract, actions=actions or POLICY.contract.actions)
    asked = settings(contract, PERIOD * (steps + 1))
    world = world_in_labs(FISH, asked, labs, seeds_from(seed, COUNT), POOL)
    simulator, taken, drawn = world.simulator, [0], []
    settle, damping = simulator._settle, FISH.servos[FISH.servo].damping

    def note(chosen, swum):
        drawn.append(swum.torque[:, -1] - damping * swum.v[:, -1, 3])
        return settle(chosen, swum)

    def go(seen):
        taken[0] += 1
        return play(simulator, taken[0], seen)

    simulator._settle = note
    rows = expect.rows(EXPECTED, tours(go, world, seed))[:, :steps]
    torque, rng = np.array(drawn).T[:, :steps], np.random.default_rng(seed)
    noise = NOISE * rng.standard_normal(torque.shape) + OFFSET
    rows[..., at.CURRENT] = UNIT * torque / motor().per_ampere + noise
    return rows


def toured(break_it: Callable, mess: str, seed: int, seconds: float = CUT + WITHIN) -> np.ndarray:
    """Rows of tours; the fault is made at `CUT`."""

    def play(simulator, step, seen):
        if step == round(CUT / PERIOD):
            break_it(simulator)
        return decide(POLICY, seen)

    return swum(play, mess, seed, round(seconds / PERIOD))


def with_gears(rows: np.ndarray, friction: float) -> np.ndarray:
    """The rows, as the current shows the torque behind gears with a friction [N m]: more while they
    turn, and at rest as little as holds the tail."""
    speed = np.gradient(rows[..., at.ANGLE], PERIOD, axis=1)
    torque = motor().per_ampere * rows[..., at.CURRENT]
    resting = np.sign(torque) * np.maximum(np.abs(torque) - friction, 0.0)
    turning = torque + friction * np.sign(speed)
    seen = rows.copy()
    seen[..., at.CURRENT] = np.where(np.abs(speed) < 0.15, resting, turning) / motor().per_ampere
    return seen


def after_the_sign_test(
    break_it: Callable, seed: int, friction: float = 0.0
) -> tuple[list[str], list[str]]:
    """What the sign test says of each fish of everyday labs, broken before it: with the current,
    and without. `friction` [N m] of the servo's gears."""
    low, high = FISH.motor.range or (0.0, 0.0)
    plan = sign_test.program(FISH.band, low, high)

    def play(simulator, step, seen):
        if step == 1:
            break_it(simulator)
        angle = plan.setpoints[min(step, len(plan.setpoints)) - 1]
        return np.full((len(seen), 1), 2 * (angle - low) / (high - low) - 1)

    rows = swum(play, "everyday", seed, len(plan.setpoints), Direct(low, high))
    rows = with_gears(rows, friction)
    found, before = (
        [verdict(answers(plan, one, EXPECTED, own)) for one in rows] for own in (motor(), None)
    )
    return found, before


def look(rows: np.ndarray, own: Motor | None) -> list[str]:
    """What the monitors say in every period of a tour."""
    contract, said = POLICY.contract, []
    ends = (contract.actions.low, contract.actions.high)
    signals = Signals(EXPECTED, contract.band, ends, contract.measure, motor=own)
    signals.begin(0.0)
    for row in rows:
        signals.window.add(tuple(row))
        signals.look(POOL)
        said.append(signals.trouble)
    return said


def told(rows: np.ndarray, own: Motor | None) -> list[bool]:
    """Whether each tour's fault was told within `WITHIN` seconds; an alarm before is an error."""
    said = [look(one, own) for one in rows]
    assert not [one for fish in said for one in fish[: round(CUT / PERIOD)] if one]
    return [any(one) for one in said]


def loaded(rows: np.ndarray, side: int) -> np.ndarray:
    """Whether a tendon had something to pull in the first 2 s after the fault."""
    parts = rows[:, round(CUT / PERIOD) :][:, : round(2.0 / PERIOD)]
    found = [pulls(one, EXPECTED.shaft, motor())[side] for one in parts]
    return np.isfinite(found)


@pytest.mark.thorough
@pytest.mark.parametrize("side", [0, 1])
def test_one_cut_tendon_is_told_where_it_had_something_to_pull(side):
    """One that has nothing to pull, of a fish that turns to the other side, cannot be told."""
    rows = toured(cut(side == 0, side == 1), "everyday", 11)
    found, asked = told(rows, motor()), loaded(rows, side)
    assert asked.sum() >= 6
    assert np.array(found)[asked].sum() >= asked.sum() - 1


@pytest.mark.thorough
def test_halved_setpoints_are_told_where_the_stroke_hides_them():
    rows = toured(halve, "everyday", 12)
    found, before = told(rows, motor()), told(rows, None)
    assert sum(found) >= 17 and sum(before) <= 14


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("break_it", "words", "least"),
    [
        (cut(True, False), "left tendon", 16),
        (cut(False, True), "right tendon", 16),
        (halve, "servo obeys", 16),
    ],
    ids=["left", "right", "half"],
)
def test_the_sign_test_names_what_only_the_current_shows(break_it, words, least):
    """In 20 everyday labs. Most of these pass without the current."""
    found, before = after_the_sign_test(break_it, 31)
    assert sum(bool(one) for one in found) >= least
    assert sum(words in one for one in found) >= 10
    assert sum(not one for one in before) >= 12


@pytest.mark.thorough
@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_a_sound_fish_of_an_everyday_lab_passes_the_sign_test(friction):
    """Gears that hold the tail by themselves need no current, and look like tendons that are cut;
    0.5 N m is what bends the tail by 29 degrees."""
    assert after_the_sign_test(lambda simulator: None, 32, friction)[0] == [""] * COUNT


@pytest.mark.slow
def test_no_tour_of_an_everyday_lab_is_held_for_the_friction_of_its_gears():
    rows = toured(lambda simulator: None, "everyday", 13, 30.0)
    for one in with_gears(rows, 0.5):
        assert not any(look(one, motor()))


# ---- what the statistics are --------------------------------------------------------------------

SHAFT = ShaftModel(5.0, 0.0, 2.0, 0.0, 0.0, 0.02, 0.6, 1.0)
OWN = Motor(1.5, 0.01, 0.5)


def shaken(share: float = 1.0, left: float = 1.0, right: float = 1.0) -> np.ndarray:
    """Two seconds of a shaft that turns as a sine, with the current that its tail asks for and the
    setpoints that make it."""
    time = PERIOD * np.arange(100)
    rate = 2 * np.pi * 2.0
    rows = np.full((100, len(at.COLUMNS)), np.nan)
    rows[:, at.TIME], rows[:, at.ANGLE] = time, 0.5 * np.sin(rate * time)
    velocity, speeding = 0.5 * rate * np.cos(rate * time), -(rate**2) * rows[:, at.ANGLE]
    pull = 0.01 * speeding + 0.1 * velocity + 1.0 * rows[:, at.ANGLE]
    own = np.where(pull > 0, left, right) * pull + 0.01 * speeding
    rows[:, at.CURRENT] = own / OWN.per_ampere
    rows[:, at.SENT] = ((own + OWN.damping * velocity) / SHAFT.kp + rows[:, at.ANGLE]) / share
    return rows


def test_pulls_and_obeyed_setpoints_are_those_that_were_made():
    """A sine's differences over 20 ms are 1 % too small, and its second ones 2 %, more at the
    window's ends."""
    assert pulls(shaken(), SHAFT, OWN) == pytest.approx((1.0, 1.0), abs=0.05)
    assert pulls(shaken(left=0.0), SHAFT, OWN) == pytest.approx((0.0, 1.0), abs=0.05)
    assert pulls(shaken(right=0.3), SHAFT, OWN) == pytest.approx((1.0, 0.3), abs=0.05)
    for share in (0.5, 0.8, 1.0):
        assert obeyed(shaken(share), SHAFT, OWN) == pytest.approx(share, abs=SHARES[1] - SHARES[0])


def test_what_has_no_current_or_nothing_to_pull_says_nothing():
    rows = shaken()
    rows[:, at.CURRENT] = np.nan
    assert all(map(math.isnan, (*pulls(rows, SHAFT, OWN), obeyed(rows, SHAFT, OWN))))
    still = shaken()
    still[:, [at.ANGLE, at.CURRENT, at.SENT]] *= 0.05
    assert all(map(math.isnan, (*pulls(still, SHAFT, OWN), obeyed(still, SHAFT, OWN))))


def test_a_servo_that_reports_a_load_says_nothing_of_its_torque():
    assert FISH.hardware is not None
    for name, speaks in (("xw430", True), ("xl330", True), ("xl430", False), ("mx28", False)):
        hardware = profile(name).hardware()
        assert hardware is not None and (motor_of(FISH, hardware) is not None) == speaks


# ---- the emulated servo's -----------------------------------------------------------------------


@pytest.mark.parametrize(("side", "mode"), [(1, 0), (-1, 0), (1, 1)])
def test_an_emulated_servo_that_holds_a_bend_draws_the_current_of_the_tail_s_stiffness(side, mode):
    shaft = PlantShaft(fish=FISH)
    shaft.hold()
    servo = Dynamixel(shaft, hardware=FISH.hardware)
    servo.put(10, mode)  # the drive mode: 1 is reversed
    servo.put(64, 1)
    servo.put(116, 2048 + side * round(0.5 * 4096 / math.tau))
    for step in range(1, 1000):
        servo.advance(2e-3 * step)
    assert FISH.hardware is not None and FISH.tail.k_eff is not None
    torque = servo.get(126, True) * FISH.hardware.current_unit * motor().per_ampere
    bend = side * abs(shaft.angle)
    assert torque == pytest.approx(bend * FISH.tail.k_eff, rel=0.1)
    servo.put(64, 0)
    servo.advance(2.01)
    assert servo.get(126) == 0


def test_a_tendon_that_is_cut_pulls_its_side_alone_no_more():
    pull = {}
    for broken in ("none", "left", "right"):
        shaft = PlantShaft(fish=FISH)
        shaft.hold()
        shaft.snap(left=broken == "left", right=broken == "right")
        for goal in (0.5, -0.5):
            for _ in range(400):
                shaft.advance(goal, 5e-3)
            pull[broken, goal] = shaft.drawn
    assert pull["none", 0.5] == pytest.approx(-pull["none", -0.5], rel=0.02)
    assert abs(pull["left", 0.5]) < 0.01 and abs(pull["right", -0.5]) < 0.01
    assert pull["left", -0.5] == pytest.approx(pull["none", -0.5], rel=0.02)
    assert pull["right", 0.5] == pytest.approx(pull["none", 0.5], rel=0.02)
