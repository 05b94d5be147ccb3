"""Interfaces to `world.World`: gymnasium's vector environment, its single environment, and SB3's.

They add only what their interfaces require: restarts after an end, and the last observation.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from tailbeat.control import actions as act
from tailbeat.control.actions import PERIOD
from tailbeat.control.observation import rows
from tailbeat.env import rendering
from tailbeat.env.hidden import HIDDEN, hidden
from tailbeat.env.reward import TERMS
from tailbeat.env.simulator import Flags
from tailbeat.env.task import Settings
from tailbeat.env.world import Outcome, World, seeds_from
from tailbeat.fish.description import Fish

Array = NDArray[np.float64]
TRAINING = 1  # second number of a training's seed


def observation_space(settings: Settings, count: int | None = None) -> gymnasium.spaces.Box:
    """The observation space: 24 unbounded numbers, with velocities 28, with averages too 42, or a
    batch of them."""
    observed = len(rows(settings.motion is not None, settings.averages is not None))
    return unbounded((observed,) if count is None else (count, observed))


def unbounded(shape: tuple[int, ...]) -> gymnasium.spaces.Box:
    """A space of unbounded numbers."""
    return gymnasium.spaces.Box(-np.inf, np.inf, shape, np.float32)


def action_space(size: int, count: int | None = None) -> gymnasium.spaces.Box:
    """The action space: actions in [-1, 1]."""
    shape = (size,) if count is None else (count, size)
    return gymnasium.spaces.Box(-1.0, 1.0, shape, np.float32)


class FishVectorEnv(VectorEnv):
    """n fish; a fish whose episode ends restarts in the same step (`final_obs` has its last
    observation)."""

    def __init__(
        self,
        fish: Fish,
        count: int,
        settings: Settings | None = None,
        seed: int | None = None,
        threads: int = 0,
    ) -> None:
        self.world = World(fish, settings or Settings(), seeds_from(seed, count), threads)
        self.num_envs = count
        size = act.size(self.world.space)
        seen = self.world.settings
        self.single_observation_space = observation_space(seen)
        self.observation_space = observation_space(seen, count)
        self.single_action_space = action_space(size)
        self.action_space = action_space(size, count)
        self.metadata = {"autoreset_mode": AutoresetMode.SAME_STEP, "render_fps": round(1 / PERIOD)}

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Restart every fish; `seed` reseeds the generators."""
        if seed is not None:
            self.world.reseed(seeds_from(seed, self.num_envs))
        return self.world.reset(), {}

    def step(self, actions: Array) -> Any:
        """Gymnasium's five results; reward terms and `reached` are in the info."""
        done = self.world.step(actions)
        ended = done.terminated | done.truncated
        info: dict[str, Any] = {"reward_terms": vars(done.terms), "reached": done.reached}
        seen = done.observation
        if ended.any():
            info |= {"final_obs": seen, "_final_obs": ended}
            seen = np.where(ended[:, None], self.world.reset(ended), seen)
        return seen, done.reward, done.terminated, done.truncated, info


class FishEnv(gymnasium.Env):
    """One fish: a world of one.

    `render_mode` "rgb_array" draws fish, path and target from above. With `view` "beside" it is the
    engine's 3-D picture (from above if no GL library works).
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 50}  # noqa: RUF012 (gymnasium's)

    def __init__(
        self,
        fish: Fish,
        settings: Settings | None = None,
        seed: int | None = None,
        render_mode: str | None = None,
        view: Literal["above", "beside"] = "above",
    ) -> None:
        self.view = view
        self.world = World(fish, settings or Settings(), seeds_from(seed, 1), threads=1)
        self.observation_space = observation_space(self.world.settings)
        self.action_space = action_space(act.size(self.world.space))
        self.render_mode = render_mode
        self.path: list[Array] = []

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Restart; `seed` reseeds the generator."""
        super().reset(seed=seed)
        if seed is not None:
            self.world.reseed(seeds_from(seed, 1))
        seen = self.world.reset()[0]
        self.path = [self.world.pose[0].copy()]
        return seen, {}

    def step(self, action: Array) -> Any:
        """Gymnasium's five results."""
        done = self.world.step(np.asarray(action, float)[None])
        self.path.append(self.world.pose[0].copy())
        terms = {name: float(values[0]) for name, values in vars(done.terms).items()}
        return (
            done.observation[0],
            float(done.reward[0]),
            bool(done.terminated[0]),
            bool(done.truncated[0]),
            {"reward_terms": terms, "reached": bool(done.reached[0])},
        )

    def render(self) -> NDArray[np.uint8] | None:
        """The fish from above with path and target, or from beside; None without a render mode."""
        if self.render_mode is None:
            return None
        if self.view == "beside":
            return rendering.from_beside(self.world, 0)
        return rendering.from_above(self.world, 0, np.array(self.path))


