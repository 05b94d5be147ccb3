"""What refining a policy from its logs gains, measured in messy labs of the virtual pool.

Each lab is one robot in one pool. Its policy swims to targets as it is, swims logged minutes, is
refined from these as `tailbeat refine` does, and swims to the same targets again. Beside it swims a
policy with the corrections that the lab really needs, which no user knows. Labs differ far more
than targets within a lab, so labs are the unit of every interval.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from tailbeat.control.corrections import Corrections, stacked
from tailbeat.control.policy import Policy, decide
from tailbeat.env.world import seeds_from
from tailbeat.evaluate.evaluation import EvaluationConfig, pool_of
from tailbeat.evaluate.logged_swims import LogConfig, swims
from tailbeat.evaluate.scenes import grid
from tailbeat.evaluate.trial import Pool, in_labs, swim
from tailbeat.files import BadInput
from tailbeat.identify.offsets import Offsets, offsets
from tailbeat.identify.swim_columns import Logged
from tailbeat.pool import mess
from tailbeat.pool.mess import Lab, Sizes
from tailbeat.pool.water import Water
from tailbeat.train.refine import CORRECTABLE, corrected

DRAWS = 2000
TOLD = ("tag askew", "tag sideways", "gyro bias")  # whose true values a lab has exactly
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class RefinementConfig:
    """Where to measure: the pool's `fish` and the policy's `twin` as in `EvaluationConfig`; a level
    of `mess`; `labs` of it, `targets` in each; `swims` logged swims of
    `seconds`, in the paper's pool or in open water (`walled`), before each of `rounds`; the
    number of the `first` lab."""

    fish: str = "pulley-fish"
    twin: str | None = None
    mess: str = "rough"
    labs: int = 40
    targets: int = 4
    swims: int = 3
    seconds: float = 60.0
    rounds: int = 1
    walled: bool = True
    seed: int = 0
    first: int = 0


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
    `true` corrections; the offsets of the last round, none where the fish was seen too little."""

    before: int
    after: tuple[int, ...]
    true: int
    estimates: tuple[Estimate, ...]


Share = tuple[float, float, float]  # a fraction, and its 95 % interval over labs


@dataclass(frozen=True)
class Refinement:
    """All labs, `targets` targets each; the fractions of targets that were reached, and how much
    refining (`gain`) and the true corrections (`most`) add."""

    config: RefinementConfig
    labs: tuple[LabResult, ...]
    before: Share
    after: Share
    true: Share
    gain: Share
    most: Share


@dataclass(frozen=True, eq=False)
class Setting:
    """A policy, its pool, and in each lab its robot and its water."""

    policy: Policy
    pool: Pool
    config: RefinementConfig
    labs: tuple[tuple[Lab, Water], ...]


def refinement(policy: Policy, config: RefinementConfig, progress: Progress) -> Refinement:
    """Measure in all labs together. Raises BadInput for a policy that does not fit the pool's
    fish."""
    sizes = mess.level(config.mess)
    _check(config, sizes)
    count = config.labs * config.targets
    pool = pool_of(policy, EvaluationConfig(config.fish, config.twin, episodes=count))
    numbers = range(config.first, config.first + config.labs)
    labs = tuple(_lab(pool, config, sizes, number) for number in numbers)
    setting = Setting(policy, pool, config, labs)
    steps = 2 * config.rounds + 2
    known = [policy.contract.corrections or Corrections()] * config.labs
    before, after, found, bias = _reached(setting, known), [], list[Offsets | None](), np.zeros(0)
    progress("swims", 1, steps)
    for turn in range(config.rounds):
        found, bias = _offsets(setting, known, turn)
        progress("swims", 2 * turn + 2, steps)
        known = [_refined(policy, *one) for one in zip(found, known, strict=True)]
        after.append(_reached(setting, known))
        progress("swims", 2 * turn + 3, steps)
    needed = [true_corrections(lab, b) for (lab, _), b in zip(setting.labs, bias, strict=True)]
    true = _reached(setting, needed)
    progress("swims", steps, steps)
    rows = zip(before, zip(*after, strict=True), true, map(_estimates, found, needed), strict=True)
    return _summary(config, tuple(LabResult(*row) for row in rows))


