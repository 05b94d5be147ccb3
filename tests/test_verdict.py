"""A stage is passed by greedy swims: the test is right as often as it says."""

import numpy as np
import pytest

from tailbeat.train.verdict import ERROR, GOOD, MOST, POOR, passed

BATCH = 64  # swims of one evaluation


def verdict(share: float, rng: np.random.Generator) -> bool:
    """The verdict on a policy that reaches a share of its targets, by batches as in training."""
    reached: list[bool] = []
    while (said := passed(reached, 0.95)) is None:
        reached += [bool(one) for one in rng.uniform(size=BATCH) < share]
    return said


def rate(share: float) -> float:
    rng = np.random.default_rng(round(1000 * share))
    return float(np.mean([verdict(share, rng) for _ in range(2_000)]))


def test_poor_policies_fail_and_good_ones_pass():
    assert rate(0.20) == 0.0
    assert rate(POOR) < ERROR + 0.02
    assert rate(GOOD) > 1 - ERROR - 0.02
    assert rate(0.85) < 0.005 < 0.2 < rate(0.95) < 0.9 < 0.999 < rate(0.995)


def test_one_batch_decides_what_is_clear():
    assert passed([True] * BATCH, 0.95) is True
    assert passed([False] * 4, 0.95) is False
    assert passed([True] * 58 + [False] * 3, 0.95) is None


@pytest.mark.parametrize(("missed", "said"), [(12, True), (13, False)])
def test_swims_that_never_tell_are_judged_by_their_share(missed, said):
    assert passed([True] * (MOST - missed) + [False] * missed, 0.95) is said
