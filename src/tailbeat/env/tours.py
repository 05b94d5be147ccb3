"""Fish that swim from target to target, and what their robots' own sensors say of it."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tailbeat.control import actions as act
from tailbeat.control.actions import PERIOD
from tailbeat.control.observation import table
from tailbeat.control.policy import Contract
from tailbeat.env import randomize
from tailbeat.env.assess import Decide
from tailbeat.env.curriculum import MOVING, trained_speed
from tailbeat.env.randomize import Randomisation
from tailbeat.env.task import Settings, settings_for, sized
from tailbeat.env.world import World
from tailbeat.link.places import POOL
from tailbeat.robot.plausible import Bounds, Gate, gated

Array = NDArray[np.float64]
FAR = 1e3  # m: a tour is never out of range
MARGIN, APART = 0.85, 0.5  # of the pool's half sides that targets take; m from one to the next


@dataclass(frozen=True, eq=False)
class Tours:
    """Sensor rows of n fish over k control periods: setpoints `sent` (n, k) [rad], motor `angle`
    [rad], believed yaw `rate` [rad/s], the newest camera `frames` (n, k, 6) as in
    `observation.Samples`, and how many targets were `reached`."""

    sent: Array
    angle: Array
    rate: Array
    frames: Array
    reached: int


def settings(contract: Contract, seconds: float) -> Settings:
    """The settings of a policy's tours, with moving targets if it follows: all noise, all
    randomisation, no end but the time [s]; without the corrections of one robot."""
    own, follows = settings_for(contract), trained_speed(contract) > 0
    task = sized(MOVING, contract.measure) if follows else own.task
    physics = randomize.sized(Randomisation(), contract.measure)
    task = replace(task, seconds=seconds, limit=FAR)
    return replace(own, task=task, physics=physics, corrections=None)


def tours(
    decide: Decide, world: World, seed: int, progress: Callable[[float], None] = lambda done: None
) -> Tours:
    """Swim a world's fish to targets drawn inside the paper's pool, in the fish's measure; the next
    appears at an arrival. Targets follow `seed`. Moving targets go on as the world drew them."""
    rng, steps = np.random.default_rng(seed), world.steps_per_episode - 1
    sent, angle, rates = (np.empty((world.count, steps)) for _ in range(3))
    frames = np.empty((world.count, steps, 6))
    scales = [entry.scale for entry in table(world.settings.measure)]
    seen, reached, gates = world.reset(), 0, [Gate()] * world.count
    rate = np.zeros(world.count)
    for step in range(steps):
        done = world.step(np.asarray(decide(seen), dtype=np.float64))
        seen = done.observation
        for fish, fresh in enumerate((seen[:, 3] * scales[3]).tolist()):
            gates[fish], believed = gated(gates[fish], fresh, Bounds())
            rate[fish] = fresh if believed else rate[fish]
        sent[:, step] = act.setpoint(world.space, world.state)
        angle[:, step] = np.arctan2(seen[:, 1], seen[:, 0])
        rates[:, step], frames[:, step] = rate, done.frames[:, 0]
        reached += 0 if world.task.follow else _next_targets(world, rng)
        progress((step + 1) / steps)
    return Tours(sent, angle, rates, frames, reached)


def _next_targets(world: World, rng: np.random.Generator) -> int:
    """Draw new targets for fish that have arrived; returns how many had."""
    measure, place = world.settings.measure, world.pose[:, :2]
    arrived = np.flatnonzero(np.hypot(*(world.target - place).T) < world.task.arrival)
    half = MARGIN * measure.reach * np.array(POOL) / 2
    for fish in arrived:
        while np.hypot(*(world.target[fish] - place[fish])) < APART * measure.reach:
            world.target[fish] = rng.uniform(-half, half)
    return len(arrived)


def times(swum: Tours) -> Array:
    """Times (k,) [s] of the rows."""
    return PERIOD * np.arange(1, swum.sent.shape[1] + 1)
