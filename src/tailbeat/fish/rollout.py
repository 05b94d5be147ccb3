"""The one step: any number of twins, each on its own commands, in batched engine calls."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco import batch
from numpy.typing import NDArray

from tailbeat.fish.twin import HEAVY, HEAVY_ROTOR, Twin

Array = NDArray[np.float64]
CONTROL = int(mujoco.mjtState.mjSTATE_CTRL)


@dataclass(frozen=True, eq=False)
class Start:
    """Where a swim begins: pose (x [m], y [m], yaw [rad]), its rates, motor angle and rate."""

    pose: Array
    velocity: Array
    motor: float = 0.0
    motor_speed: float = 0.0

    @staticmethod
    def at_rest() -> "Start":
        """Still water, straight tail, at the origin."""
        return Start(np.zeros(3), np.zeros(3))


@dataclass(frozen=True, eq=False)
class Swim:
    """What one twin did: `time` (k,) s, `qpos` (k, nq), `markers` (k, m, 3) m in the world.

    `diverged` marks a twin that the engine warned about or reset; its samples mean nothing.
    """

    time: Array
    qpos: Array
    markers: Array
    diverged: bool


def swim(
    twins: Sequence[Twin],
    starts: Sequence[Start],
    commands: Sequence[Array],
    every: int,
    threads: int = 0,
) -> list[Swim]:
    """Step n twins of one layout, each through its own commands (steps,) [rad].

    Sample j is the state after j * every steps, the start included. A twin stops when its
    commands end. `threads` 0 means every core; one twin or a thousand run the same code and give
    the same bits at any number of threads.
    """
    pool = batch.Batch(twins[0].model, len(twins), nthread=threads)
    pool.set_models([twin.model for twin in twins])
    _place(pool, twins, starts)
    lengths = np.array([len(command) // every for command in commands])
    padded = np.zeros((len(twins), int(lengths.max()) * every, 1))
    for i, command in enumerate(commands):
        padded[i, : lengths[i] * every, 0] = command[: lengths[i] * every]
    return _advance(pool, twins, padded, lengths, every)


def _place(pool: batch.Batch, twins: Sequence[Twin], starts: Sequence[Start]) -> None:
    qpos, qvel = pool.bind("qpos"), pool.bind("qvel")
    motor = twins[0].motor
    for i, start in enumerate(starts):
        qpos[i, :3], qvel[i, :3] = start.pose, start.velocity
        qpos[i, motor], qvel[i, motor] = start.motor, start.motor_speed


def _advance(
    pool: batch.Batch, twins: Sequence[Twin], commands: Array, lengths: NDArray, every: int
) -> list[Swim]:
    sites = twins[0].marker_sites
    qpos = np.empty((len(twins), lengths.max() + 1, twins[0].model.nq))
    markers = np.empty((len(twins), lengths.max() + 1, sites.size, 3))
    for j in range(lengths.max() + 1):
        active = lengths >= j
        if j > 0:
            control = np.ascontiguousarray(commands[active, (j - 1) * every : j * every])
            pool.rollout(every, control, CONTROL, record=(), ids=active)
        pool.forward(active)  # sites at this state, not at the one before the last substep
        qpos[:, j], markers[:, j] = pool.bind("qpos"), pool.bind("site_xpos")[:, sites]
    diverged = pool.warning.reshape(len(twins), -1).sum(axis=1) > 0
    time = np.arange(lengths.max() + 1) * every * twins[0].model.opt.timestep
    return [
        Swim(time[: n + 1], qpos[i, : n + 1], markers[i, : n + 1], bool(diverged[i]))
        for i, n in enumerate(lengths)
    ]


def replay_command(twin: Twin, angle: Array) -> Array:
    """Commands (..., steps) that lead a replayed twin's motor through `angle` (..., steps + 1).

    `angle` [rad] is sampled at every step, the start included; begin with `motor_speed` equal to
    its first difference over the step. Inverts the step that the engine makes of the heavy rotor,
    v' = v + h (kp (u - q) - kv v) / (A + h kv), q' = q + h v'; what is left is the tail's pull on
    the rotor, torque / kp, about 10 microradians.
    """
    h = twin.model.opt.timestep
    implicit = twin.fish.simulation.integrator.startswith("implicit")
    inertia = HEAVY_ROTOR + (h * HEAVY.kv if implicit else 0.0)
    rate = np.diff(angle, axis=-1) / h
    before = np.concatenate([rate[..., :1], rate[..., :-1]], axis=-1)
    torque = (rate - before) * inertia / h + HEAVY.kv * before
    return angle[..., :-1] + torque / HEAVY.kp
