"""Intervals over seeds and targets: how often they hold, where intervals over targets do not."""

import numpy as np
import pytest
from numpy.typing import NDArray

from tailbeat.evaluate.rates import apart, of_kind, over_seeds, paired, wilson

Hits = NDArray[np.bool_]
SEEDS, TARGETS, DRAWS = 3, 100, 1_000


def hits(rng: np.random.Generator, level: float, seeds: float, targets: float = 1.0) -> Hits:
    """Hits of three seeds, whose log odds differ by `seeds`, of a hundred targets (by `targets`),
    in one study after the other (DRAWS, SEEDS, TARGETS)."""
    of_seed = seeds * rng.standard_normal((DRAWS, SEEDS, 1))
    of_target = targets * rng.standard_normal((DRAWS, 1, TARGETS))
    odds = level + of_seed + of_target
    return np.asarray(rng.random((DRAWS, SEEDS, TARGETS)) < 1 / (1 + np.exp(-odds)))


def share(inside: list[bool]) -> float:
    return float(np.mean(inside))


@pytest.mark.parametrize(
    "level", [pytest.param(v, marks=pytest.mark.thorough) for v in (0.0, 1.5)] + [3.0]
)
def test_an_interval_over_seeds_holds_the_rate_where_one_over_targets_does_not(level):
    """The truth is the rate of all seeds on all targets."""
    rng = np.random.default_rng(0)
    studies = hits(rng, level, seeds=0.6)
    truth = np.mean([hits(rng, level, seeds=0.6).mean() for _ in range(10)])
    ours = [of_kind(one).interval for one in studies]
    plain = [wilson(int(one.sum()), one.size) for one in studies]
    assert share([low <= truth <= high for low, high in ours]) >= 0.94
    assert share([low <= truth <= high for low, high in plain]) < 0.75


@pytest.mark.thorough
@pytest.mark.parametrize("spreads", [(0.6, 0.6), (0.2, 0.9), (0.0, 0.0)])
def test_kinds_that_are_alike_are_seldom_told_apart(spreads):
    rng = np.random.default_rng(1)
    of_target = rng.standard_normal((DRAWS, 1, TARGETS))

    def kind(spread: float) -> Hits:
        odds = of_target + spread * rng.standard_normal((DRAWS, SEEDS, 1))
        return np.asarray(rng.random((DRAWS, SEEDS, TARGETS)) < 1 / (1 + np.exp(-odds)))

    both = zip(*(kind(spread) for spread in spreads), strict=True)
    found = [apart(a * 1.0, b * 1.0).interval for a, b in both]
    assert share([low <= 0 <= high for low, high in found]) >= 0.94


@pytest.mark.thorough
def test_without_a_difference_between_seeds_the_interval_is_not_useless():
    """Three seeds are few: the interval is wider than one over all swims, but not by much."""
    rng = np.random.default_rng(2)
    widths = [np.diff(of_kind(one).interval)[0] for one in hits(rng, 1.0, seeds=0.0)]
    plain = [np.diff(wilson(int(one.sum()), one.size))[0] for one in hits(rng, 1.0, seeds=0.0)]
    assert 1.0 < np.median(widths) / np.median(plain) < 2.5


def test_a_kind_that_never_missed_has_an_interval_too():
    low, high = of_kind(np.ones((SEEDS, TARGETS), bool)).interval
    assert low == pytest.approx(0.97) and high == 1.0


def test_of_one_seed_the_interval_is_over_its_targets():
    one = np.arange(TARGETS)[None] % 4 > 0
    found = over_seeds(one * 1.0)
    assert found.difference == 0.75
    assert np.diff(found.interval)[0] == pytest.approx(2 * 1.984 * np.sqrt(0.1875 / 99), rel=1e-3)


@pytest.mark.parametrize("count", [60, 125, 250])
@pytest.mark.parametrize(("gained", "gone"), [(0.01, 0.0), (0.03, 0.0), (0.02, 0.01), (0.1, 0.05)])
def test_an_interval_of_pairs_holds_the_difference_however_few_pairs_differ(count, gained, gone):
    """Chance decides which pairs differ, and which way."""
    rng = np.random.default_rng(3)
    drawn = rng.random((DRAWS, count))
    first = (drawn < 0.5) & (drawn >= gained)
    second = drawn < 0.5 - gone
    found = [paired(*one).interval for one in zip(first, second, strict=True)]
    assert share([low <= gained - gone <= high for low, high in found]) >= 0.925


def test_without_a_pair_that_differs_three_in_a_hundred_may():
    none = np.zeros(100, bool)
    found = paired(none, none)
    assert found.difference == 0.0
    assert found.interval == pytest.approx((-0.0272, 0.0272), abs=1e-4)
