"""A hand-made steering rule as a policy: the naive baseline beside every learned one. That of
targets that move is in `follow_rule`.

The tail beats at one frequency with one stroke, and its centre follows the tangent of half the
target's bearing: centre = gain tan(beta / 2), bounded. Frequency, stroke and gain are the best of a
small grid in the twin, as one would choose them by hand. Ours.

The bearing beta is seen from the heading or, if the policy observes averages, from the course: the
direction of its own velocity, averaged over a second. A tag glued askew turns bearing and course
alike, and a current is in the course.
"""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import helper, numpy_helper

from tailbeat.control.actions import Generator
from tailbeat.control.observation import REMEMBERING
from tailbeat.env.assess import Decide, Swims, assess
from tailbeat.env.world import World
from tailbeat.files import BadInput, refuse_existing
from tailbeat.train.config import RunConfig, measured_run
from tailbeat.train.export import GOLDEN, contract_of, linear, model_of, save
from tailbeat.train.features import COURSE, NEWEST
from tailbeat.train.follow_rule import FollowRule, candidates, follow_layers, follow_rule_of

Single = NDArray[np.float32]
Progress = Callable[[str, int, int], None]
Each = Callable[..., list[Any]]  # `cluster.jobs.map_jobs`
NAMES = [one.name for one in REMEMBERING]  # of what is observed
DISTANCE, AHEAD, LEFT = (NAMES.index(NEWEST + one) for one in ("distance", "ahead", "left"))
ONWARD, ASIDE = (NAMES.index(COURSE.format(one)) for one in ("ahead", "left"))
SLOWLY = 0.05  # added to the velocity ahead: a fish at rest, or going backward, keeps its heading
BEHIND = (
    1.05  # times the distance, for 1 in tan(beta / 2) = sin / (1 + cos): finite straight behind
)
LEAST = 1e-3  # added below, for a target at the tag
FREQUENCIES, STROKES, GAINS = (0.0, 0.5), (0.6, 1.0), (3.0, 6.0, 12.0)  # of actions (chosen)
TUNED, TRIED = 64, 250  # targets to choose by, and others to report


@dataclass(frozen=True)
class Rule:
    """Constants of the rule, as actions: of the frequency and the first harmonic, in [-1, 1], and
    of the centre over tan(beta / 2). With `course` beta is seen from the course."""

    frequency: float
    stroke: float
    gain: float
    course: bool = False


@dataclass(frozen=True)
class RuleResult:
    """The best rule, and what it reaches, or follows, of other targets in the twin, with all noise,
    within +-180 deg: a fraction, the median time of arrivals [s], and the mean distance to the
    target [m]."""

    policy: str
    rule: Rule | FollowRule
    targets: int
    reached: float
    median_seconds: float
    mean_distance: float


def make(run: RunConfig, path: Path, progress: Progress, each: Each) -> RuleResult:
    """Choose the best rule for a run's fish, and write it as a policy; `each` lets every candidate
    swim. Raises BadInput for actions that are no generator, or a file that exists."""
    refuse_existing(path)
    run = measured_run(run)
    if not isinstance(run.space(), Generator):
        raise BadInput(f"{run.fish.name}: the steering rule needs a generator, so a pulley.")
    rules = _candidates(run)
    scored = each(partial(_scored, run, TUNED), rules, partial(progress, "rules"))
    best = rules[max(range(len(rules)), key=scored.__getitem__)]
    swims = _swum(best, run, TRIED, run.seed + 1)
    seen = swims.seen[np.linspace(0, len(swims.seen) - 1, GOLDEN).astype(int)]
    done = swims.summary()
    facts: dict[str, str | int | float] = {"recipe": "steering rule", "seed": run.seed}
    facts |= {"stage": "rule", "reached": done.reached, **asdict(best)}
    facts |= {"target_speed": run.settings(0).task.target_speed}
    contract = contract_of(run, seen, rule_of(best)(seen), facts)
    save(model_of(*layers(best, len(contract.observation)), 6, contract), path)
    apart = float(swims.apart.mean())
    return RuleResult(str(path), best, done.targets, done.reached, done.median_seconds, apart)


def _candidates(run: RunConfig) -> Sequence[Rule | FollowRule]:
    """The rules to choose from, for the run's task."""
    if run.recipe.task.follow:
        return candidates()
    return [Rule(*one, run.averages) for one in product(FREQUENCIES, STROKES, GAINS)]


def rule_of(rule: Rule | FollowRule) -> Decide:
    """The rule as a function of observations (n, 24), with a course (n, 42), and (n, 28) of one
    that follows."""
    return follow_rule_of(rule) if isinstance(rule, FollowRule) else _steering(rule)