def _check(config: RefinementConfig, sizes: Sizes) -> None:
    if not any(sizes.values()):
        raise BadInput(f"--mess {config.mess}: nothing is wrong there; give everyday or more.")
    least = {"labs": 2, "targets": 1, "swims": 1, "rounds": 1}
    for name, low in least.items():
        if getattr(config, name) < low:
            raise BadInput(f"--{name} {getattr(config, name)}: give {low} or more.")


def _lab(pool: Pool, config: RefinementConfig, sizes: Sizes, number: int) -> tuple[Lab, Water]:
    """One robot in one pool; `evaluate` swims in other labs."""
    lab = mess.draw(sizes, [config.seed, number, 1])
    return lab, pool.waters[number % len(pool.waters)]


def _refined(policy: Policy, found: Offsets | None, known: Corrections) -> Corrections:
    """New corrections; the old ones where nothing was found, or an offset is beyond what a lab gets
    wrong."""
    try:
        held = replace(policy.contract, corrections=known)
        return known if found is None else corrected(held, found)[0]
    except BadInput:
        return known


def _offsets(
    setting: Setting, known: Sequence[Corrections], turn: int
) -> tuple[list[Offsets | None], NDArray[np.float64]]:
    """What logged swims tell in each lab, and the mean bias of the gyros in them."""
    config, pool, each = setting.config, setting.pool, setting.config.swims
    seed = int(np.random.SeedSequence([config.seed, turn]).generate_state(1)[0])
    labs = [lab for lab in setting.labs for _ in range(each)]
    corrections = stacked([one for one in known for _ in range(each)])
    walls = pool.walls if config.walled else None
    told = LogConfig(config.seconds, seed, walls, corrections)
    done = swims(setting.policy, pool.fish, labs, told)
    own = [done.logged[i : i + each] for i in range(0, len(labs), each)]
    return [_told(one) for one in own], done.yaw_rate_bias.reshape(-1, each).mean(axis=1)


def _told(logged: Sequence[Logged]) -> Offsets | None:
    """What the swims of a lab tell; None where its camera saw the fish for too short a time."""
    try:
        return offsets(logged)
    except BadInput:
        return None


def true_corrections(lab: Lab, yaw_rate_bias: float) -> Corrections:
    """What a lab needs, but for the bend of its tail, whose best zero nobody knows exactly."""
    wrong = lab.errors
    return Corrections(
        askew=wrong.askew,
        left=wrong.left,
        shaft=wrong.encoder - wrong.horn,
        setpoint=-wrong.horn,
        yaw_rate=float(yaw_rate_bias),
    )


def _reached(setting: Setting, known: Sequence[Corrections]) -> list[int]:
    """Targets that the policy reaches in each lab with its corrections."""
    pool, config, reach = setting.pool, setting.config, setting.pool.measure.reach
    scene = grid(pool.fish, pool.count, config.seed, 0.5 * reach, 2.5 * reach, np.pi)
    each = [lab for lab in setting.labs for _ in range(config.targets)]
    condition = pool.condition("labs", scene, water=tuple(water for _, water in each))
    condition = in_labs(condition, [lab for lab, _ in each])
    corrections = stacked([one for one in known for _ in range(config.targets)])
    condition = replace(condition, corrections=corrections)
    runs = swim(partial(decide, setting.policy), condition, seeds_from(config.seed, pool.count))
    return [int(hits.sum()) for hits in runs.reached.reshape(config.labs, -1)]


def _estimates(found: Offsets | None, needed: Corrections) -> tuple[Estimate, ...]:
    if found is None:
        return ()
    rows = {row.name: row for row in found.offsets}
    return tuple(
        Estimate(row.name, row.unit, row.value, row.interval, row.told, truth / one.si)
        for one in CORRECTABLE
        if one.offset in TOLD
        for row, truth in [(rows[one.offset], getattr(needed, one.name))]
    )


def _summary(config: RefinementConfig, labs: tuple[LabResult, ...]) -> Refinement:
    counts = np.array([(one.before, one.after[-1], one.true) for one in labs]) / config.targets
    before, after, true = counts.T
    shares = (before, after, true, after - before, true - before)
    return Refinement(config, labs, *map(over_labs, shares))


def over_labs(values: NDArray[np.float64]) -> Share:
    """Mean over labs, with a 95 % interval by a bootstrap over them."""
    drawn = np.random.default_rng(0).integers(len(values), size=(DRAWS, len(values)))
    low, high = np.quantile(values[drawn].mean(axis=1), [0.025, 0.975]).tolist()
    return float(values.mean()), low, high
