"""Speed of the environment, compared with the bare engine and SB3's environments in one run.

Needs the train extra. The peers do the same task without noise, latency and randomisation; ours has
all of them.
"""

import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.envs.mujoco import MujocoEnv
from mujoco import batch
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv

from tailbeat.control import actions as act
from tailbeat.control.actions import PERIOD
from tailbeat.control.observation import Samples, observe
from tailbeat.env.task import Settings, check_settings
from tailbeat.env.vector_env import FishVectorEnv, action_space, observation_space
from tailbeat.fish.description import Fish
from tailbeat.fish.store import load_fish
from tailbeat.fish.twin import build_spec, compile_twin

COUNTS = (1, 16, 64, 256)
PEER_COUNT = 64
CONTROL_STEPS = 8_000  # per turn, of all fish
TURNS = 11


class OrdinaryFish(MujocoEnv):
    """One fish in gymnasium's MujocoEnv: the same actions, observation and reward, but exact
    sensors, no latency, no randomisation, no pulses."""

    metadata = {"render_modes": ["human", "rgb_array", "depth_array", "rgbd_tuple"]}  # noqa: RUF012

    def __init__(self, path: str, substeps: int, limits: tuple[float, float]) -> None:
        self.generator = act.Generator(*limits)
        self.tail = act.reset(self.generator, 1)
        self.commands, self.frames = np.zeros((1, 3, 2)), np.zeros((1, 3, 6))
        super().__init__(path, substeps, observation_space(Settings()))
        self.action_space = action_space(6)

    def step(self, action: Any) -> Any:
        """Gymnasium's five results."""
        self.tail = act.step(self.generator, self.tail, np.asarray(action, float)[None], PERIOD)
        self.do_simulation(act.setpoint(self.generator, self.tail), self.frame_skip)
        self.commands = np.roll(self.commands, 1, axis=1)
        self.commands[:, 0] = act.command(self.generator, self.tail)
        self.frames = np.roll(self.frames, 1, axis=1)
        self.frames[0, 0] = [*self.data.qpos[:3], 1.5, 0.5, 0.0]
        distance = float(np.hypot(1.5 - self.data.qpos[0], 0.5 - self.data.qpos[1]))
        reward = -distance - 0.1 * float(np.linalg.norm(action)) + 1000.0 * (distance < 0.05)
        return self._seen(), reward, distance < 0.05, False, {}

    def reset_model(self) -> Any:
        """Reset to a straight fish at rest."""
        self.tail = act.reset(self.generator, 1)
        self.commands, self.frames = np.zeros((1, 3, 2)), np.zeros((1, 3, 6))
        self.set_state(self.init_qpos, self.init_qvel)
        return self._seen()

    def _seen(self) -> Any:
        angle, rate, yaw_rate = self.data.qpos[3:4], self.data.qvel[3:4], self.data.qvel[2:3]
        samples = Samples(angle, rate, yaw_rate, self.tail.phase, self.commands, self.frames)
        return observe(samples)[0]


@dataclass(frozen=True)
class EnvironmentRow:
    """Control steps per second of our environment and of the bare engine with `fish` fish, and
    their ratio. `pairs` are the ratio's quartiles over the turns, which show the effect of a shared
    machine."""

    fish: int
    steps_per_s: float
    bare_engine: float
    of_bare_engine: float
    pairs: tuple[float, ...]


@dataclass(frozen=True)
class PeerRow:
    """Control steps per second of SB3's two vectorised environments with `fish` fish, and our rate
    over the faster one's."""

    fish: int
    dummy_vec_env: float
    subproc_vec_env: float
    of_sb3: float


def env_bench(name: str = "pulley-fish-pool") -> tuple[tuple[EnvironmentRow, ...], PeerRow]:
    """Measure a row per number of fish, and 64 fish against both peers. Environment and bare engine
    are timed in turns; the best of each counts."""
    fish = load_fish(name)
    rows = tuple(_against_bare(fish, count) for count in COUNTS)
    ours = next(row.steps_per_s for row in rows if row.fish == PEER_COUNT)
    dummy, subproc = (
        max(_peer(fish, kind) for _ in range(2)) for kind in (DummyVecEnv, SubprocVecEnv)
    )
    return rows, PeerRow(PEER_COUNT, dummy, subproc, ours / max(dummy, subproc))


def _against_bare(fish: Fish, count: int) -> EnvironmentRow:
    turns = _turns(_ours(fish, count), _bare(fish, count))
    ours, bare = (float(side.max()) for side in turns.T)
    quartiles = np.quantile(turns[:, 0] / turns[:, 1], [0.25, 0.5, 0.75])
    return EnvironmentRow(count, ours, bare, ours / bare, tuple(quartiles.tolist()))


Round = Callable[[], None]


def _turns(ours: tuple[int, Round], bare: tuple[int, Round]) -> NDArray[np.float64]:
    """Rates (TURNS, 2) of both, timed in turns."""
    return np.array([[_rate(*ours), _rate(*bare)] for _ in range(TURNS)])


def _rate(steps: int, play: Round) -> float:
    began = time.perf_counter()
    play()
    return steps / (time.perf_counter() - began)


def _ours(fish: Fish, count: int) -> tuple[int, Round]:
    env = FishVectorEnv(fish, count, seed=0)
    env.reset(seed=0)
    actions = _actions(count)

    def play() -> None:
        for action in actions:
            env.step(action)

    env.step(actions[0])  # compiles, if not yet done
    return actions.shape[0] * count, play


def _bare(fish: Fish, count: int) -> tuple[int, Round]:
    """The engine alone on the same model, with the same substeps and setpoints."""
    twin = compile_twin(fish)
    substeps = round(PERIOD / twin.model.opt.timestep)
    pool = batch.Batch(twin.model, count, persistent=True)
    control = pool.bind("ctrl")
    space = check_settings(fish, Settings())
    state, setpoints = act.reset(space, count), []
    for action in _actions(count):
        state = act.step(space, state, action, PERIOD)
        setpoints.append(act.setpoint(space, state))

    def play() -> None:
        for setpoint in setpoints:
            control[:, 0] = setpoint
            pool.step(nstep=substeps)

    return len(setpoints) * count, play


def _actions(count: int) -> NDArray[np.float64]:
    return np.random.default_rng(0).uniform(-1, 1, (_rounds(count), count, 6))


def _rounds(count: int) -> int:
    return max(CONTROL_STEPS // count, 20)


def _peer(fish: Fish, kind: Any) -> float:
    """Control steps per second of SB3's environment with 64 fish."""
    substeps = round(PERIOD / fish.simulation.step)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "fish.xml"
        spec = build_spec(fish)
        spec.compile()
        path.write_text(spec.to_xml(), encoding="utf-8")
        limits = fish.motor.range or (-np.pi, np.pi)
        peers = kind([partial(OrdinaryFish, str(path), substeps, limits)] * PEER_COUNT)
        peers.reset()
        actions = _actions(PEER_COUNT).astype(np.float32)
        began = time.perf_counter()
        for action in actions:
            peers.step(action)
        rate = len(actions) * PEER_COUNT / (time.perf_counter() - began)
        peers.close()
    return rate