def _steering(rule: Rule) -> Decide:
    """The rule that reaches targets."""

    def decide(seen: Single) -> Single:
        action = np.zeros((len(seen), 6), np.float32)
        away, ahead, left = seen[:, [DISTANCE, AHEAD, LEFT]].T
        if rule.course:
            onward, aside = np.maximum(seen[:, ONWARD], 0) + SLOWLY, seen[:, ASIDE]
            away = away * np.hypot(onward, aside)
            ahead, left = ahead * onward + left * aside, left * onward - ahead * aside
        action[:, 1] = np.clip(rule.gain * left / (BEHIND * away + ahead + LEAST), -1.0, 1.0)
        action[:, 0], action[:, 2] = rule.frequency, rule.stroke
        return action

    return decide


def _swum(rule: Rule | FollowRule, run: RunConfig, targets: int, seed: int) -> Swims:
    """Swims of a rule in the run's last stage: all noise, targets all around."""
    last = run.settings(len(run.recipe.stages) - 1)
    settings = replace(last, task=replace(last.task, arc=np.pi))
    return assess(rule_of(rule), lambda seeds: World(run.fish, settings, seeds), targets, seed)


def _scored(run: RunConfig, targets: int, rule: Rule | FollowRule) -> tuple[float, float]:
    """How good a candidate is."""
    return _score(_swum(rule, run, targets, run.seed), run.recipe.task.follow)


def _score(swims: Swims, follow: bool) -> tuple[float, float]:
    """How good swims are: the fraction reached, then the speed of all; of those that follow, the
    mean distance, since a target that is lost is far away."""
    if follow:
        return -float(swims.apart.mean()), float(swims.reached.mean())
    return float(swims.reached.mean()), -float(swims.seconds.mean())


def layers(
    rule: Rule | FollowRule, inputs: int
) -> tuple[list[onnx.NodeProto], list[onnx.TensorProto]]:
    """Nodes and weights of the rule: where the target is, seen from the heading or the course; its
    tangent; the action."""
    if isinstance(rule, FollowRule):
        return follow_layers(rule, inputs)
    place = np.zeros((3, inputs))
    place[[0, 1, 2], [DISTANCE, AHEAD, LEFT]] = 1.0
    centre = np.array([[0.0, 1.0, 0.0, 0.0, 0.0, 0.0]]).T
    rest = [rule.frequency, 0.0, rule.stroke, 0.0, 0.0, 0.0]
    held = {"place": place, "above": [[0.0, 0.0, rule.gain]], "below": [[BEHIND, 1.0, 0.0]],
            "least": [LEAST], "low": -1.0, "high": 1.0, "centre": centre, "rest": rest}  # fmt: skip
    nodes = [linear("observation", "place", "seen")]
    if rule.course:
        more, turned = _turned(inputs)
        nodes, held = [*nodes, *turned], held | more
    seen = nodes[-1].output[0]
    nodes += [
        linear(seen, "above", "numerator"),
        linear(seen, "below", "denominator", "least"),
        helper.make_node("Div", ["numerator", "denominator"], ["tangent"]),
        helper.make_node("Clip", ["tangent", "low", "high"], ["bounded"]),
        linear("bounded", "centre", "action", "rest"),
    ]
    return nodes, [numpy_helper.from_array(np.array(v, np.float32), k) for k, v in held.items()]


def _turned(inputs: int) -> tuple[dict[str, Any], list[onnx.NodeProto]]:
    """Weights and nodes that see distance, ahead and left from the course, times the speed."""
    onward, aside = np.zeros((1, inputs)), np.zeros((1, inputs))
    onward[0, ONWARD] = aside[0, ASIDE] = 1.0
    one, turn = np.eye(3), np.array([[0, 0, 0], [0, 0, 1], [0, -1, 0]])
    held = {"onward": onward, "aside": aside, "zero": 0.0, "most": 1e6, "slowly": [SLOWLY],
            "away": one[:, :1] @ one[:1], "along": np.diag([0, 1, 1]), "across": turn}  # fmt: skip
    nodes = [
        linear("observation", "onward", "forward"),
        helper.make_node("Clip", ["forward", "zero", "most"], ["never back"]),
        helper.make_node("Add", ["never back", "slowly"], ["u"]),
        linear("observation", "aside", "v"),
        helper.make_node("Mul", ["u", "u"], ["uu"]),
        helper.make_node("Mul", ["v", "v"], ["vv"]),
        helper.make_node("Add", ["uu", "vv"], ["square"]),
        helper.make_node("Sqrt", ["square"], ["speed"]),
    ]
    for scale, matrix, name in (("speed", "away", "a"), ("u", "along", "b"), ("v", "across", "c")):
        nodes += [linear("seen", matrix, f"{name} of it"),
                  helper.make_node("Mul", [f"{name} of it", scale], [name])]  # fmt: skip
    nodes += [helper.make_node("Add", ["a", "b"], ["ab"]),
              helper.make_node("Add", ["ab", "c"], ["turned"])]  # fmt: skip
    return held, nodes