def training_seeds(seed: int | None, count: int) -> list[int]:
    """One seed per fish of a training; none is among those of `seeds_from`, which swims that test a
    policy use."""
    entropy = None if seed is None else (seed, TRAINING)
    return [int(s) for s in np.random.SeedSequence(entropy).generate_state(count, np.uint64)]


@dataclass(frozen=True, eq=False)
class Behind:
    """What one step of n fish was computed from: frames before and after (n, 3, 6), see
    `observation.Samples`; the true positions of tag and target after it (n, 2), and how both moved
    in it (n, 2, 2); the effort's reward term (n,)."""

    frames: Array
    next_frames: Array
    place: Array
    target: Array
    went: Array
    effort: Array


class FishVecEnv(VecEnv):
    """Interface to SB3: the same world, without copies or processes. Rewards are multiplied by
    `reward_scale`; `last` has the data of the last step. An `informed` one appends to each
    observation what only critics see (`hidden.py`)."""

    def __init__(
        self,
        fish: Fish,
        count: int,
        settings: Settings | None = None,
        seed: int | None = None,
        threads: int = 0,
        reward_scale: float = 1.0,
        informed: bool = False,
    ) -> None:
        self.world = World(fish, settings or Settings(), training_seeds(seed, count), threads)
        self.informed = informed
        self.render_mode = "rgb_array"
        self.reward_scale = reward_scale
        self.returns, self.lengths = np.zeros(count), np.zeros(count, dtype=int)
        self.sums = {name: np.zeros(count) for name in TERMS}
        self.actions: Array = np.zeros((count, act.size(self.world.space)))
        own = observation_space(self.world.settings)
        seen = unbounded((own.shape[0] + HIDDEN * informed,))
        super().__init__(count, seen, action_space(act.size(self.world.space)))

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Reseed the generators at the next reset. SB3 would give the fish seed, seed + 1, … . Then
        trainings of near seeds would see the same targets and physics."""
        self._seeds = list[int | None](training_seeds(seed, self.num_envs))
        return self._seeds

    def reset(self) -> NDArray[np.float32]:
        """Restart every fish."""
        if any(seed is not None for seed in self._seeds):
            self.world.reseed([int(seed or 0) for seed in self._seeds])
            self._reset_seeds()
        self._forget(np.ones(self.num_envs, bool))
        return self._with_hidden(self.world.reset())

    def step_async(self, actions: Array) -> None:
        """Keep the actions for `step_wait`."""
        self.actions = actions

    def step_wait(self) -> Any:
        """SB3's four results; the info of an ended fish has its last observation, return and
        length."""
        before = self.world.frames
        done = self.world.step(self.actions)
        self._count(done)
        ended = done.terminated | done.truncated
        place, target = self.world.pose[:, :2].copy(), self.world.target.copy()
        self.last = Behind(before, done.frames, place, target, self.world.went, done.terms.effort)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        seen = self._with_hidden(done.observation)
        for fish in np.flatnonzero(ended):
            infos[fish] = {
                "terminal_observation": seen[fish].copy(),
                "TimeLimit.truncated": bool(done.truncated[fish]),
                "reached": bool(done.reached[fish]),
                "reward_terms": {n: float(v[fish]) for n, v in self.sums.items()},
                "episode": {"r": float(self.returns[fish]), "l": int(self.lengths[fish])},
            }
        if ended.any():
            self._forget(ended)
            first = self._with_hidden(self.world.reset(ended))
            seen = np.where(ended[:, None], first, seen)
        return seen, (self.reward_scale * done.reward).astype(np.float32), ended, infos

    def _with_hidden(self, seen: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.hstack([seen, hidden(self.world)]) if self.informed else seen

    def _count(self, done: Outcome) -> None:
        self.returns += done.reward
        self.lengths += 1
        for name, values in vars(done.terms).items():
            self.sums[name] += values

    def _forget(self, which: Flags) -> None:
        """Reset the sums."""
        self.returns[which], self.lengths[which] = 0.0, 0
        for values in self.sums.values():
            values[which] = 0.0

    def close(self) -> None:
        """Nothing to release."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """The same attribute for every fish."""
        return [getattr(self, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set for all fish: they share one world."""
        setattr(self, attr_name, value)

    def env_method(
        self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any
    ) -> list[Any]:
        """Call once; the result is returned for every fish in `indices`."""
        found = getattr(self, method_name)(*args, **kwargs)
        return [found] * len(list(self._get_indices(indices)))

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Always False."""
        return [False] * len(list(self._get_indices(indices)))

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """A picture of the first fish from above."""
        return [rendering.from_above(self.world, 0, self.world.pose[:1])]
