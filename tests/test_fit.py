"""The search's parts on problems that can be solved by hand: costs, slopes, polish, intervals."""

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import scipy.optimize

from tailbeat.identify import search as whole
from tailbeat.identify.intervals import estimates, intervals, trade_offs
from tailbeat.identify.polish import polish
from tailbeat.identify.search import Effort, Fit, noise_level, search, search_once
from tailbeat.identify.space import Parameter, bounds, cost, covariance, sensitivity

LOG = Parameter("stiffness", "N m/rad", 0.1, 10.0, 2.0, 0.5)
PLAIN = Parameter("offset", "m", -3.0, 5.0, 1.0, 2.0, log=False)
SPACE = (LOG, PLAIN)
SLOPE = np.array([[3.0, 0.0], [1.0, 2.0], [0.0, -1.0]])  # of the line below
LEFT = np.array([1.0, -2.0, 0.5])  # its residuals at the prior


def line(z: np.ndarray) -> np.ndarray:
    return LEFT + z @ SLOPE.T


def fit(z: list[float], total: float = 0.0, spread: np.ndarray | None = None) -> Fit:
    return Fit(0, np.array(z), total, LEFT, SLOPE, np.eye(2) if spread is None else spread)


def test_a_spread_from_the_prior_is_one_in_z_and_back():
    assert LOG.to_z(2.0) == PLAIN.to_z(1.0) == 0
    assert LOG.to_z(2.0 * math.exp(0.5)) == pytest.approx(1) and PLAIN.to_z(3.0) == 1
    for one in SPACE:
        for z in (-0.7, 0.3, 1.2):
            assert one.to_z(one.from_z(z)) == pytest.approx(z)
        assert (one.from_z(-99), one.from_z(99)) == (one.low, one.high)
    low, high = bounds(SPACE)
    assert low == pytest.approx([math.log(0.05) / 0.5, -2]) and high[1] == 2


def test_the_cost_sums_data_and_prior_and_what_diverged_costs_most():
    residuals = np.array([[1.0, 2.0], [math.nan, 0.0], [0.0, math.inf], [1e9, 0.0]])
    assert cost(residuals, np.full((4, 1), 3.0)).tolist() == [14.0, 1e12, 1e12, 1e12]


@pytest.mark.parametrize("central", [True, False])
def test_slopes_of_a_line_are_exact_and_come_from_one_call(central):
    asked: list[np.ndarray] = []

    def seen(z: np.ndarray) -> np.ndarray:
        asked.append(z)
        return line(z)

    at = np.array([0.3, -0.4])
    found, slope = sensitivity(seen, at, central, 0.1)
    assert found == pytest.approx(line(at)) and slope == pytest.approx(SLOPE)
    steps = np.array([[0, 0], [0.1, 0], [0, 0.1], [-0.1, 0], [0, -0.1]])
    assert len(asked) == 1 and asked[0] == pytest.approx(at + steps[: 5 if central else 3])


def test_differences_on_both_sides_are_exact_on_a_parabola_and_a_diverged_one_has_no_slope():
    def parabola(z: np.ndarray) -> np.ndarray:
        return z**2 + 3 * z

    assert sensitivity(parabola, np.array([1.0]))[1] == pytest.approx(np.array([[5.0]]))
    one_sided = sensitivity(parabola, np.array([1.0]), central=False)[1]
    assert one_sided == pytest.approx(np.array([[5.02]]))  # off by the step
    bad = sensitivity(lambda z: np.where(z > 1, np.inf, z), np.array([1.0]))[1]
    assert bad.tolist() == [[0.0]]


def test_the_noise_is_the_residuals_deviation_per_degree_of_freedom_from_03_to_1():
    assert noise_level(np.full(10, 0.6), 0) == pytest.approx(0.6)
    assert noise_level(np.full(10, 0.6), 6) == pytest.approx(0.6 * math.sqrt(10 / 4))
    assert noise_level(np.full(4, 0.2), 4) == pytest.approx(0.4)  # one degree at least
    assert noise_level(np.full(10, 0.01), 0) == 0.3 and noise_level(np.full(10, 7.0), 0) == 1.0


