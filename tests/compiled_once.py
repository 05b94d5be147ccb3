"""Compile what most tests need in one process of `pytest -n`, while the others wait for it.

On a fresh clone each process compiled plant and sensors for itself: 28 s of processor time, four
times over. The functions stay in `__pycache__`, where the next process finds them.
"""

import fcntl
from pathlib import Path

import numpy as np

from tailbeat.control.actions import size
from tailbeat.env.task import Settings
from tailbeat.env.world import World, seeds_from
from tailbeat.fish.store import load_fish
from tailbeat.pool.plant import at_rest, build_plant, step_plant
from tailbeat.pool.water import Water


def compile_once() -> None:
    """Step the pool's plant and a world of the environment, one process after the other."""
    with Path(__file__).open() as held:
        fcntl.flock(held, fcntl.LOCK_EX)  # until the file is closed
        fish = load_fish("pulley-fish-pool")
        for count in (1, 2):  # alone, and in parallel lanes
            plant = build_plant(fish, [Water()] * count)
            step_plant(plant, at_rest(plant), np.zeros((count, 2)))
        world = World(fish, Settings(), seeds_from(0, 2))
        world.reset()
        for _ in range(3):
            world.step(np.zeros((2, size(world.space))))
