"""Worlds of fish that each swim in a messy lab of their own."""

from collections.abc import Sequence

from tailbeat.env.task import Settings
from tailbeat.env.world import World
from tailbeat.fish.description import Fish
from tailbeat.pool.mess import Lab, in_lab
from tailbeat.pool.plant import Surroundings
from tailbeat.pool.simulator import PoolSimulator
from tailbeat.pool.water import Water


def world_in_labs(
    fish: Fish,
    settings: Settings,
    labs: Sequence[tuple[Lab, Water]],
    seeds: list[int],
    walls: tuple[float, float] | None = None,
) -> World:
    """One fish in each lab with its water, within `walls` (length, width) [m] or in open water."""
    around = Surroundings(walls=walls)
    waters, places = zip(*(in_lab(lab, water, around) for lab, water in labs), strict=True)
    simulator = PoolSimulator(fish, waters, places, wear=[lab.wear for lab, _ in labs])
    wrong = [lab.errors for lab, _ in labs]
    return World(fish, settings, seeds, simulator=simulator, wrong=wrong)
