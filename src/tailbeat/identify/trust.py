"""Can a fit be trusted? Compare it with naive predictors, and check its intervals' assumptions.

There are three answers. `verdict` comes first in every report: reasons why the fit is bad.
`trusted` is false if the fit should not be used at all. `doubts` are warnings about the residuals:
the intervals assume that they do not change over the recording and are independent from block to
block.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tailbeat.identify.glitches import Glitch

Array = NDArray[np.float64]
TOO_MANY = 0.2  # fraction of samples left out; above it the fit is not trusted
FEW = 0.05  # fraction of the blocks that must not have
HALF = 0.5  # of all squared error
TOGETHER = 0.5  # largest correlation of neighbouring blocks' mean errors
DRIFT = 0.5  # largest fraction of the squared error that a line over the recording explains
FEWEST_BLOCKS = 8


@dataclass(frozen=True)
class Verdict:
    """The first sentences of a report (none if the fit is good), and whether to trust the fit."""

    sentences: tuple[str, ...]
    trusted: bool


@dataclass(frozen=True, eq=False)
class Errors:
    """A fit's residuals on one recording: `error` (k,) in any unit at `time` (k,) [s]."""

    recording: str
    time: Array
    error: Array


@dataclass(frozen=True)
class Contest:
    """A fit's error over that of the best naive predictor, `best`, in one quantity."""

    quantity: str
    ratio: float
    best: str


def verdict(
    contests: Sequence[Contest],
    glitches: Sequence[tuple[str, float]],
    contradictions: Sequence[str] = (),
) -> Verdict:
    """The verdict from the naive predictors, the fraction of samples left out of each recording
    (`glitches`), and the recordings' contradictions."""
    spoilt = [
        f"do not trust this fit: {100 * share:.0f} % of the samples of {name} are glitches; record"
        f" it again"
        for name, share in glitches
        if share > TOO_MANY
    ]
    against = [f"do not trust this fit: {one}" for one in contradictions]
    lost = [
        f"the fit loses to a naive predictor: its {one.quantity} error is {one.ratio:.2f} times"
        f" that of the {one.best}"
        for one in contests
        if one.ratio > 1
    ]
    return Verdict((*spoilt, *against, *lost), not (spoilt or against))


def share_left_out(glitches: Sequence[Glitch], samples: int) -> float:
    """Fraction of a recording's `samples`, before any was left out, that are glitches in the column
    that has most of them. A tag that is seen wrongly is one sample, not three."""
    left = Counter[str]()
    for one in glitches:
        left[one.column] += 0 if one.kind == "gap" else len(one.times)
    return max(left.values(), default=0) / samples


def doubts(left: Sequence[Errors], block: float) -> list[str]:
    """A sentence for each assumption of the intervals that the residuals contradict. Residuals are
    compared between blocks of `block` [s]."""
    said = []
    if heavy := [one.recording for one in left if _heavy(one, block)]:
        said.append(
            f"over half of the squared error of {_names(heavy)} is in one twentieth of the time:"
            f" a few moments determine the fit, and the intervals may be too narrow"
        )
    if drifting := [one.recording for one in left if _drifts(one)]:
        said.append(
            f"the error of {_names(drifting)} drifts from start to end: the sensor's zero or the"
            f" servo changed, and the intervals do not include that"
        )
    if together := [one.recording for one in left if _together(one, block)]:
        said.append(
            f"the error of {_names(together)} is correlated for longer than {block:g} s: the"
            f" intervals count too much of it as independent"
        )
    return said


def _names(recordings: Sequence[str]) -> str:
    more = len(recordings) - 3
    return ", ".join(recordings[:3]) + (f" and {more} others" if more > 0 else "")


def _blocks(left: Errors, block: float) -> tuple[Array, Array]:
    """Sum of squares and mean of each block of time."""
    own = ((left.time - left.time[0]) / block).astype(int)
    count = np.maximum(np.bincount(own), 1)
    squares = np.asarray(np.bincount(own, left.error**2), dtype=float)
    return squares, np.bincount(own, left.error) / count


def _heavy(left: Errors, block: float) -> bool:
    squares, _ = _blocks(left, block)
    few = max(round(FEW * squares.size), 1)
    return squares.size >= FEWEST_BLOCKS and np.sort(squares)[-few:].sum() > HALF * squares.sum()


def _drifts(left: Errors) -> bool:
    middle = left.time - left.time.mean()
    slope = float(middle @ left.error) / float(middle @ middle)
    return bool(slope**2 * float(middle @ middle) > DRIFT * float(left.error @ left.error))


def _together(left: Errors, block: float) -> bool:
    _, means = _blocks(left, block)
    if means.size < FEWEST_BLOCKS or np.ptp(means) == 0:
        return False
    away = means - means.mean()
    return bool(float(away[1:] @ away[:-1]) > TOGETHER * float(away @ away))
