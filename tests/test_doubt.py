"""Intervals and draws of a fluid fit hold the truth where residuals of one swim go together."""

import numpy as np
import pytest
from scipy import stats

from tailbeat.identify.doubt import by_swims, draw, plausible
from tailbeat.identify.intervals import intervals
from tailbeat.identify.search import Fit
from tailbeat.identify.space import Parameter, covariance

SWIMS, SAMPLES, FREE = 16, 60, 3
OWNER = np.repeat(np.arange(SWIMS), SAMPLES)
SPACE = tuple(Parameter(name, "1", -50.0, 50.0, 0.0, 10.0, log=False) for name in "abc")


def fitted(seed: int, together: float, noise: float = 1.0) -> tuple[Fit, np.ndarray]:
    """A linear fit to swims whose residuals share an error of deviation `together`, and the truth
    (3,) in spreads."""
    rng = np.random.default_rng(seed)
    truth = rng.normal(size=FREE)
    slope = rng.normal(size=(SWIMS, 1, FREE)) + 0.5 * rng.normal(size=(SWIMS, SAMPLES, FREE))
    slope = slope.reshape(-1, FREE)
    error = noise * rng.normal(size=OWNER.size) + together * rng.normal(size=SWIMS)[OWNER]
    right = slope.T @ (slope @ truth + error)
    z = np.asarray(np.linalg.solve(slope.T @ slope + np.eye(FREE), right), dtype=np.float64)
    left = slope @ (z - truth) - error
    total = float(left @ left + z @ z)
    return Fit(seed, z, total, left, slope, covariance(slope)), truth


def held(fits: list[tuple[Fit, np.ndarray]], swims: bool) -> tuple[float, float]:
    """Fraction of true numbers inside their 95 % interval, and the mean width in spreads."""
    inside, widths = [], []
    for fit, truth in fits:
        doubt = by_swims(fit, OWNER)
        known = (doubt.excess, doubt.freedom) if swims else ()
        spans = intervals(SPACE, [doubt.fit if swims else fit], *known)
        for p, (low, high), true in zip(SPACE, spans, truth, strict=True):
            inside.append(low <= p.from_z(float(true)) <= high)
            widths.append((high - low) / p.spread)
    return float(np.mean(inside)), float(np.mean(widths))


def test_intervals_hold_where_the_residuals_of_a_swim_go_together():
    """Samples taken as independent give "95 %" intervals that hold a third of the time."""
    fits = [fitted(seed, together=3.0) for seed in range(200)]
    naive, _ = held(fits, swims=False)
    share, _ = held(fits, swims=True)
    assert naive < 0.5
    assert 0.90 <= share <= 0.995


def test_independent_residuals_keep_their_intervals():
    """The price of not trusting samples, where they could be trusted, is a third of the width."""
    fits = [fitted(seed, together=0.0) for seed in range(200)]
    share, width = held(fits, swims=True)
    _, naive = held(fits, swims=False)
    assert share >= 0.94
    assert width < 1.6 * naive


def test_data_better_than_assumed_never_count_for_more_than_their_noise():
    fit, _ = fitted(0, together=0.0)
    doubt = by_swims(fit, OWNER)
    assert doubt.excess >= 1
    assert (np.diag(doubt.fit.covariance) >= 0.99 * np.diag(fit.covariance)).all()


def test_a_number_without_effect_keeps_its_prior():
    fit, _ = fitted(1, together=1.0)
    slope = fit.jacobian * [1.0, 1.0, 0.0]
    blind = Fit(0, fit.z * [1.0, 1.0, 0.0], fit.cost, fit.residuals, slope, fit.covariance)
    assert by_swims(blind, OWNER).fit.covariance[2, 2] == pytest.approx(1.0)


def residuals_of(fit: Fit):
    """The residual function (n, p) -> (n, r) of a linear fit."""
    return lambda z: fit.residuals + (z - fit.z) @ fit.jacobian.T


