"""A hand-made rule that follows a moving target: the naive baseline beside policies that follow.

It asks for the velocity that would bring the fish to its target in some seconds, the target's own
velocity included: w = v + p / T, of the target's place p and velocity v, seen from the fish. The
stroke follows the size of w, and the centre the tangent of half its bearing. Near a target that
hardly moves w is small, and so is the centre: the fish does not turn about for centimetres. All
numbers are in the fish's measure, in m and m/s for the paper's fish. Ours.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import helper, numpy_helper

from tailbeat.control.observation import FOLLOWING
from tailbeat.env.assess import Decide
from tailbeat.train.export import linear
from tailbeat.train.features import NEWEST

Single = NDArray[np.float32]
NAMES = [one.name for one in FOLLOWING]  # of what is observed
PLACE = [NAMES.index(NEWEST + one) for one in ("ahead", "left")]
VELOCITY = [NAMES.index(f"target's velocity {one}") for one in ("ahead", "left")]
OWN = NAMES.index("own velocity ahead")
METRES, METRES_A_SECOND = FOLLOWING[PLACE[0]].scale, FOLLOWING[VELOCITY[0]].scale
GAIN = 3.0  # the centre's action over the tangent (chosen)
SOFT = 0.1  # m/s, added below: the centre is small where w is slower than this (chosen)
BEHIND = 1.05  # times the speed |w|: the centre is finite for a w straight backward
STROKE, MOST = 1.0, 0.8  # action of the stroke for 1 m/s, and the largest (chosen)
FREQUENCIES, SECONDS, RESTS = (0.25, 0.75), (1.0, 1.5, 2.0), (0.04, 0.08)  # (chosen)


@dataclass(frozen=True)
class FollowRule:
    """Constants of the rule: the frequency as an action, T [s], and the speed [m/s] at which the
    fish rests."""

    frequency: float
    seconds: float
    rest: float


def candidates() -> list[FollowRule]:
    """The rules to choose from."""
    return [FollowRule(*one) for one in product(FREQUENCIES, SECONDS, RESTS)]


def follow_rule_of(rule: FollowRule) -> Decide:
    """The rule as a function of observations (n, 28)."""
    way = _way(rule, len(NAMES)).T

    def decide(seen: Single) -> Single:
        action, (ahead, left) = np.zeros((len(seen), 6), np.float32), (seen @ way).T
        size = np.hypot(ahead, left)
        asked, own = np.maximum(size - rule.rest, 0.0), METRES_A_SECOND * seen[:, OWN]
        tangent = left / (BEHIND * size + ahead + SOFT)
        action[:, 0], action[:, 1] = rule.frequency, np.clip(GAIN * tangent, -1.0, 1.0)
        action[:, 2] = np.clip(STROKE * (2 * asked - own), 0.0, MOST)
        return action

    return decide


def _way(rule: FollowRule, inputs: int) -> Single:
    """The matrix (2, inputs) that makes w, ahead and left, of an observation."""
    way = np.zeros((2, inputs), np.float32)
    way[[0, 1], PLACE], way[[0, 1], VELOCITY] = METRES / rule.seconds, METRES_A_SECOND
    return way


def follow_layers(
    rule: FollowRule, inputs: int
) -> tuple[list[onnx.NodeProto], list[onnx.TensorProto]]:
    """Nodes and weights of the rule: w and its size; the tangent and the stroke; the action."""
    own, last = np.zeros((1, inputs)), np.zeros((6, 2))
    own[0, OWN], last[1, 0], last[2, 1] = STROKE * METRES_A_SECOND, 1.0, 1.0
    steady = [rule.frequency, 0.0, 0.0, 0.0, 0.0, 0.0]
    held = {"way": _way(rule, inputs), "both": [[1.0, 1.0]], "above": [[0.0, GAIN]], "own": own,
            "onward": [[1.0, 0.0]], "behind": BEHIND, "soft": SOFT, "twice": 2 * STROKE,
            "rest": rule.rest, "least": 0.0, "most": MOST, "low": -1.0, "high": 1.0, "last": last,
            "steady": steady}  # fmt: skip
    nodes = [
        linear("observation", "way", "wanted"),
        helper.make_node("Mul", ["wanted", "wanted"], ["squares"]),
        linear("squares", "both", "square"),
        helper.make_node("Sqrt", ["square"], ["size"]),
        linear("wanted", "above", "numerator"),
        linear("wanted", "onward", "ahead"),
        helper.make_node("Mul", ["size", "behind"], ["turned"]),
        helper.make_node("Add", ["turned", "ahead"], ["finite"]),
        helper.make_node("Add", ["finite", "soft"], ["denominator"]),
        helper.make_node("Div", ["numerator", "denominator"], ["tangent"]),
        helper.make_node("Clip", ["tangent", "low", "high"], ["centre"]),
        helper.make_node("Sub", ["size", "rest"], ["more"]),
        helper.make_node("Relu", ["more"], ["asked"]),
        helper.make_node("Mul", ["asked", "twice"], ["twice asked"]),
        linear("observation", "own", "is"),
        helper.make_node("Sub", ["twice asked", "is"], ["long"]),
        helper.make_node("Clip", ["long", "least", "most"], ["stroke"]),
        helper.make_node("Concat", ["centre", "stroke"], ["steered"], axis=1),
        linear("steered", "last", "action", "steady"),
    ]
    return nodes, [numpy_helper.from_array(np.array(v, np.float32), k) for k, v in held.items()]
