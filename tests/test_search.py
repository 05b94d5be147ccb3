"""The search on problems with known answers: it finds them, says how sure, resumes, repeats."""

import numpy as np
import pytest

from tailbeat.identify.intervals import estimates, intervals, trade_offs
from tailbeat.identify.search import Effort, Fit, search
from tailbeat.identify.space import Parameter, covariance, values

SPACE = (
    Parameter("a", "1", 0.1, 10, 1.0, 0.7),
    Parameter("b", "1", 0.1, 10, 1.0, 0.7),
    Parameter("c", "1", 0.1, 10, 1.0, 0.7),
    Parameter("d", "m", -5, 5, 0.0, 1.0, log=False),
)
TRUTH = np.array([2.0, 0.7, 1.5, 0.8])
CLOCK = np.linspace(0, 3, 60)


def residuals(z: np.ndarray) -> np.ndarray:
    """a exp(-b t) + d t with a noise of 0.02, in sigmas; c has no effect."""
    rows = np.array([[p.from_z(x) for p, x in zip(SPACE, row, strict=True)] for row in z])
    a, b, _, d = rows.T[..., None]
    a0, b0, _, d0 = TRUTH
    noise = np.random.default_rng(1).normal(0, 0.02, CLOCK.size)
    measured = a0 * np.exp(-b0 * CLOCK) + d0 * CLOCK + noise
    return (a * np.exp(-b * CLOCK) + d * CLOCK - measured) / 0.02


def decided(space: tuple[Parameter, ...], fit: Fit) -> list[bool]:
    return [found.decided for found in estimates(space, [fit]).values()]


def test_known_numbers_come_back_inside_their_intervals():
    fit = search(residuals, SPACE, 0, Effort(20, 10, 10))
    found = values(SPACE, fit.z)
    for name, truth, (low, high) in zip("abcd", TRUTH, intervals(SPACE, [fit]), strict=True):
        assert low <= truth <= high, name
        if name != "c":
            assert found[name] == pytest.approx(truth, rel=0.1)
    assert decided(SPACE, fit) == [True, True, False, True]
    assert found["c"] == pytest.approx(1.0, rel=0.01)  # left at its prior


def test_data_better_than_their_stated_deviation_give_the_same_intervals():
    """Deviations stated twice too large: the scatter of the residuals shows it."""
    effort = Effort(20, 10, 10)
    right = intervals(SPACE, [search(residuals, SPACE, 0, effort)])
    stated = intervals(SPACE, [search(lambda z: residuals(z) / 2, SPACE, 0, effort)])
    for index in (0, 1, 3):  # c has no effect
        assert np.diff(stated[index]) == pytest.approx(np.diff(right[index]), rel=0.15)


def test_a_third_of_the_residuals_goes_ahead_and_all_of_them_have_the_last_word():
    """The end is that of all residuals, and they are asked for less often than without a third."""
    asked = {True: 0, False: 0}

    def all_of_them(z: np.ndarray, ahead: bool) -> np.ndarray:
        asked[ahead] += len(z)
        return residuals(z)

    effort = Effort(3, 10, 20)
    alone = search(lambda z: all_of_them(z, False), SPACE, 0, effort)
    led = search(lambda z: all_of_them(z, True), SPACE, 0, effort,
                 cheap=lambda z: residuals(z)[:, ::3])  # fmt: skip
    assert np.allclose(led.z, alone.z, atol=0.02) and led.cost == pytest.approx(
        alone.cost, rel=1e-3
    )
    assert asked[True] < 0.8 * asked[False]


def test_same_seed_same_result_and_seeds_agree():
    effort = Effort(12, 10, 10)
    first, again = (search(residuals, SPACE, 3, effort) for _ in range(2))
    other = search(residuals, SPACE, 4, effort)
    assert np.array_equal(first.z, again.z)
    assert np.allclose(first.z, other.z, atol=0.02)


def test_an_interrupted_search_goes_on_where_it_stopped(tmp_path):
    calls = []

    def failing(z: np.ndarray) -> np.ndarray:
        calls.append(len(z))
        if len(calls) == 6:
            raise KeyboardInterrupt
        return residuals(z)

    checkpoint = tmp_path / "search"
    with pytest.raises(KeyboardInterrupt):
        search(failing, SPACE, 0, Effort(10, 10, 5), checkpoint)
    before = len(calls)
    resumed = search(failing, SPACE, 0, Effort(10, 10, 5), checkpoint)
    whole = search(residuals, SPACE, 0, Effort(10, 10, 5))
    assert before == 6
    assert np.allclose(resumed.z, whole.z, atol=1e-6)


def test_an_interrupted_polish_goes_on_where_it_stopped(tmp_path):
    """Killed at every call of the polish in turn: the same result, and little is done twice."""
    effort, calls = Effort(3, 6, 6), []

    def counted(z: np.ndarray) -> np.ndarray:
        calls.append(len(z))
        return residuals(z)

    whole = search(counted, SPACE, 0, effort)
    total = len(calls)
    for last in range(effort.generations + 2, total):
        left = [last]

        def failing(z: np.ndarray, left: list[int] = left) -> np.ndarray:
            left[0] -= 1
            if left[0] == 0:
                raise KeyboardInterrupt
            return residuals(z)

        checkpoint = tmp_path / f"{last}.search"
        with pytest.raises(KeyboardInterrupt):
            search(failing, SPACE, 0, effort, checkpoint)
        calls.clear()
        resumed = search(counted, SPACE, 0, effort, checkpoint)
        assert np.array_equal(resumed.z, whole.z)
        assert len(calls) <= total - last + 8, last  # a part's noise level, and one iteration


def test_numbers_that_trade_against_each_other_are_named():
    space = SPACE[:2]

    def product(z: np.ndarray) -> np.ndarray:
        rows = np.exp(0.7 * z)
        return np.repeat((rows[:, :1] * rows[:, 1:] - 2.0) / 0.01, 5, axis=1)

    fit = search(product, space, 0, Effort(10, 8, 8))
    (a, b, r) = trade_offs(space, fit)[0]
    assert (a, b) == ("a", "b") and r < -0.9
    assert decided(space, fit) == [False, False]


def test_diverged_candidates_do_not_win():
    def half_broken(z: np.ndarray) -> np.ndarray:
        found = residuals(z)
        found[z[:, 0] < 0] = np.inf
        return found

    fit = search(half_broken, SPACE, 0, Effort(20, 10, 10))
    assert fit.z[0] >= 0 and np.isfinite(fit.cost)


def test_ninety_five_percent_intervals_hold_the_truth_that_often():
    """A line through 40 noisy points, 400 times over: with normal noise the coverage is exact."""
    rng, clock = np.random.default_rng(5), np.linspace(-1, 1, 40)
    space = tuple(Parameter(name, "m", -50, 50, 0.0, 10.0, log=False) for name in "ab")
    slope = np.stack([np.ones(40), clock], axis=1) * 10.0 / 0.3  # d residual / d z
    spread, held = covariance(slope), []
    truth = np.array([p.to_z(x) for p, x in zip(space, (1.0, 2.0), strict=True)])
    for _ in range(400):
        z = truth + spread @ slope.T @ rng.normal(size=40)
        fit = Fit(0, z, 0.0, np.zeros(40), slope, spread)
        sides = intervals(space, [fit])
        held += [low <= x <= high for x, (low, high) in zip((1.0, 2.0), sides, strict=True)]
    assert np.mean(held) == pytest.approx(0.95, abs=0.025)
