"""The plant behind the world's seam: the same motion as the plant alone, batch equals single."""

import numpy as np
import pytest

pytest.importorskip("gymnasium", reason="the train extra is not installed")

from tailbeat.control import actions as act
from tailbeat.control.actions import PERIOD
from tailbeat.env import randomize
from tailbeat.env.sensors import quiet
from tailbeat.env.simulator import TwinSimulator
from tailbeat.env.task import Settings
from tailbeat.env.world import World
from tailbeat.fish.store import load_fish
from tailbeat.pool.plant import at_rest, build_plant, step_plant
from tailbeat.pool.simulator import PoolSimulator
from tailbeat.pool.water import Water, ensemble

FISH, TWIN = load_fish("pulley-fish"), load_fish("pulley-fish-pool")
STILL = Settings(sensors=quiet(), physics=randomize.none())


def swum(waters: list[Water], seeds: list[int], actions: np.ndarray) -> np.ndarray:
    """Poses and joints (steps, n, nv) in a pool."""
    world = World(FISH, STILL, seeds, simulator=PoolSimulator(FISH, waters))
    world.reset()
    found = []
    for action in actions:
        world.step(action)
        found.append(world.simulator.qpos.copy())
    return np.array(found)


def test_the_world_in_the_pool_is_the_plant():
    actions = np.random.default_rng(0).uniform(-1, 1, (50, 1, 6))
    inside = swum([Water()], [1], actions)
    plant = build_plant(FISH, [Water()])
    low, high = FISH.motor.range or (-1.0, 1.0)
    space = act.Generator(low, high)
    state, sent = act.reset(space, 1), []
    for action in actions:
        state = act.step(space, state, action, PERIOD)
        sent.append(act.setpoint(space, state)[0])
    commands = np.repeat(sent, round(PERIOD / plant.dt))[None]
    alone = step_plant(plant, at_rest(plant), commands, round(PERIOD / plant.dt))
    assert np.array_equal(inside[:, 0], alone.q[0, 1:])


def test_a_fish_in_a_batch_of_pools_swims_as_it_would_alone():
    waters, seeds = ensemble(3, seed=4), [1, 2, 3]
    actions = np.random.default_rng(1).uniform(-1, 1, (40, 3, 6))
    together = swum(waters, seeds, actions)
    for i in range(3):
        alone = swum(waters[i : i + 1], seeds[i : i + 1], actions[:, i : i + 1])
        assert np.array_equal(alone[:, 0], together[:, i])
    assert np.ptp(together[-1, :, 0]) > 1e-4  # the waters differ


def test_a_new_episode_begins_at_rest_and_forgets():
    world = World(FISH, STILL, [5], simulator=PoolSimulator(FISH, [Water()]))
    actions = np.random.default_rng(2).uniform(-1, 1, (30, 1, 6))
    paths = []
    for _ in range(2):
        world.reseed([5])
        world.reset()
        paths.append(np.array([world.step(a).observation[0] for a in actions]))
    assert np.array_equal(paths[0], paths[1])
    assert world.simulator.energy[0] > 0


@pytest.mark.parametrize(
    "build", [lambda: PoolSimulator(FISH, ensemble(4, seed=4)), lambda: TwinSimulator(TWIN, 4)]
)
def test_fish_that_are_let_be_stay_and_the_others_swim_on_as_before(build):
    commands = np.random.default_rng(3).uniform(-0.8, 0.8, (40, 4))
    whole, some = build(), build()
    for step, command in enumerate(commands):
        if step == 20:
            some.keep(np.array([True, False, False, True]))
            stayed = some.qpos.copy()
        for body in (whole, some):
            body.advance(command, np.zeros((4, 2)))
    assert np.array_equal(some.qpos[[0, 3]], whole.qpos[[0, 3]])
    if isinstance(some, PoolSimulator):
        assert np.array_equal(some.energy[[0, 3]], whole.energy[[0, 3]])
    assert np.array_equal(some.qpos[[1, 2]], stayed[[1, 2]])
    assert np.abs(whole.qpos[[1, 2]] - stayed[[1, 2]]).max() > 0.1