def test_the_polish_of_a_line_ends_at_least_squares_with_the_prior():
    wanted = -np.linalg.solve(SLOPE.T @ SLOPE + np.eye(2), SLOPE.T @ LEFT)
    said: list[tuple[str, float, float]] = []
    found = polish(line, SPACE, np.zeros(2), 4, lambda *words: said.append(words))
    assert found == pytest.approx(wanted, abs=2e-3)  # a thousandth of the step is damped away
    least = float(cost(line(wanted[None]), wanted[None])[0])
    # The second gains too little on an updated Jacobian, and the third on one of its own.
    assert [share for _, share, _ in said] == [0.25, 0.5, 0.75]
    assert said[-1][0] == "polish" and said[-1][2] == pytest.approx(least, rel=1e-5)


def test_the_polish_stays_in_the_range_and_stands_where_nothing_gains():
    narrow = (Parameter("a", "m", -0.1, 0.1, 0.0, 1.0, log=False), PLAIN)
    assert polish(line, narrow, np.zeros(2), 5)[0] == pytest.approx(-0.1)
    best = polish(line, SPACE, np.zeros(2), 9)
    assert np.array_equal(polish(line, SPACE, best, 9), best)


def test_a_polish_with_numbers_at_their_edges_ends_where_the_constrained_least_squares_is():
    """Numbers that trade against each other; a third or more end at an edge. Steps that were cut
    there stood still at nearly three times the least cost."""
    rng = np.random.default_rng(1)
    free = 12
    space = (Parameter("a", "1", -0.3, 0.3, 0.0, 1.0, log=False),) * free
    slope = (
        rng.normal(size=(40, free))
        @ np.diag(np.logspace(0, 2, free))
        @ rng.normal(size=(free, free))
    )
    wanted = rng.uniform(-1, 1, free)

    def traded(z: np.ndarray) -> np.ndarray:
        return (np.clip(z, -0.3, 0.3) - wanted) @ slope.T

    whole_slope = np.vstack([slope, np.eye(free)])
    best = scipy.optimize.lsq_linear(whole_slope, np.append(slope @ wanted, np.zeros(free)),
                                     (-0.3, 0.3), tol=1e-12)  # fmt: skip
    assert (np.abs(best.x) > 0.2999).sum() >= free / 3
    found = polish(traded, space, np.zeros(free), 30)
    assert float(cost(traded(found[None]), found[None])[0]) < 1.02 * 2 * best.cost


def test_at_an_edge_the_slope_is_that_of_the_inner_side():
    edges = bounds((PLAIN, PLAIN))
    low, high = edges

    def clipped(z: np.ndarray) -> np.ndarray:
        return np.clip(z, low, high) ** 2

    for at in (high, low):
        for central in (True, False):
            slope = sensitivity(clipped, at, central, 0.1, edges)[1]
            assert slope == pytest.approx(np.diag(2 * at - 0.1 * np.sign(at)))
    between = np.array([0.5, -0.5])
    assert np.array_equal(
        sensitivity(clipped, between, edges=edges)[1], sensitivity(clipped, between)[1]
    )


def test_a_polish_goes_on_for_a_gain_of_one_in_a_thousand_and_ends_at_one_in_ten_thousand():
    """A single step is offered that leaves this share of the cost."""
    for left, moved in ((0.999, True), (0.9999, False)):
        levels = iter([1.0, *[left] * 99])

        def offered(z: np.ndarray, levels: Iterator[float] = levels) -> np.ndarray:
            return np.full((len(z), 1), 1e3 * math.sqrt(next(levels)))

        found = polish(offered, SPACE[1:], np.array([1e-3]), 1)
        assert (found[0] != 1e-3) == moved


def test_the_prior_alone_leaves_a_spread_of_one_and_data_narrow_it():
    assert np.array_equal(covariance(np.zeros((3, 2))), np.eye(2))
    assert covariance(np.array([[3.0], [4.0]])) == pytest.approx(np.array([[1 / 26]]))


