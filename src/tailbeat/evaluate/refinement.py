"""What refining a policy from its logs gains, measured in messy labs of the virtual pool.

Each lab is one robot in one pool. Its policy swims to targets as it is, swims logged laps, is
refined from these as `tailbeat refine` does, and swims to the same targets again. Beside it swims a
policy with the corrections that the lab really needs, which no user knows.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from tailbeat.control.corrections import Corrections
from tailbeat.control.policy import Policy, decide
from tailbeat.env.world import seeds_from
from tailbeat.evaluate.evaluation import EvaluationConfig, pool_of
from tailbeat.evaluate.logged_swims import swims
from tailbeat.evaluate.rates import wilson
from tailbeat.evaluate.scenes import grid
from tailbeat.evaluate.trial import Pool, in_labs, swim
from tailbeat.files import BadInput
from tailbeat.identify.offsets import Offsets, offsets
from tailbeat.pool import mess
from tailbeat.pool.mess import Lab, Sizes
from tailbeat.pool.water import Water
from tailbeat.train.refine import CORRECTABLE, corrected

TOLD = ("tag askew", "tag sideways", "gyro bias")  # whose true values a lab has exactly
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class RefinementConfig:
    """Where to measure: the pool's `fish` and the policy's `twin` as in `EvaluationConfig`; a level
    of `mess`, or sizes of nuisances; `labs` of it, `targets` in each; `swims` logged swims of
    `seconds`, in the paper's pool or in open water (`walled`), before each of `rounds`."""

    fish: str = "pulley-fish"
    twin: str | None = None
    mess: str | Sizes = "rough"
    labs: int = 10
    targets: int = 16
    swims: int = 3
    seconds: float = 60.0
    rounds: int = 1
    walled: bool = True
    seed: int = 0


@dataclass(frozen=True)
class Estimate:
    """An offset that the swims gave, with its 95 % interval, and what the lab really had."""

    name: str
    unit: str
    value: float
    interval: tuple[float, float]
    told: bool
    truth: float

    @property
    def held(self) -> bool:
        """Whether the interval holds the truth."""
        return self.interval[0] <= self.truth <= self.interval[1]


@dataclass(frozen=True)
class LabResult:
    """One lab: targets reached within 5 cm `before`, after each round of refining, and with the
    `true` corrections; the offsets of the last round."""

    before: int
    after: tuple[int, ...]
    true: int
    estimates: tuple[Estimate, ...]


@dataclass(frozen=True)
class Refinement:
    """All labs, `targets` targets each, and the fractions of all targets that were reached, with
    95 % intervals over targets."""

    config: RefinementConfig
    labs: tuple[LabResult, ...]
    before: tuple[float, float, float]
    after: tuple[float, float, float]
    true: tuple[float, float, float]


def refinement(policy: Policy, config: RefinementConfig, progress: Progress) -> Refinement:
    """Measure in every lab. Raises BadInput for a policy that does not fit the pool's fish."""
    _check(config)
    pool = pool_of(policy, EvaluationConfig(config.fish, config.twin, episodes=config.targets))
    found = []
    for number in range(config.labs):
        found.append(refine_in_lab(policy, pool, config, number))
        progress("labs", number + 1, config.labs)
    total = config.labs * config.targets
    return Refinement(
        config,
        tuple(found),
        _rate(sum(one.before for one in found), total),
        _rate(sum(one.after[-1] for one in found), total),
        _rate(sum(one.true for one in found), total),
    )


def _check(config: RefinementConfig) -> None:
    least = {"labs": 1, "targets": 2, "swims": 1, "rounds": 1}
    for name, low in least.items():
        if getattr(config, name) < low:
            raise BadInput(f"--{name} {getattr(config, name)}: give {low} or more.")


def refine_in_lab(policy: Policy, pool: Pool, config: RefinementConfig, number: int) -> LabResult:
    """Swim, refine and swim again with one robot in one pool. `evaluate` swims in other labs."""
    sizes = mess.level(config.mess) if isinstance(config.mess, str) else config.mess
    lab = mess.draw(sizes, [config.seed, number, 1])
    water = pool.waters[number % len(pool.waters)]
    reached = partial(_reached, policy, pool, lab, water, config.seed + number)
    own, after, found, bias = policy, [], None, 0.0
    for turn in range(config.rounds):
        found, bias = _offsets(own, pool, lab, water, config, (number, turn))
        corrections = _refined(own, found)
        own = replace(policy, contract=replace(policy.contract, corrections=corrections))
        after.append(reached(corrections))
    assert found is not None
    needed = true_corrections(lab, bias)
    return LabResult(reached(None), tuple(after), reached(needed), _estimates(found, needed))


def _refined(policy: Policy, found: Offsets) -> Corrections | None:
    """New corrections; the old ones where an offset is beyond what a lab gets wrong."""
    try:
        return corrected(policy.contract, found)[0]
    except BadInput:
        return policy.contract.corrections


def _offsets(
    policy: Policy,
    pool: Pool,
    lab: Lab,
    water: Water,
    config: RefinementConfig,
    which: tuple[int, int],
) -> tuple[Offsets, float]:
    """What logged swims tell, and the mean bias of the gyros in them."""
    seed = int(np.random.SeedSequence([config.seed, *which]).generate_state(1)[0])
    walls = pool.walls if config.walled else None
    done = swims(policy, pool.fish, [(lab, water)] * config.swims, config.seconds, seed, walls)
    return offsets(done.logged), float(done.yaw_rate_bias.mean())


def true_corrections(lab: Lab, yaw_rate_bias: float) -> Corrections:
    """What a lab needs, but for the bend of its tail, whose best zero nobody knows exactly."""
    wrong = lab.errors
    return Corrections(
        askew=wrong.askew,
        left=wrong.left,
        shaft=wrong.encoder - wrong.horn,
        setpoint=-wrong.horn,
        yaw_rate=yaw_rate_bias,
    )


def _reached(
    policy: Policy, pool: Pool, lab: Lab, water: Water, seed: int, known: Corrections | None
) -> int:
    """Targets that a policy reaches with these corrections."""
    reach = pool.measure.reach
    scene = grid(pool.fish, pool.count, seed, 0.5 * reach, 2.5 * reach, np.pi)
    waters = (water,) * pool.count
    condition = in_labs(pool.condition("lab", scene, water=waters), [lab] * pool.count)
    runs = swim(
        partial(decide, policy),
        replace(condition, corrections=known),
        seeds_from(seed, pool.count),
    )
    return int(runs.reached.sum())


def _estimates(found: Offsets, needed: Corrections) -> tuple[Estimate, ...]:
    rows = {row.name: row for row in found.offsets}
    return tuple(
        Estimate(row.name, row.unit, row.value, row.interval, row.told, truth / one.si)
        for one in CORRECTABLE
        if one.offset in TOLD
        for row, truth in [(rows[one.offset], getattr(needed, one.name))]
    )


def _rate(hits: int, total: int) -> tuple[float, float, float]:
    return (hits / total, *wilson(hits, total))
