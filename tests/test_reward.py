"""The reward of single steps: what costs, what pays, and where it stops paying."""

import numpy as np
import pytest

from tailbeat.env.reward import NEAR, TERMS, Reward, Terms, of_action, of_target

PAPER = Reward()
AWAY = np.array([0.0, 0.25, 1.0, 3.0])  # m


def terms(away: np.ndarray, arrived: bool = False, goes_on: bool = False) -> tuple:
    return of_target(PAPER, away, np.full(away.shape, arrived), np.full(away.shape, goes_on))


def test_a_metre_costs_one_and_an_arrival_pays_a_thousand_as_in_the_paper():
    distance, bonus = terms(AWAY)
    assert distance.tolist() == [0.0, -0.25, -1.0, -3.0] and bonus.tolist() == [0.0] * 4
    assert terms(AWAY, arrived=True)[1].tolist() == [1000.0] * 4


def test_beside_a_target_that_goes_on_nearness_pays_up_to_eight_and_nothing_from_a_metre_on():
    assert NEAR == 1.0
    distance, bonus = terms(AWAY, goes_on=True)
    assert bonus.tolist() == [8.0, 6.0, 0.0, 0.0]
    assert distance.tolist() == terms(AWAY)[0].tolist()


def test_every_weight_scales_its_own_term():
    double = Reward(distance=2.0, effort=0.2, bonus=2000.0, nearness=16.0)
    goes_on, arrived = np.array([False, True, True, False]), np.array([True, False, False, False])
    once, twice = (of_target(one, AWAY, arrived, goes_on) for one in (PAPER, double))
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
    for part in of_target(PAPER, away, np.zeros((2, 1)), np.ones((2, 1))):
        assert part.dtype == np.float32 and part.shape == away.shape
        assert np.isnan(part).tolist() == [[False, True], [False, False]]
