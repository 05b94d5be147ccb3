"""Swims of a policy as its robot logs them, each in its own messy lab: what `refine` reads."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from tailbeat.control import actions as act
from tailbeat.control.actions import PERIOD
from tailbeat.control.corrections import Corrections, zero
from tailbeat.control.policy import Policy, decide
from tailbeat.env.task import Task, settings_for
from tailbeat.env.world import World, seeds_from
from tailbeat.evaluate.labs import world_in_labs
from tailbeat.evaluate.scenes import CLEAR
from tailbeat.fish.description import Fish
from tailbeat.identify.swim_columns import Logged
from tailbeat.pool.mess import Lab
from tailbeat.pool.water import Water

Array = NDArray[np.float64]
FAR = 1000.0  # m, beyond which a swim would end
PATIENCE = 20.0  # s for a target of the paper's fish, then the next one


@dataclass(frozen=True, eq=False)
class Swims:
    """Logged swims in the order of their labs, and the mean bias [rad/s] that each swim's gyro
    really had, with its own noise and drift."""

    logged: tuple[Logged, ...]
    yaw_rate_bias: Array


@dataclass(frozen=True)
class LogConfig:
    """Swims of `seconds`, drawn from `seed`: within `walls` (length, width) [m], or in open water
    to targets around the fish; with these `corrections` of one robot or of each (None: those of
    the policy)."""

    seconds: float
    seed: int
    walls: tuple[float, float] | None = None
    corrections: Corrections | None = None


def swims(
    policy: Policy, fish: Fish, labs: Sequence[tuple[Lab, Water]], config: LogConfig
) -> Swims:
    """One swim in each lab, from the pool's middle from target to target."""
    settings = settings_for(policy.contract)
    settings = replace(
        settings,
        task=Task(seconds=config.seconds + PERIOD, limit=FAR),
        corrections=config.corrections or settings.corrections,
    )
    world = world_in_labs(fish, settings, labs, seeds_from(config.seed, len(labs)), config.walls)
    table = _swum(world, policy, np.random.default_rng(config.seed), config.walls)
    half = np.array(world.seen.bias + world.seen.drift * config.seconds / 2 / PERIOD)
    return Swims(tuple(_logged(table[:, :, i]) for i in range(world.count)), half)


def _swum(
    world: World, policy: Policy, rng: np.random.Generator, walls: tuple[float, float] | None
) -> Array:
    """Rows (k, 9, n): what the loops of n robots read in every step, and what they then sent."""
    choose, rows, sent = partial(decide, policy), [], []
    wait = PATIENCE * policy.contract.measure.time
    seen, due = world.reset(), np.zeros(world.count)
    for step in range(world.steps_per_episode - 1):
        new = due <= step
        world.target[new] = _targets(world, int(new.sum()), new, rng, walls)
        done = world.step(np.asarray(choose(seen), dtype=np.float64))
        seen, now = done.observation, (step + 1) * PERIOD
        due = np.where(new, step + wait / PERIOD, np.where(done.reached, step, due))
        read = world.read
        frame = np.array(read.frames[:, 0])
        sent.append(act.setpoint(world.space, world.state) + zero(world.settings.corrections))
        row = [np.full(world.count, now), now - frame[:, 5], *frame[:, :3].T, read.yaw_rate]
        rows.append(np.array([*row, read.motor_angle, read.motor_velocity]))
    # a step's setpoint was sent before its readings, so it is in the row before them
    return np.concatenate([np.array(rows)[:-1], np.array(sent)[1:, None]], axis=1)


def _targets(
    world: World,
    count: int,
    which: NDArray[np.bool_],
    rng: np.random.Generator,
    walls: tuple[float, float] | None,
) -> Array:
    """New targets (count, 2) [m]: inside the walls, or around the fish."""
    if walls is None:
        reach = 1.5 * world.settings.measure.reach
        return np.asarray(world.pose[which, :2] + rng.uniform(-reach, reach, (count, 2)))
    half = np.array(walls) / 2 - CLEAR * world.settings.measure.reach
    return np.asarray(rng.uniform(-half, half, (count, 2)))


def _logged(table: Array) -> Logged:
    time, pose_time, x, y, yaw, *rest = np.array(table.T)
    return Logged(time, pose_time, np.column_stack([x, y, yaw]), *rest)
