"""A stage is passed by greedy swims: the test is right as often as it says, and ends no swim that
could change it."""

from functools import partial

import numpy as np
import pytest

from tailbeat.env.assess import Settled, Swims
from tailbeat.train.verdict import ERROR, GOOD, MOST, POOR, certain, examine, passed

BATCH = 64  # swims of one evaluation


def swims(reached: np.ndarray) -> Swims:
    """Swims of which only the arrivals are of interest."""
    nothing = np.full(len(reached), np.nan)
    return Swims(reached, *(nothing,) * 6, seen=np.zeros((1, 24), np.float32))


def verdict(share: float, rng: np.random.Generator) -> bool:
    """The verdict on a policy that reaches a share of its targets, by batches as in training."""
    return examine(lambda batch, settled: swims(rng.uniform(size=BATCH) < share))[0]


def rate(share: float) -> float:
    rng = np.random.default_rng(round(1000 * share))
    return float(np.mean([verdict(share, rng) for _ in range(2_000)]))


def test_poor_policies_fail_and_good_ones_pass():
    assert rate(0.20) == 0.0
    assert rate(POOR) < ERROR + 0.02
    assert rate(GOOD) > 1 - ERROR - 0.02
    assert rate(0.85) < 0.005 < 0.2 < rate(0.95) < 0.9 < 0.999 < rate(0.995)


def test_one_batch_decides_what_is_clear():
    assert passed(BATCH, 0) is True
    assert passed(0, 4) is False
    assert passed(58, 3) is None


@pytest.mark.parametrize(("missed", "said"), [(12, True), (13, False)])
def test_swims_that_never_tell_are_judged_by_their_share(missed, said):
    assert passed(MOST - missed, missed) is said


def ending(will: np.ndarray, order: np.ndarray, settled: Settled) -> tuple[Swims, int]:
    """A batch whose swims end one by one in an order, until it is settled; how many were left."""
    reached, going = np.zeros(len(will), bool), np.ones(len(will), bool)
    for fish in order:
        if settled(reached, going):
            break
        reached[fish], going[fish] = will[fish], False
    return swims(reached), int(going.sum())


@pytest.mark.thorough
@pytest.mark.parametrize("share", [0.85, 0.93, 0.97, 0.99])
def test_swims_that_are_cut_short_give_the_verdict_of_whole_ones(share):
    """Arrivals end first, misses last."""
    rng, saved = np.random.default_rng(5), 0
    for _ in range(300):
        batches = [rng.uniform(size=BATCH) < share for _ in range(MOST // BATCH)]
        left: list[int] = []
        assert examine(partial(cut, batches, left))[0] is examine(partial(uncut, batches))[0]
        assert all(one == 0 for one in left[:-1])  # a batch that does not decide is swum to its end
        saved += left[-1]
    assert saved > 0


def uncut(batches: list[np.ndarray], batch: int, settled: Settled) -> Swims:
    return swims(batches[batch])


def cut(batches: list[np.ndarray], left: list[int], batch: int, settled: Settled) -> Swims:
    found, over = ending(batches[batch], np.argsort(~batches[batch], kind="stable"), settled)
    left.append(over)
    return found


def test_nothing_is_certain_while_a_swim_on_its_way_decides():
    reached = np.arange(BATCH) < 62
    going = np.arange(BATCH) == 63
    assert not certain(0, 0, reached, going)  # 62 of 64 tell nothing, 63 of 64 pass
    assert certain(0, 0, np.arange(BATCH) < 63, going)