def test_an_interval_reaches_196_deviations_and_holds_seeds_that_fit_as_well():
    spread = np.diag([0.04, 0.01])
    (_, alone) = intervals(SPACE, [fit([0.0, 0.5], 10.0, spread)])
    assert alone == pytest.approx((2.0 - 2 * 0.196, 2.0 + 2 * 0.196), abs=1e-4)
    fits = [fit([0.0, 0.5], 10.0, spread), fit([0.0, 0.9], 13.8, spread)]
    assert intervals(SPACE, fits)[1] == pytest.approx((alone[0], 2.8), abs=1e-4)
    fits[1] = fit([0.0, -0.9], 13.8, spread)
    assert intervals(SPACE, fits)[1] == pytest.approx((-0.8, alone[1]), abs=1e-4)
    fits[1] = fit([0.0, 0.9], 13.9, spread)  # 3.84 beyond the best is too far
    assert intervals(SPACE, fits)[1] == alone
    low, high = intervals(SPACE, [fit([0.0, 0.5], 0.0, 9 * np.eye(2))])[1]
    assert (low, high) == (-3.0, 5.0)  # the range


def test_an_estimate_is_the_best_fit_s_value_with_unit_and_prior():
    found = estimates(SPACE, [fit([1.0, 0.5]), fit([0.0, 0.0])])
    assert list(found) == ["stiffness", "offset"]
    assert found["offset"].value == 2.0 and found["stiffness"].value == pytest.approx(
        2.0 * math.exp(0.5)
    )
    assert (found["offset"].unit, found["offset"].prior) == ("m", 1.0)


def test_a_pair_is_named_once_and_only_beyond_the_least_correlation():
    for r, named in ((0.89, []), (0.91, [("stiffness", "offset", 0.91)])):
        spread = np.array([[4.0, 2 * r], [2 * r, 1.0]])
        found = trade_offs(SPACE, fit([0, 0], spread=spread))
        assert found == [(a, b, pytest.approx(x)) for a, b, x in named]
    assert trade_offs(SPACE, fit([0, 0], spread=np.array([[1, -0.5], [-0.5, 1]])), 0.4)


def test_a_search_asks_for_its_population_so_many_times_and_says_how_far_it_is():
    sizes: list[int] = []
    said: list[tuple[str, float, float]] = []

    def seen(z: np.ndarray) -> np.ndarray:
        sizes.append(len(z))
        return line(z)

    words = (seen, SPACE, 0, Effort(4, 6, 2), None, lambda *one: said.append(one))
    found = search(*words)
    assert sizes[:5] == [6, 6, 6, 6, 3]  # then the polish, on one side
    assert [share for stage, share, _ in said if stage == "search"] == [0.25, 0.5, 0.75, 1.0]
    own = float(cost(line(found.z[None]), found.z[None])[0])
    assert found.seed == 0 and found.cost == pytest.approx(own)  # not that before the last rounds
    assert found.residuals == pytest.approx(line(found.z[None])[0])
    assert found.jacobian == pytest.approx(SLOPE)


def test_data_s_own_noise_counts_in_the_covariance():
    """Residuals of half their stated size, and no more: the covariance is that of noise 1/2."""
    rng = np.random.default_rng(0)
    left, slope = 0.5 * rng.normal(size=400), rng.normal(size=(400, 2))
    found = search(lambda z: left + z @ slope.T, SPACE, 0, Effort(4, 6, 6))
    level = noise_level(found.residuals, 2)
    assert level == pytest.approx(0.5, abs=0.05)
    assert found.covariance == pytest.approx(covariance(slope / level))


def test_with_scouts_the_search_begins_at_the_best_of_many_draws(monkeypatch):
    begun: list[np.ndarray] = []
    real = whole.cma.CMAEvolutionStrategy

    def noted(start: np.ndarray, *words: object) -> object:
        begun.append(start)
        return real(start, *words)

    monkeypatch.setattr(whole.cma, "CMAEvolutionStrategy", noted)
    for scouts in (0, 200):
        search(line, SPACE, 1, Effort(1, 4, 1, scouts))
    low, high = bounds(SPACE)
    costs = [float(cost(line(start[None]), start[None])[0]) for start in begun]
    best = polish(line, SPACE, np.zeros(2), 5)
    assert costs[1] < costs[0]
    assert costs[1] < 1.2 * float(cost(line(best[None]), best[None])[0])
    assert all(((low <= start) & (start <= high)).all() for start in begun)


