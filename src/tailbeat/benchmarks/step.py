"""Speed of tailbeat's step, compared with the bare engine's loop in one run."""

import os
import platform
import time
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco import rollout

from tailbeat.fish.rollout import Start, swim
from tailbeat.fish.store import load_fish, shipped
from tailbeat.fish.twin import Twin, compile_twin
from tailbeat.pool.plant import at_rest, build_plant, step_plant
from tailbeat.pool.water import Water

SECONDS = 20.0  # simulated per timing
REPEATS = 3
CONTROL_PERIOD = 0.02


@dataclass(frozen=True)
class StepRow:
    """Stepping a shipped fish by `step_ms` [ms]: our time and the bare engine's [us per step]; how
    much faster than real time one fish runs on one core, and 32 per core on all cores."""

    fish: str
    step_ms: float
    us_per_step: float
    bare_us_per_step: float
    ratio_to_bare: float
    real_time_factor_one_core: float
    real_time_factor_all_cores: float


@dataclass(frozen=True)
class PoolRow:
    """`fish` fish in the virtual pool: step [ms], and how much faster than real time they run in
    total and per core."""

    fish: int
    step_ms: float
    real_time_factor: float
    per_core: float


def machine() -> str:
    """This machine, its cores and the engine's version."""
    return f"{platform.machine()}, {os.cpu_count()} cores, mujoco {mujoco.__version__}"


def step_bench() -> tuple[StepRow, ...]:
    """Compare every shipped fish with `mujoco.rollout`."""
    return tuple(_one(name) for name in shipped())


def pool_bench() -> tuple[PoolRow, ...]:
    """Time the virtual pool's plant with one fish and with 64."""
    return _pool(1), _pool(64)


def _pool(count: int) -> PoolRow:
    """Time the virtual pool's plant at 2 ms: how much faster than real time, per core and in
    total."""
    plant = build_plant(load_fish("pulley-fish"), [Water()] * count)
    clock = np.arange(0, SECONDS, plant.dt)
    commands = np.repeat(0.6 * np.sin(2 * np.pi * 1.5 * clock)[None], count, axis=0)
    step_plant(plant, at_rest(plant), commands[:, :10])  # compiles, if not yet done
    times = []
    for _ in range(REPEATS):
        began = time.perf_counter()
        step_plant(plant, at_rest(plant), commands, 10)
        times.append(time.perf_counter() - began)
    factor = count * SECONDS / min(times)
    cores = min(os.cpu_count() or 1, count)
    return PoolRow(count, 1e3 * plant.dt, factor, factor / cores)


def _one(name: str) -> StepRow:
    twin = compile_twin(load_fish(name))
    commands = _commands(twin)
    ours = min(_ours(twin, commands) for _ in range(REPEATS))
    bare = min(_bare(twin, commands) for _ in range(REPEATS))
    cores = os.cpu_count() or 1
    many = min(_many(twin, commands, 32 * cores) for _ in range(REPEATS)) / (32 * cores)
    steps = commands.size
    return StepRow(
        fish=name,
        step_ms=1e3 * twin.model.opt.timestep,
        us_per_step=1e6 * ours / steps,
        bare_us_per_step=1e6 * bare / steps,
        ratio_to_bare=ours / bare,
        real_time_factor_one_core=SECONDS / ours,
        real_time_factor_all_cores=SECONDS / many,
    )


def _commands(twin: Twin) -> np.ndarray:
    """A beat at 1.5 Hz: a swinging pulley or a turning crank."""
    clock = np.arange(0, SECONDS, twin.model.opt.timestep)
    if twin.fish.motor.kind == "crank":
        return 2 * np.pi * 1.5 * clock
    return 0.6 * np.sin(2 * np.pi * 1.5 * clock)


def _ours(twin: Twin, commands: np.ndarray) -> float:
    """Wall time [s] of our step: one fish, one thread, one sample per control period."""
    every = max(round(CONTROL_PERIOD / twin.model.opt.timestep), 1)
    began = time.perf_counter()
    swim([twin], [Start.at_rest()], [commands], every, threads=1)
    return time.perf_counter() - began


def _many(twin: Twin, commands: np.ndarray, count: int) -> float:
    """Wall time [s] of `count` fish on all cores."""
    every = max(round(CONTROL_PERIOD / twin.model.opt.timestep), 1)
    began = time.perf_counter()
    swim([twin] * count, [Start.at_rest()] * count, [commands] * count, every)
    return time.perf_counter() - began


def _bare(twin: Twin, commands: np.ndarray) -> float:
    """Wall time [s] of the engine's own C loop over the same commands, in one call."""
    data = mujoco.MjData(twin.model)
    start = np.zeros(mujoco.mj_stateSize(twin.model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
    mujoco.mj_getState(twin.model, data, start, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    began = time.perf_counter()
    rollout.rollout(twin.model, data, start[None], commands[None, :, None])
    return time.perf_counter() - began
