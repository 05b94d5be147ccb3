"""A replay buffer that makes more of each swim: other targets for the same way, and its mirror.

A swim says what it would have earned for any target, since reward and observation depend on the
target by its place alone. So a share of every batch gets a target that the fish came by later, a
share one anywhere about, and half is mirrored left to right: the fish is symmetric. Rewards are the
environment's, recomputed; arrivals end a transition as they do there.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.type_aliases import ReplayBufferSamples

from tailbeat.control.observation import SCALES, TABLE, relative
from tailbeat.learn.env import FishVecEnv

Single = NDArray[np.float32]
FIRST = 12  # observed numbers that depend on the target begin here
AHEAD = 300  # control steps within which a later place becomes the target (chosen)
LEFT_RIGHT = ("sin motor angle", "motor velocity", "yaw rate", "centre", "target left")
EXTRA = ("frames", "next_frames", "track", "effort", "episode")


class RelabelBuffer(ReplayBuffer):
    """SB3's buffer with `later` and `anywhere`, shares of a batch that get another target.

    `discount` is per control step: decisions may hold their actions for different times.
    """

    def __init__(
        self,
        *args: Any,
        source: FishVecEnv,
        discount: float,
        later: float = 0.4,
        anywhere: float = 0.2,
        **rest: Any,
    ) -> None:
        super().__init__(*args, **rest)
        self.source, self.discount = source, discount
        self.later, self.anywhere = later, anywhere
        shape = (self.buffer_size, self.n_envs)
        self.frames = np.zeros((*shape, 3, 4), np.float32)
        self.next_frames = np.zeros((*shape, 3, 4), np.float32)
        self.track = np.zeros((*shape, source.longest, 2), np.float32)
        self.effort = np.zeros(shape, np.float32)
        self.episode = np.full(shape, -1, np.int32)
        self.begin_after(-1)

    def begin_after(self, episode: int) -> None:
        """Number the fish's episodes from here on: after a restart none goes on."""
        self.begun = episode + 1 + np.arange(self.n_envs, dtype=np.int32)

    def add(self, obs: Any, next_obs: Any, action: Any, reward: Any, done: Any, infos: Any) -> None:
        """One decision of every fish; what lies behind the observations comes from the source."""
        last, place = self.source.last, self.pos
        self.frames[place], self.next_frames[place] = last.frames, last.next_frames
        self.track[place], self.effort[place] = last.track, last.effort
        self.episode[place] = self.begun
        self.begun = self.begun + self.n_envs * np.asarray(done, np.int32)
        super().add(obs, next_obs, action, reward, done, infos)

    def _get_samples(self, batch_inds: Any, env: Any = None) -> ReplayBufferSamples:
        fish = np.random.randint(0, self.n_envs, size=len(batch_inds))  # noqa: NPY002 (as SB3)
        at = batch_inds, fish
        ended = self.dones[at] * (1 - self.timeouts[at])
        parts = {
            "seen": self.observations[at],
            "next": self.next_observations[at],
            "action": self.actions[at],
            "reward": self.rewards[at],
            "ended": ended,
        }
        self._retarget(at, parts)
        self._mirror(parts)
        steps = np.isfinite(self.track[at][..., 0]).sum(axis=1)
        discounts = (self.discount**steps).astype(np.float32)
        order = parts["seen"], parts["action"], parts["next"]
        columns = parts["ended"], parts["reward"], discounts
        return ReplayBufferSamples(
            *(self.to_torch(one) for one in (*order, *(column[:, None] for column in columns)))
        )

    def _retarget(self, at: Any, parts: dict[str, Any]) -> None:
        """Give a share of the batch other targets, in place."""
        draw = np.random.random_sample(len(at[0]))  # noqa: NPY002
        lost = (parts["ended"] > 0) & (parts["reward"] < 0)
        chosen = (draw < self.later + self.anywhere) & ~lost
        target = np.where((draw < self.later)[:, None], self._later(at), self._anywhere(at))[chosen]
        some = at[0][chosen], at[1][chosen]
        parts["seen"][chosen, FIRST:] = _seen(self.frames[some], target)
        parts["next"][chosen, FIRST:] = _seen(self.next_frames[some], target)
        world = self.source.world
        away = np.linalg.norm(self.track[some] - target[:, None], axis=2)
        hit = away < world.task.arrival  # NaN after an end: no hit
        before = np.cumsum(hit, axis=1) - hit == 0
        weights = world.settings.reward
        earned = -weights.distance * np.nansum(away * before, axis=1) + self.effort[some]
        earned += weights.bonus * hit.any(axis=1)
        parts["reward"][chosen] = self.source.reward_scale * earned
        parts["ended"][chosen] = hit.any(axis=1)

    def _later(self, at: Any) -> Single:
        """Where each fish was some decisions later in the same episode, else at this one's end."""
        furthest = max(AHEAD // self.source.hold, 1)
        ahead = np.random.randint(0, furthest, size=len(at[0]))  # noqa: NPY002
        then = (at[0] + ahead) % self.buffer_size
        same = self.episode[then, at[1]] == self.episode[at]
        place = self.track[np.where(same, then, at[0]), at[1]]
        last = np.sum(np.isfinite(place[..., 0]), axis=1) - 1
        return place[np.arange(len(last)), last]

    def _anywhere(self, at: Any) -> Single:
        """Places about the fish, by range and bearing."""
        task, count = self.source.world.task, len(at[0])
        distance = task.farthest * np.random.random_sample(count)  # noqa: NPY002
        bearing = 2 * np.pi * np.random.random_sample(count)  # noqa: NPY002
        offset = distance[:, None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
        return np.asarray(self.track[at][:, 0] + offset, dtype=np.float32)

    def _mirror(self, parts: dict[str, Any]) -> None:
        space = self.source.world.space
        if space.low != -space.high:
            return
        signs = np.where(np.random.random_sample(len(parts["seen"])) < 0.5, -1, 1)  # noqa: NPY002
        swap = np.where(MIRRORED, signs[:, None], 1)
        parts["seen"] = (parts["seen"] * swap).astype(np.float32)
        parts["next"] = (parts["next"] * swap).astype(np.float32)
        flips = np.ones(parts["action"].shape[1], bool)
        flips[0] = space.kind != "generator"  # its frequency has no side
        swap = np.where(flips, signs[:, None], 1)
        parts["action"] = (parts["action"] * swap).astype(np.float32)


MIRRORED = np.array([entry.name.endswith(LEFT_RIGHT) for entry in TABLE])


def _seen(frames: Single, target: Single) -> Single:
    """Observed numbers (n, 12) of frames (n, 3, 4) and targets (n, 2)."""
    full = np.empty((len(frames), 3, 6))
    full[..., :3], full[..., 5] = frames[..., :3], frames[..., 3]
    full[..., 3:5] = target[:, None]
    return np.asarray(relative(full).reshape(len(frames), -1) / SCALES[FIRST:], dtype=np.float32)
