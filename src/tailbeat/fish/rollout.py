"""Step any number of twins, each with its own commands, in batched engine calls."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import mujoco
import numpy as np
from mujoco import batch
from numpy.typing import NDArray

from tailbeat.fish.twin import HEAVY, HEAVY_ROTOR, Twin
from tailbeat.fish.water import Water, correct, water
from tailbeat.processes import threads as default_threads

Array = NDArray[np.float64]
CONTROL = int(mujoco.mjtState.mjSTATE_CTRL)
HEAD = 1  # the first body after the world
CHUNK = 256  # samples per engine call: bounds the memory of a thousand fish


@dataclass(frozen=True, eq=False)
class Start:
    """Where a swim begins: pose (x [m], y [m], yaw [rad]) of the fish frame, its rates (3,) in
    world axes [m/s, rad/s], motor angle [rad] and rate [rad/s]."""

    pose: Array
    velocity: Array
    motor: float = 0.0
    motor_speed: float = 0.0

    @staticmethod
    def at_rest() -> "Start":
        """Straight tail, at rest at the origin."""
        return Start(np.zeros(3), np.zeros(3))


@dataclass(frozen=True, eq=False)
class Swim:
    """What one twin did: `time` (k,) [s] and `qpos` (k, nq).

    `diverged` is true for a twin that the engine warned about; its samples are all zero.
    """

    twin: Twin
    time: Array
    qpos: Array
    diverged: bool

    @cached_property
    def markers(self) -> Array:
        """The description's markers in the world (k, m, 3) [m], computed at first use."""
        pool = batch.Batch(self.twin.model, self.time.size)
        pool.bind("qpos")[:] = self.qpos
        sites = pool.bind("site_xpos")
        pool.forward()
        return sites[:, self.twin.marker_sites].copy()


