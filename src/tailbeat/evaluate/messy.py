"""Targets in messy pools: each swim in its own lab, at three levels beside the clean pool."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from tailbeat.evaluate.rates import ConditionResult, against
from tailbeat.evaluate.runs import Runs
from tailbeat.evaluate.scenes import grid
from tailbeat.evaluate.trial import Condition, Pool, in_labs
from tailbeat.pool.mess import LEVELS, draw, level

PREFIX = "messy: "
CLEAN = f"{PREFIX}clean"
LABS = tuple(name for name, size in LEVELS.items() if size)  # everyday, rough, wrecked


def conditions(pool: Pool) -> list[Condition]:
    """Every level, and the lab of the pool if that is a file's, at the same targets, within +-180
    deg and 0.5-2.5 m, in the same waters; swim i has the same sides and directions at every
    level."""
    near, far = 0.5 * pool.measure.reach, 2.5 * pool.measure.reach
    scene = grid(pool.fish, pool.count, pool.seed + 3, near, far, np.pi)
    names = [*LEVELS, *({pool.lab} - LEVELS.keys())]
    return [
        at_level(pool.condition(f"{PREFIX}{Path(name).stem}", scene), name, pool.seed)
        for name in names
    ]


def at_level(condition: Condition, name: str, seed: int) -> Condition:
    """A condition of the pool, each swim in its own lab of a level, drawn from the seed."""
    sizes = level(name)  # read once: it may be a file
    return in_labs(condition, [draw(sizes, [seed, i]) for i in range(condition.count)])


def numbers(by_condition: Mapping[str, Runs]) -> tuple[ConditionResult, ...]:
    """Success rates by level, and what each level costs on the same targets."""
    return against(by_condition[CLEAN], by_condition)
