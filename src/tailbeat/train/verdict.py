"""Is a stage passed? A sequential test on greedy swims, from which nothing is learnt.

Wald's sequential probability ratio test (Wald 1945) between a policy that reaches `GOOD` of its
targets and one that reaches `POOR`. The paper promotes by the success of the exploring policy. That
can pass while the greedy policy fails (seen once: 0.20), and it comes late: a greedy policy reached
98 % of the first stage's targets after 1,100 updates, exploring fish 95 % after 2,800.
"""

import math
from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from tailbeat.env.assess import Settled, Swims, joined
from tailbeat.env.curriculum import PROMOTED

Flags = NDArray[np.bool_]
GOOD, POOR = 0.97, 0.90  # shares reached, chosen about the paper's 0.95
ERROR = 0.05  # how often each of the two may be taken for the other
MOST = 256  # swims; then the share decides
EDGE = math.log((1 - ERROR) / ERROR)


def passed(arrived: int, missed: int) -> bool | None:
    """Whether greedy swims pass a stage, None while they do not tell yet. After `MOST` swims at
    least `PROMOTED` of them must have arrived."""
    evidence = arrived * math.log(GOOD / POOR) + missed * math.log((1 - GOOD) / (1 - POOR))
    if abs(evidence) >= EDGE:
        return evidence > 0
    swims = arrived + missed
    return arrived >= PROMOTED * swims if swims >= MOST else None


def certain(arrived: int, missed: int, reached: Flags, going: Flags) -> bool:
    """Whether the swims of a batch that are still `going` cannot change the verdict any more,
    whatever `arrived` and `missed` in batches before it."""
    arrived += int(reached.sum())
    missed += int((~reached & ~going).sum())
    left = int(going.sum())
    return passed(arrived, missed + left) is True or passed(arrived + left, missed) is False


def examine(swim: Callable[[int, Settled], Swims]) -> tuple[bool, Swims]:
    """The verdict and the swims that it rests on. `swim` gives those of a batch by its number, and
    ends them once they are settled; what was on its way then counts as missed."""
    swims: list[Swims] = []
    arrived = missed = 0
    while (said := passed(arrived, missed)) is None:
        swims.append(swim(len(swims), partial(certain, arrived, missed)))
        arrived = sum(int(one.reached.sum()) for one in swims)
        missed = sum(one.reached.size for one in swims) - arrived
    return said, joined(swims)