def test_a_start_lies_inside_a_range_that_is_narrower_than_the_prior():
    narrow = (Parameter("a", "m", 0.5, 0.6, 0.0, 1.0, log=False),) * 2
    for seed in range(5):
        found = search(line, narrow, seed, Effort(1, 4, 1, scouts=seed % 2 * 3))
        assert (found.z >= 0.5).all() and (found.z <= 0.6).all()


def test_a_seed_that_is_done_is_read_and_not_searched_again(tmp_path: Path):
    calls: list[int] = []

    def seen(z: np.ndarray) -> np.ndarray:
        calls.append(len(z))
        return line(z)

    said: list[tuple] = []
    once = [seen, SPACE, 3, Effort(2, 4, 2), tmp_path, lambda *one: said.append(one)]
    first = search_once(*once)  # type: ignore[arg-type]
    asked = len(calls)
    again = search_once(*once)  # type: ignore[arg-type]
    assert len(calls) == asked and np.array_equal(first.z, again.z) and again.seed == 3
    assert {seed for seed, *_ in said} == {3} and said[0][1:3] == ("search", 0.5)
    kept = {one.name.partition("-")[0] for one in tmp_path.iterdir()}
    assert kept == {"seed3.fit", "seed3.search"}


def test_a_start_is_a_draw_of_half_a_spread_about_the_prior():
    """A start far from the prior, or always the same, would find other valleys."""
    wide = tuple(Parameter(str(i), "1", -9.0, 9.0, 0.0, 1.0, log=False) for i in range(40))
    made = [whole._strategy(line, wide, seed, Effort()) for seed in range(10)]
    starts = np.array([one.x0 for one in made])
    assert abs(starts.mean()) < 0.1 and starts.std() == pytest.approx(0.5, rel=0.1)
    assert made[0].sigma0 == 0.4 and made[0].popsize == Effort().population
    assert [one.opts["seed"] for one in made[:3]] == [1, 2, 3]


def test_scouts_are_drawn_from_the_prior_and_stay_off_the_range_s_edges():
    seen: list[np.ndarray] = []

    def noted(z: np.ndarray) -> np.ndarray:
        seen.append(z)
        return z

    tight = (Parameter("a", "1", -1.0, 1.0, 0.0, 1.0, log=False),) * 3
    whole._strategy(noted, tight, 0, Effort(scouts=500))
    (drawn,) = seen
    assert drawn.min() == -0.99 and drawn.max() == 0.99
    wide = (Parameter("a", "1", -9.0, 9.0, 0.0, 1.0, log=False),) * 3
    whole._strategy(noted, wide, 0, Effort(scouts=500))
    assert abs(seen[1].mean()) < 0.1 and seen[1].std() == pytest.approx(1.0, rel=0.1)
    narrow = (Parameter("a", "1", 0.5, 0.6, 0.0, 1.0, log=False),) * 3
    start = whole._strategy(noted, narrow, 3, Effort()).x0
    assert (start.min(), start.max()) == pytest.approx((0.51, 0.59))


def test_each_round_of_the_polish_tries_five_dampings():
    tried: list[np.ndarray] = []

    def noted(z: np.ndarray) -> np.ndarray:
        tried.append(z)
        return line(z)

    start = np.array([0.3, -0.4])
    polish(noted, SPACE, start, 1)
    found, slope = line(start[None])[0], SLOPE
    normal, pull = slope.T @ slope + np.eye(2), slope.T @ found + start
    for z, damping in zip(tried[1], [1e-3, 1e-2, 1e-1, 1.0, 10.0], strict=True):
        step = np.linalg.solve(normal + damping * np.diag(np.diag(normal)), -pull)
        assert z == pytest.approx(start + step, abs=1e-9)


