"""Speed of fish in messy labs with all their sensors, beside clean ones, in one run."""

import time
from dataclasses import dataclass

import numpy as np

from tailbeat.control.actions import PERIOD
from tailbeat.env.task import Settings, Task
from tailbeat.env.world import World, seeds_from
from tailbeat.evaluate.labs import world_in_labs
from tailbeat.fish.store import load_fish
from tailbeat.pool.mess import LEVELS, lab_at
from tailbeat.pool.water import Water

FISH, STEPS, REPEATS = 32, 250, 3
BEAT = (0.0, 0.2, 0.6, 0.0, 0.0, 0.0)  # an action: 2 Hz, a little to the left


@dataclass(frozen=True)
class MessyRow:
    """Fish in labs of a level, with plant, sensors, observation and action: how much faster than
    real time, per core of processor time, and that over the clean level's."""

    labs: str
    fish: int
    per_core: float
    over_clean: float


def messy_bench() -> tuple[MessyRow, ...]:
    """Time every level; the levels take turns and the best of each counts."""
    worlds = {level: _world(level) for level in LEVELS}
    turns = [{level: _rate(world) for level, world in worlds.items()} for _ in range(REPEATS)]
    best = {level: max(turn[level] for turn in turns) for level in LEVELS}
    return tuple(MessyRow(k, FISH, one, one / best["clean"]) for k, one in best.items())


def _world(level: str) -> World:
    """Fish of a level, each in its own lab."""
    labs = [(lab_at(level, 0, number), Water()) for number in range(FISH)]
    settings = Settings(task=Task(limit=100.0))
    return world_in_labs(load_fish("pulley-fish"), settings, labs, seeds_from(0, FISH))


def _rate(world: World) -> float:
    """Simulated time over processor time of five seconds of swimming."""
    action = np.tile(BEAT, (FISH, 1))
    world.reset()
    world.step(action)  # compiles, if not yet done
    began = time.process_time()
    for _ in range(STEPS):
        world.step(action)
    return FISH * STEPS * PERIOD / (time.process_time() - began)
