"""How fast is the environment, against the bare engine and against SB3's own ways, in one run?

Needs the train extra. The peers are as simple as they can be made: no noise, no delay, no
randomisation, a bare observation; ours has everything on.
"""

import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.envs.mujoco import MujocoEnv
from mujoco import batch
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv

from tailbeat.fish.description import Fish
from tailbeat.fish.store import load_fish
from tailbeat.fish.twin import build_spec, compile_twin
from tailbeat.learn.env import FishVectorEnv
from tailbeat.learn.world import PERIOD

COUNTS = (1, 16, 64, 256)
PEER_COUNT = 64
CONTROL_STEPS = 8_000  # per turn, in all
TURNS = 11


class OrdinaryFish(MujocoEnv):
    """One fish the ordinary way: gymnasium's MujocoEnv, the action is the motor's angle."""

    metadata = {"render_modes": ["human", "rgb_array", "depth_array", "rgbd_tuple"]}  # noqa: RUF012

    def __init__(self, path: str, substeps: int) -> None:
        box = spaces.Box(-np.inf, np.inf, (18,), np.float64)
        super().__init__(path, substeps, box)

    def step(self, action: Any) -> Any:
        """Gymnasium's five."""
        self.do_simulation(action, self.frame_skip)
        distance = float(np.linalg.norm(self.data.qpos[:2] - 2.0))
        return self._seen(), -distance, False, False, {}

    def reset_model(self) -> Any:
        """Straight and still."""
        self.set_state(self.init_qpos, self.init_qvel)
        return self._seen()

    def _seen(self) -> Any:
        return np.concatenate([self.data.qpos, self.data.qvel])


def env_bench(name: str = "pulley-fish-pool") -> dict[str, Any]:
    """Control steps per second by number of fish, and at 64 against both peers.

    The environment and the bare engine take turns, best of each; `pairs` are the quartiles of the
    ratio over the turns: what a shared machine does to it.
    """
    fish = load_fish(name)
    found: dict[str, Any] = {}
    for count in COUNTS:
        turns = _turns(_ours(fish, count), _bare(fish, count))
        ours, bare = (float(side.max()) for side in turns.T)
        ratios = turns[:, 0] / turns[:, 1]
        found[str(count)] = {
            "steps_per_s": ours,
            "bare_engine": bare,
            "of_bare_engine": ours / bare,
            "pairs": np.quantile(ratios, [0.25, 0.5, 0.75]).tolist(),
        }
    row = found[str(PEER_COUNT)]
    row["dummy_vec_env"] = max(_peer(fish, DummyVecEnv) for _ in range(2))
    row["subproc_vec_env"] = max(_peer(fish, SubprocVecEnv) for _ in range(2))
    row["of_sb3"] = row["steps_per_s"] / max(row["dummy_vec_env"], row["subproc_vec_env"])
    return found


Round = Callable[[], None]


def _turns(ours: tuple[int, Round], bare: tuple[int, Round]) -> NDArray[np.float64]:
    """Rates (TURNS, 2) of both, one after the other in turn."""
    return np.array([[_rate(*ours), _rate(*bare)] for _ in range(TURNS)])


def _rate(steps: int, play: Round) -> float:
    began = time.perf_counter()
    play()
    return steps / (time.perf_counter() - began)


def _ours(fish: Fish, count: int) -> tuple[int, Round]:
    env = FishVectorEnv(fish, count, seed=0)
    env.reset(seed=0)
    rounds = _rounds(count)
    actions = np.random.default_rng(0).uniform(-1, 1, (rounds, count, 6))

    def play() -> None:
        for action in actions:
            env.step(action)

    env.step(actions[0])  # compiled here, if it was not
    return rounds * count, play


def _bare(fish: Fish, count: int) -> tuple[int, Round]:
    """The engine alone on the same model: the same substeps, a command per control step."""
    twin = compile_twin(fish)
    substeps = round(PERIOD / twin.model.opt.timestep)
    pool = batch.Batch(twin.model, count, persistent=True)
    control, rounds = pool.bind("ctrl"), _rounds(count)

    def play() -> None:
        for step in range(rounds):
            control[:] = 0.6 * np.sin(0.19 * step)
            pool.step(nstep=substeps)

    return rounds * count, play


def _rounds(count: int) -> int:
    return max(CONTROL_STEPS // count, 20)


def _peer(fish: Fish, kind: Any) -> float:
    """SB3's way with 64 ordinary fish."""
    substeps = round(PERIOD / fish.simulation.step)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "fish.xml"
        spec = build_spec(fish)
        spec.compile()
        path.write_text(spec.to_xml(), encoding="utf-8")
        peers = kind([partial(OrdinaryFish, str(path), substeps)] * PEER_COUNT)
        peers.reset()
        rounds = _rounds(PEER_COUNT)
        action = np.full((PEER_COUNT, 1), 0.3, dtype=np.float32)
        began = time.perf_counter()
        for _ in range(rounds):
            peers.step(action)
        rate = rounds * PEER_COUNT / (time.perf_counter() - began)
        peers.close()
    return rate
