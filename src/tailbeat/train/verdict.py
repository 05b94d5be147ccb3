"""Is a stage passed? A sequential test on greedy swims, from which nothing is learnt.

Wald's sequential probability ratio test (Wald 1945) between a policy that reaches `GOOD` of its
targets and one that reaches `POOR`. The paper promotes by the success of the exploring policy; that
can pass while the greedy policy fails (seen once: 0.20).
"""

import math
from collections.abc import Sequence

GOOD, POOR = 0.97, 0.90  # shares reached, chosen about the paper's 0.95
ERROR = 0.05  # how often each of the two may be taken for the other
MOST = 256  # swims; then the share decides
EDGE = math.log((1 - ERROR) / ERROR)


def passed(reached: Sequence[bool], threshold: float) -> bool | None:
    """Whether greedy swims pass a stage, None while they do not tell yet. After `MOST` swims at
    least a share of `threshold` must have reached."""
    arrived = sum(reached)
    missed = len(reached) - arrived
    evidence = arrived * math.log(GOOD / POOR) + missed * math.log((1 - GOOD) / (1 - POOR))
    if abs(evidence) >= EDGE:
        return evidence > 0
    return arrived >= threshold * len(reached) if len(reached) >= MOST else None
