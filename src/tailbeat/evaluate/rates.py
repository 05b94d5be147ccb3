"""Success rates with their 95 % intervals, and differences of two over the same targets."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr
from scipy.stats import binomtest, t

from tailbeat.evaluate.runs import Runs

Z95 = 1.96  # standard deviations on each side
LEVEL = float(2 * ndtr(Z95) - 1)  # 95 %, computed from them
Flags = NDArray[np.bool_]
Array = NDArray[np.floating[Any]]


@dataclass(frozen=True, kw_only=True)
class SuccessRates:
    """Fractions of targets that the fish `arrived` at (within 5 cm, for the paper's fish) or came
    `near` (within 20 cm), with 95 % Wilson intervals (low, high)."""

    arrived: float
    arrived_interval: tuple[float, float]
    near: float
    near_interval: tuple[float, float]


@dataclass(frozen=True)
class Difference:
    """Difference of two success rates over the same targets, with its 95 % interval (low, high)."""

    difference: float
    interval: tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class ConditionResult(SuccessRates):
    """Results under one condition: number of swims and of lost ones, success rates, and their
    difference to the reference condition's."""

    condition: str
    swims: int
    lost: int
    arrived_cost: Difference
    near_cost: Difference


def success(reached: Flags, near: Flags) -> SuccessRates:
    """Success rates from arrivals (n,) and from who came near (n,)."""
    return SuccessRates(
        arrived=float(reached.mean()),
        arrived_interval=wilson(int(reached.sum()), reached.size),
        near=float(near.mean()),
        near_interval=wilson(int(near.sum()), near.size),
    )


def against(reference: Runs, conditions: Mapping[str, Runs]) -> tuple[ConditionResult, ...]:
    """A result per condition, each compared with the reference swim by swim."""
    return tuple(_against(reference, name, runs) for name, runs in conditions.items())


def _against(reference: Runs, name: str, runs: Runs) -> ConditionResult:
    both = min(reference.count, runs.count)
    close, near = reference.reached[:both], reference.near[:both]
    return ConditionResult(
        condition=name,
        swims=runs.count,
        lost=int(runs.lost.sum()),
        **vars(success(runs.reached, runs.near)),
        arrived_cost=paired(close, runs.reached[:both]),
        near_cost=paired(near, runs.near[:both]),
    )


def paired(first: Flags, second: Flags) -> Difference:
    """Success rate of `second` (n,) minus that of `first` (n,) over the same targets. The interval
    is normal, after one more pair that differs each way (Bonett and Price 2012, from memory). So it
    has a width where no pair differs. Of 125 pairs of which one in a hundred differs, one way, it
    holds the difference in 100 % of studies, without the two pairs in 71 %."""
    n, gained = first.size, int((second & ~first).sum())
    gone = int((first & ~second).sum())
    differ, middle = (gained + gone + 2) / (n + 2), (gained - gone) / (n + 2)
    half = float(Z95 * np.sqrt((differ - middle**2) / (n + 2)))
    return Difference((gained - gone) / n, (max(middle - half, -1.0), min(middle + half, 1.0)))


def of_kind(hits: Flags) -> Difference:
    """Success rate of a kind of policy from the hits of its seeds (seeds, targets), with its 95 %
    interval over both."""
    found = over_seeds(hits * 1.0)
    return Difference(found.difference, (max(found.interval[0], 0.0), found.interval[1]))


def over_seeds(values: Array) -> Difference:
    """Mean of hits, or of differences of hits (seeds, targets), with its 95 % interval over both,
    as random as each other: another lab trains other seeds and swims to other targets. Of one seed
    it is that over targets.

    The mean's variance is that between the seeds' means over their number, plus that between the
    targets' means over theirs; what neither explains counts twice, which errs on the safe side.
    Each part has its own Student's t, that of two kinds' seeds with Welch's degrees of freedom, and
    the half widths are added in squares (modified large sample, after Graybill and Wang 1980). One
    t with Satterthwaite's degrees of freedom held 92.6 % where 95 % are meant. Half an interval is
    never below 3 / targets (rule of three): what never failed has one too.
    """
    return _interval([values], values.mean(axis=0))


def apart(first: Array, second: Array) -> Difference:
    """Mean of `first` (seeds, targets) minus that of `second`, whose seeds are others and whose
    targets are the same, with its 95 % interval as in `over_seeds`."""
    return _interval([first, second], first.mean(axis=0) - second.mean(axis=0))


def _interval(seeds: Sequence[Array], by_target: Array) -> Difference:
    of_targets = by_target.var(ddof=1) / by_target.size
    means = [one.mean(axis=1) for one in seeds if len(one) > 1]
    parts = [(own.var(ddof=1) / own.size, own.size - 1) for own in means]
    of_seeds = sum(variance for variance, _ in parts)
    half = t.ppf(0.5 + LEVEL / 2, by_target.size - 1) ** 2 * of_targets
    if of_seeds:
        free = of_seeds**2 / sum(variance**2 / free for variance, free in parts)
        half += t.ppf(0.5 + LEVEL / 2, free) ** 2 * of_seeds
    middle, half = float(by_target.mean()), max(float(np.sqrt(half)), 3 / by_target.size)
    return Difference(middle, (max(middle - half, -1.0), min(middle + half, 1.0)))


def wilson(hits: int, count: int) -> tuple[float, float]:
    """95 % interval of a success rate (Wilson 1927)."""
    low, high = binomtest(hits, count).proportion_ci(LEVEL, method="wilson")
    return float(low), float(high)