def test_draws_spread_as_the_covariance_says_and_begin_with_the_fit():
    fit, _ = fitted(2, together=1.0)
    doubt = by_swims(fit, OWNER)
    z = draw(SPACE, [doubt], [residuals_of(fit)], 2000, seed=0)
    assert np.array_equal(z[0], fit.z)
    share = stats.norm.cdf(1) - stats.norm.cdf(-1)
    near = np.abs(z - fit.z) < np.sqrt(np.diag(doubt.fit.covariance))
    assert near.mean(axis=0) == pytest.approx(share, abs=0.05)
    assert np.array_equal(z, draw(SPACE, [doubt], [residuals_of(fit)], 2000, seed=0))


def test_a_seed_that_fits_as_well_is_drawn_and_a_worse_one_is_not():
    fit, _ = fitted(3, together=1.0)
    away = fit.z + 5.0
    same = Fit(1, away, fit.cost, fit.residuals, fit.jacobian, fit.covariance)
    worse = Fit(2, away, fit.cost, 3 * fit.residuals, fit.jacobian, fit.covariance)
    doubts = [by_swims(one, OWNER) for one in (fit, same, worse)]
    weight = plausible(doubts)
    assert weight.sum() == pytest.approx(1)
    assert weight[1] > 1e-12 and weight[2] < 1e-12 * weight[0]


def test_draws_stay_where_the_twin_still_swims_as_recorded():
    """In a narrow valley that bends, the straight line of the covariance leads out of it."""
    fit, _ = fitted(4, together=1.0)

    def bent(z: np.ndarray) -> np.ndarray:
        away = z - fit.z
        wall = 1e3 * np.square(away[:, :1]) ** 2
        return np.concatenate([fit.residuals + away @ fit.jacobian.T, wall], axis=1)

    doubt = by_swims(fit, OWNER)
    z = draw(SPACE, [doubt], [bent], 200, seed=1)
    straight = draw(SPACE, [doubt], [residuals_of(fit)], 200, seed=1)
    assert np.abs(z[:, 0] - fit.z[0]).max() <= np.abs(straight[:, 0] - fit.z[0]).max()
    best = np.square(fit.residuals).sum() + fit.z @ fit.z
    allowed = best + doubt.excess * stats.chi2.ppf(0.99, FREE)
    found = np.square(bent(z)).sum(axis=1) + np.square(z).sum(axis=1)
    assert (found <= allowed).mean() > 0.95


def test_draws_by_parts_of_the_recordings_are_the_same_and_swim_less():
    fit, _ = fitted(4, together=1.0)
    asked = {"wall": 0, "rest": 0}

    def wall(z: np.ndarray) -> np.ndarray:
        asked["wall"] += len(z)
        return np.asarray(1e5 * np.square((z - fit.z)[:, :1]) ** 2)

    def rest(z: np.ndarray) -> np.ndarray:
        asked["rest"] += len(z)
        return residuals_of(fit)(z)

    def whole(z: np.ndarray) -> np.ndarray:
        return np.concatenate([residuals_of(fit)(z), wall(z)], axis=1)

    doubts = [by_swims(fit, OWNER)]
    once = draw(SPACE, doubts, [whole], 200, seed=1)
    asked["wall"] = 0
    said: list[float] = []
    assert np.array_equal(draw(SPACE, doubts, [wall, rest], 200, 1, said.append), once)
    assert said[0] == 0 and said[-1] == 1 and said == sorted(said)
    assert 100 < asked["rest"] < 0.9 * asked["wall"]


def test_a_single_draw_is_the_fit_and_swims_nothing():
    fit, _ = fitted(0, together=1.0)

    def refuse(z: np.ndarray) -> np.ndarray:
        raise AssertionError(f"asked for {len(z)} candidates")

    found = draw(SPACE, [by_swims(fit, OWNER)], [refuse], 1, 0)
    assert np.array_equal(found, fit.z[None])