def swim(
    twins: Sequence[Twin],
    starts: Sequence[Start],
    commands: Sequence[Array],
    every: int,
    threads: int = 0,
) -> list[Swim]:
    """Step n twins of one layout, each through its own commands (steps,) [rad].

    Sample j is the state after j * every steps, the start included. A twin stops when its
    commands end. `threads` 0 means `processes.threads`. Results are bit-identical alone or in a
    batch, at any number of threads. That the twins have one layout is not checked.
    """
    pool = _batch_of(twins, threads)
    _place(pool, twins, starts)
    lengths = np.array([len(command) // every for command in commands])
    padded = np.zeros((len(twins), int(lengths.max()) * every, 1))
    for i, command in enumerate(commands):
        padded[i, : lengths[i] * every, 0] = command[: lengths[i] * every]
    with quiet_engine():
        qpos = _advance(pool, _water_of(pool, twins), padded, lengths, every)
    diverged = pool.warning.reshape(len(twins), -1).sum(axis=1) > 0
    qpos[diverged] = 0.0
    time = np.arange(lengths.max() + 1) * every * twins[0].model.opt.timestep
    return [
        Swim(twin, time[: n + 1], rows[: n + 1], bool(lost))
        for twin, n, rows, lost in zip(twins, lengths, qpos, diverged, strict=True)
    ]


@contextmanager
def quiet_engine() -> Iterator[None]:
    """Keep the engine from printing and logging a divergence: `diverged` reports it, and in a
    search it is normal."""
    mujoco.set_mju_user_warning(lambda message: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(None)


def _place(pool: batch.Batch, twins: Sequence[Twin], starts: Sequence[Start]) -> None:
    qpos, qvel = pool.bind("qpos"), pool.bind("qvel")
    motor = twins[0].motor
    for i, start in enumerate(starts):
        qpos[i, :3], qvel[i, :3] = start.pose, start.velocity
        qpos[i, motor], qvel[i, motor] = start.motor, start.motor_speed


def _batch_of(twins: Sequence[Twin], threads: int) -> batch.Batch:
    """A batch in which every fish has its own values of each field that differs among them."""
    models = list({id(twin): twin.model for twin in twins}.values())
    pool = batch.Batch(models[0], len(twins), nthread=threads or default_threads())
    for name in batch.MODEL_FIELDS:
        values = [_field(model, name) for model in models]
        if any(not np.array_equal(values[0], other) for other in values[1:]):
            pool.expand(name)[:] = np.stack([_field(twin.model, name) for twin in twins])
    return pool


def _field(model: mujoco.MjModel, name: str) -> Array:
    owner = model.opt if name.startswith("opt.") else model
    return np.asarray(getattr(owner, name.removeprefix("opt.")))


def _water_of(pool: batch.Batch, twins: Sequence[Twin]) -> Water | None:
    """The corrections of the engine's fluid law for these fish, None without any."""
    models = [twin.model for twin in twins]
    return water(models, pool, np.stack([model.opt.wind for model in models]))


def _advance(
    pool: batch.Batch,
    moved: Water | None,
    commands: Array,
    lengths: NDArray[np.int_],
    every: int,
) -> Array:
    """Samples (n, longest + 1, nq), in long calls: until the next twin stops, the next correction
    of the water's force, or `CHUNK` samples."""
    if moved is not None and moved.block == 1:
        return _step_by_step(pool, moved, commands, lengths, every)
    state, force = pool.bind("qpos"), pool.bind("xfrc_applied")
    found = _begun(state, lengths)
    block = CHUNK * every if moved is None else moved.block
    ends = lengths * every
    stops = sorted({*ends.tolist(), *range(0, int(ends.max()), block)})
    for first, last in pairwise(stops):
        if moved is not None and first % block == 0 and (push := correct(moved, first)) is not None:
            force[:, HEAD, :3] = push
        active = ends >= last
        control = np.ascontiguousarray(commands[active, first:last])
        rows = pool.rollout(last - first, control, CONTROL, record=("qpos",), ids=active)["qpos"]
        samples = np.arange(first // every + 1, last // every + 1)
        found[np.ix_(active, samples)] = rows[:, samples * every - first - 1]
    return found


def _step_by_step(
    pool: batch.Batch, moved: Water, commands: Array, lengths: NDArray[np.int_], every: int
) -> Array:
    """The samples of `_advance`, where the water's force changes at every step: an engine call that
    records nothing takes a third less time. A twin that diverged is stepped no further."""
    state, force, control = (pool.bind(name) for name in ("qpos", "xfrc_applied", "ctrl"))
    found = _begun(state, lengths)
    ends, played = lengths * every, np.ascontiguousarray(commands[:, :, 0].T)
    for first, last in pairwise(sorted({0, *ends.tolist()})):
        active = np.flatnonzero(ends >= last).astype(np.int32)
        for step in range(first, last):
            if (push := correct(moved, step)) is not None:
                force[:, HEAD, :3] = push
            control[:, 0] = played[step]
            pool.step(None if len(active) == len(ends) else active)
            if (step + 1) % every == 0:
                found[active, (step + 1) // every] = state[active]
                active = _sound(pool, active)
            if not active.size:
                break
    return found


def _sound(pool: batch.Batch, active: NDArray[np.int32]) -> NDArray[np.int32]:
    """Those of the active twins that have not diverged; of the others no sample is kept."""
    if not pool.warning.any():
        return active
    warned = pool.warning.reshape(pool.nsim, -1).any(axis=1)
    return active[~warned[active]]


def _begun(state: Array, lengths: NDArray[np.int_]) -> Array:
    """Room for samples (n, longest + 1, nq), of which the first is written."""
    found = np.empty((len(lengths), lengths.max() + 1, state.shape[1]))
    found[:, 0] = state
    return found


def replay_command(twin: Twin, angle: Array) -> Array:
    """Commands (..., steps) [rad] that move a replayed twin's motor through `angle` (..., steps +
    1).

    `angle` [rad] is sampled at every step, the start included. Begin with `motor_speed` equal to
    its first difference over the step. This inverts the engine's step of the heavy rotor,
    v' = v + h (kp (u - q) - kv v) / (A + h kv), q' = q + h v'. The remaining error is due to the
    tail's pull on the rotor: torque / kp, about 10 microradians.
    """
    h = twin.model.opt.timestep
    implicit = twin.fish.simulation.integrator.startswith("implicit")
    inertia = HEAVY_ROTOR + (h * HEAVY.kv if implicit else 0.0)
    rate = np.diff(angle, axis=-1) / h
    before = np.concatenate([rate[..., :1], rate[..., :-1]], axis=-1)
    torque = (rate - before) * inertia / h + HEAVY.kv * before
    return angle[..., :-1] + torque / HEAVY.kp