def test_a_search_ends_with_two_rounds_on_both_sides_and_one_with_wide_steps(capfd):
    tried: list[np.ndarray] = []

    def noted(z: np.ndarray) -> np.ndarray:
        tried.append(z)
        return line(z)

    found = search(noted, SPACE, 0, Effort(2, 4, 6))
    widths = [len(one) for one in tried]
    assert widths.count(5) > 2  # 2 numbers on both sides, and 5 dampings
    probes = tried[-1]
    assert len(probes) == 5 and probes[1] - probes[0] == pytest.approx([0.2, 0.0])
    assert np.array_equal(probes[0], found.z)
    assert capfd.readouterr() == ("", "")


def test_exact_data_count_more_against_the_prior_after_the_rounds():
    """Residuals without noise: the last rounds take the floor of the noise, 0.3, for it."""
    exact = search(lambda z: np.repeat(0.05 * (z - 2.0), 40, axis=1), SPACE, 0, Effort(4, 6, 8))
    weight = 40 * 0.05**2 / whole.NOISE_FLOOR**2
    assert exact.z == pytest.approx(2 * weight / (1 + weight) * np.ones(2), abs=1e-3)


def test_one_candidate_has_a_cost_as_many_have():
    left, z = np.array([1.0, 2.0]), np.array([3.0])
    assert float(cost(left, z)) == 14.0
    assert cost(left[None], z[None]).tolist() == [14.0]


def test_the_usual_effort():
    assert Effort() == Effort(generations=15, population=14, polish=30, scouts=0)


def test_intervals_widen_only_by_as_much_as_is_asked():
    fits = [fit([0.0, 0.5], 10.0, np.diag([0.04, 0.01])), fit([0.0, 0.9], 15.0)]
    alone = intervals(SPACE, fits[:1])[1]
    assert intervals(SPACE, fits)[1] == alone  # 5 beyond the best, and 3.84 are allowed
    assert estimates(SPACE, fits)["offset"].interval == alone
    assert intervals(SPACE, fits, excess=2.0)[1] == pytest.approx((alone[0], 2.8))
    assert estimates(SPACE, fits, excess=2.0)["offset"].interval[1] == pytest.approx(2.8)


def test_a_polish_on_updated_jacobians_ends_where_one_on_new_ones_does(monkeypatch):
    """On a curved cost: the updates are Broyden's, not wrong ones."""
    ends, calls = [], []
    for secants in (0, 3):
        monkeypatch.setattr("tailbeat.identify.polish.SECANTS", secants)
        asked: list[int] = []

        def curved(z: np.ndarray, asked: list[int] = asked) -> np.ndarray:
            asked.append(len(z))
            x = z + 0.3 * z**2
            return 10 * (x + 0.3 * np.roll(x, 1, axis=1) ** 2 - np.linspace(0.2, 0.9, 20))

        ends.append(polish(curved, (PLAIN,) * 20, np.zeros(20), 30))
        calls.append(asked)
    assert ends[1] == pytest.approx(ends[0], abs=2e-3)
    assert calls[0][:4] == [21, 5, 21, 5] and calls[1][:5] == [21, 5, 5, 5, 5]


def test_a_cheap_search_explores_from_three_starts_and_is_judged_on_all_residuals(tmp_path):
    """What is best on the cheap residuals diverges on all: then all of them are explored."""

    def cheap(z: np.ndarray) -> np.ndarray:
        return 10 * (z - 0.5)

    def diverging(z: np.ndarray) -> np.ndarray:
        near = (np.abs(z - 0.5) < 0.3).all(axis=1, keepdims=True)
        return np.where(near, np.inf, 10 * (z + 0.5))

    space, effort = (PLAIN, PLAIN), Effort(generations=12, population=8, polish=6)
    found = search(cheap, space, 0, effort, tmp_path / "a", cheap=cheap)
    kept = sorted(path.name for path in tmp_path.iterdir() if "start" in path.name)
    assert kept == ["a-start0", "a-start1", "a-start2"]
    assert found.z == pytest.approx([0.5, 0.5], abs=0.02)
    found = search(diverging, space, 0, effort, tmp_path / "b", cheap=cheap)
    assert found.z == pytest.approx([-0.5, -0.5], abs=0.02)
