"""A replay buffer that uses each swim more than once, with other targets for the same path.

Reward and observation depend on the target only through its position, so a swim gives the reward
for any target. Part of every batch gets a target that the fish reached later, and part one anywhere
near it. Rewards are recomputed as in the environment; an arrival ends a transition as there.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.buffers import ReplayBuffer
from stable_baselines3.common.type_aliases import ReplayBufferSamples

from tailbeat.control.measure import Measure
from tailbeat.control.observation import relative, scales
from tailbeat.env import reward
from tailbeat.env.vector_env import FishVecEnv

Single = NDArray[np.float32]
FIRST = 12  # index of the first observed number that depends on the target
AHEAD = 300  # steps of the paper's fish: a position so much later may become the target (chosen)
EXTRA = ("frames", "next_frames", "place", "effort", "episode")


@dataclass(frozen=True, eq=False)
class Transitions:
    """n transitions of up to k steps.

    First observation `seen` (n, 24) and action (n, size), discounted reward (n,), last observation
    `next` (n, 24), whether the last step ended the episode (n,). For relabelling: the effort's term
    of every step (n, k), the tag's position `way` after every step (n, k, 2) [m], NaN after the
    last, and the frames of both observations (n, 3, 4).
    """

    seen: Single
    next: Single
    action: Single
    reward: Single
    effort: Single
    ended: Single
    way: Single
    frames: Single
    next_frames: Single


class RelabelBuffer(ReplayBuffer):
    """SB3's buffer, which gives fractions `later` and `anywhere` of a batch another target.

    Half of the `later` targets are moved off the path by about `misses` [m]. `returns` steps in a
    row make one transition (n-step returns): the sum of their rewards, each times `discount` for
    every step before it.
    """

    def __init__(
        self,
        *args: Any,
        source: FishVecEnv,
        discount: float,
        returns: int = 1,
        later: float = 0.4,
        anywhere: float = 0.2,
        misses: float = 0.0,
        **rest: Any,
    ) -> None:
        super().__init__(*args, **rest)
        self.source, self.discount, self.returns = source, discount, returns
        self.powers = discount ** np.arange(returns, dtype=np.float32)  # weights of the rewards
        self.later, self.anywhere, self.misses = later, anywhere, misses
        shape = (self.buffer_size, self.n_envs)
        self.frames = np.zeros((*shape, 3, 4), np.float32)
        self.next_frames = np.zeros((*shape, 3, 4), np.float32)
        self.place = np.zeros((*shape, 2), np.float32)
        self.effort = np.zeros(shape, np.float32)
        self.episode = np.full(shape, -1, np.int32)
        self.begin_after(-1)

    def begin_after(self, episode: int) -> None:
        """Number episodes from here on; after a restart no old episode continues."""
        self.begun = episode + 1 + np.arange(self.n_envs, dtype=np.int32)

    def add(self, obs: Any, next_obs: Any, action: Any, reward: Any, done: Any, infos: Any) -> None:
        """Add one step of every fish; the data for relabelling come from the source."""
        behind, row = self.source.last, self.pos
        self.frames[row], self.next_frames[row] = behind.frames, behind.next_frames
        self.place[row], self.effort[row] = behind.place, behind.effort
        self.episode[row] = self.begun
        self.begun = self.begun + self.n_envs * np.asarray(done, np.int32)
        super().add(obs, next_obs, action, reward, done, infos)

    def _get_samples(self, batch_inds: Any, env: Any = None) -> ReplayBufferSamples:
        fish = np.random.randint(0, self.n_envs, size=len(batch_inds))  # noqa: NPY002 (as SB3)
        at = batch_inds, fish
        found = self._gather(at)
        self._retarget(found, self._other_targets(at))
        bootstrap = (self.discount ** np.isfinite(found.way[..., 0]).sum(axis=1)).astype(np.float32)
        columns = found.ended, found.reward, bootstrap
        order = found.seen, found.action, found.next
        return ReplayBufferSamples(
            *(self.to_torch(one) for one in (*order, *(column[:, None] for column in columns)))
        )

    def _gather(self, at: Any) -> Transitions:
        """Join `returns` steps into one transition, or fewer where an episode or the buffer
        ends."""
        rows = (at[0][:, None] + np.arange(self.returns)) % self.buffer_size
        fish = at[1][:, None]
        same = self.episode[rows, fish] == self.episode[at][:, None]
        follows = rows - at[0][:, None] == np.arange(self.returns)  # not across the end of the ring
        valid = np.logical_and.accumulate(same & follows & self._written(rows), axis=1)
        last = rows[np.arange(len(rows)), valid.sum(axis=1) - 1], at[1]
        return Transitions(
            seen=self.observations[at],
            next=self.next_observations[last],
            action=self.actions[at],
            reward=(self.rewards[rows, fish] * valid * self.powers).sum(axis=1),
            effort=self.effort[rows, fish] * valid,
            ended=self.dones[last] * (1 - self.timeouts[last]),
            way=np.where(valid[..., None], self.place[rows, fish], np.nan),
            frames=self.frames[at],
            next_frames=self.next_frames[last],
        )

    def _written(self, rows: Any) -> Any:
        return rows < (self.buffer_size if self.full else self.pos)

    def _other_targets(self, at: Any) -> Single:
        """Another target (n, 2) for part of the batch, NaN for the rest."""
        draw = np.random.random_sample(len(at[0]))[:, None]  # noqa: NPY002
        anywhere = np.where(draw < self.later + self.anywhere, self._anywhere(at), np.nan)
        return np.where(draw < self.later, self._beside(self._later(at)), anywhere)

    def _retarget(self, found: Transitions, targets: Single) -> None:
        """Replace the targets of transitions for which `targets` is finite, in place."""
        lost = (found.ended > 0) & (found.reward < 0)
        chosen = np.isfinite(targets[:, 0]) & ~lost
        target, world = targets[chosen], self.source.world
        measure = world.settings.measure
        found.seen[chosen, FIRST:] = _seen(found.frames[chosen], target, measure)
        found.next[chosen, FIRST:] = _seen(found.next_frames[chosen], target, measure)
        away = np.linalg.norm(found.way[chosen] - target[:, None], axis=2)
        follows = self._following(len(away))[:, None]
        hit = (away < world.task.arrival) & ~follows  # NaN after an end is not a hit
        before = np.cumsum(hit, axis=1) - hit == 0
        apart = away / np.float32(measure.reach)
        distance, bonus = reward.of_target(world.settings.reward, apart, hit, follows)
        earned = (distance + found.effort[chosen] + bonus) * before * self.powers
        found.reward[chosen] = self.source.reward_scale * np.nansum(earned, axis=1)
        found.ended[chosen] = hit.any(axis=1)

    def _following(self, count: int) -> Any:
        """Which of the new targets keep moving after an arrival: the same fraction as in the
        task."""
        share = self.source.world.task.following
        return np.random.random_sample(count) < share if share else np.zeros(count, bool)  # noqa: NPY002

    def _later(self, at: Any) -> Single:
        """Position of each fish some time later in the same episode, else at this step's end."""
        longest = round(AHEAD * self.source.world.settings.measure.time)
        ahead = np.random.randint(0, longest, size=len(at[0]))  # noqa: NPY002
        then = (at[0] + ahead) % self.buffer_size
        same = self.episode[then, at[1]] == self.episode[at]
        return self.place[np.where(same, then, at[0]), at[1]]

    def _beside(self, place: Single) -> Single:
        """Move half of the positions by a normal draw of `misses` along both axes."""
        if not self.misses:
            return place
        moved = np.random.random_sample(len(place)) < 0.5  # noqa: NPY002
        misses = self.misses * self.source.world.settings.measure.size
        offset = misses * np.random.standard_normal(place.shape)  # noqa: NPY002
        return (place + offset * moved[:, None]).astype(np.float32)

    def _anywhere(self, at: Any) -> Single:
        """Positions around the fish, by distance and bearing."""
        task, count = self.source.world.task, len(at[0])
        distance = task.farthest * np.random.random_sample(count)  # noqa: NPY002
        bearing = 2 * np.pi * np.random.random_sample(count)  # noqa: NPY002
        offset = distance[:, None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
        return np.asarray(self.place[at] + offset, dtype=np.float32)


def _seen(frames: Single, target: Single, measure: Measure) -> Single:
    """Observed numbers (n, 12) of frames (n, 3, 4) and targets (n, 2)."""
    full = np.empty((len(frames), 3, 6))
    full[..., :3], full[..., 5] = frames[..., :3], frames[..., 3]
    full[..., 3:5] = target[:, None]
    divided = scales(measure)[FIRST:]
    found = relative(full).reshape(len(frames), divided.size) / divided
    return np.asarray(found, dtype=np.float32)
