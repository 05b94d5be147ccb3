"""The reward of single steps: what costs, what pays, and where it stops paying."""

import numpy as np
import pytest

from tailbeat.control.actions import PERIOD
from tailbeat.control.measure import PAPER as PAPERS
from tailbeat.control.measure import Measure
from tailbeat.env.reward import (
    FASTEST,
    NEAR,
    SECONDS,
    TERMS,
    WRONG,
    Reward,
    Terms,
    missed,
    of_action,
    of_target,
)

PAPER = Reward()
AWAY = np.array([0.0, 0.25, 1.0, 3.0])  # m


def terms(
    away: np.ndarray, arrived: bool = False, goes_on: bool = False, wrong: float = 0.0
) -> tuple:
    arrived_at, going_on = np.full(away.shape, arrived), np.full(away.shape, goes_on)
    return of_target(PAPER, away, arrived_at, going_on, np.full(away.shape, wrong))


def test_a_metre_costs_one_and_an_arrival_pays_a_thousand_as_in_the_paper():
    distance, bonus = terms(AWAY)
    assert distance.tolist() == [0.0, -0.25, -1.0, -3.0] and bonus.tolist() == [0.0] * 4
    assert terms(AWAY, arrived=True)[1].tolist() == [1000.0] * 4


def test_at_a_target_that_goes_on_nothing_is_lost_and_from_a_metre_on_no_more_than_two():
    assert NEAR == 1.0
    distance, bonus = terms(AWAY, goes_on=True)
    assert bonus.tolist() == [0.0, -0.5, -2.0, -2.0]
    assert distance.tolist() == terms(AWAY)[0].tolist()


def test_a_wrong_velocity_costs_twelve_per_metre_a_second_up_to_half_of_one_behind_such_a_target():
    assert WRONG == 0.5
    for wrong, lost in ((0.1, 1.2), (0.5, 6.0), (9.0, 6.0), (np.nan, 6.0)):
        both = (terms(AWAY, goes_on=True, wrong=one)[1] for one in (0.0, wrong))
        assert np.subtract(*both) == pytest.approx([lost] * 4)
        assert terms(AWAY, wrong=wrong)[1].tolist() == [0.0] * 4


def test_wanted_is_the_target_s_velocity_and_the_way_to_it_within_a_second_and_a_half():
    assert (SECONDS, FASTEST) == (1.5, 0.35)
    for v, apart, wanted in (
        (0.1j, 0.0, 0.1j),  # beside it: go with it
        (0.1j, 0.15, 0.1 + 0.1j),
        (0.1, -0.15, 0.0),  # it comes: wait
        (0.0, 3.0, 0.35),  # far away, and no faster than the fish
        (0.0, 0.0, 0.0),
    ):
        gone, target = PERIOD * np.array([wanted, wanted + 0.2j]), PERIOD * v
        assert missed(gone, target, apart, PAPERS) == pytest.approx([0.0, 0.2])
        turn = np.exp(2j)  # whatever the direction in the pool
        turned = missed(turn * gone, turn * target, turn * apart, PAPERS)
        assert turned == pytest.approx([0.0, 0.2])


def test_a_similar_swim_of_another_fish_misses_as_much_in_its_measure():
    half = Measure(reach=0.5, size=0.4, speed=0.7)
    tag, target, apart = 0.004 + 0.001j, 0.002, 0.2j
    small = missed(half.speed * tag, half.speed * target, half.reach * apart, half)
    assert small == pytest.approx(missed(tag, target, apart, PAPERS))


def test_every_weight_scales_its_own_term():
    double = Reward(distance=2.0, effort=0.2, bonus=2000.0, nearness=4.0, pace=24.0)
    goes_on, arrived = np.array([False, True, True, False]), np.array([True, False, False, False])
    once, twice = (of_target(one, AWAY, arrived, goes_on, 0.3) for one in (PAPER, double))
    for a, b in zip(once, twice, strict=True):
        assert b.tolist() == (2 * a).tolist() and a.any()
    action = np.full((1, 6), 0.5)
    assert of_action(double, action) == 2 * of_action(PAPER, action)


def test_effort_is_a_tenth_of_the_action_s_length_whatever_its_direction():
    actions = np.array([[0.0, 0.0], [0.6, 0.8], [-0.6, 0.8], [1.0, 0.0]])
    assert of_action(PAPER, actions) == pytest.approx([0.0, -0.1, -0.1, -0.1])


def test_what_exceeds_the_action_s_range_costs_no_more_as_it_does_no_more():
    actions = np.array([[1.0, -1.0], [7.0, -7.0]])
    assert of_action(PAPER, actions) == pytest.approx([-0.1 * 2**0.5] * 2)


def test_the_reward_is_the_sum_of_its_terms():
    assert TERMS == ("distance", "effort", "bonus")
    parts = Terms(*(np.array([x, 2 * x]) for x in (-1.0, -0.1, 1000.0)))
    assert parts.total() == pytest.approx([998.9, 1997.8])


def test_terms_keep_the_distance_s_precision_and_shape_and_nan_stays_nan():
    away = np.array([[0.5, np.nan], [2.0, 0.1]], np.float32)
    for part in of_target(PAPER, away, np.zeros((2, 1)), np.ones((2, 1)), np.zeros((2, 2))):
        assert part.dtype == np.float32 and part.shape == away.shape
        assert np.isnan(part).tolist() == [[False, True], [False, False]]
