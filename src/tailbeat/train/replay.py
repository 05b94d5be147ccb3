"""A replay buffer that uses each swim more than once, with other targets for the same path.

Reward and observation depend on the target only through its positions, so a swim gives the reward
for any target. Part of every batch gets a target that the fish reached later, and part one anywhere
near it. Rewards are recomputed as in the environment; an arrival ends a transition as there.

A moving target's new path is its own, turned and moved: in complex numbers a p + b with |a| = 1, or
a = 0 for a target that stays. The filters of its velocity are linear, so the observed velocity
becomes a v, exactly as if the target had swum that path.
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
from tailbeat.env.reward import in_plane
from tailbeat.env.vector_env import FishVecEnv

Single = NDArray[np.float32]
Turns = NDArray[np.complex128]
FIRST, LAST = 12, 24  # observed numbers of the frames; the target's velocity follows
AHEAD = 300  # steps of the paper's fish: a position so much later may become the target (chosen)
STAY = 0.25  # share of the new targets of a task with moving targets that stay (chosen)
EXTRA = ("frames", "next_frames", "place", "target", "went", "effort", "episode")


@dataclass(frozen=True, eq=False)
class Transitions:
    """n transitions of up to k steps.

    First observation `seen` (n, observed) and action (n, size), discounted reward (n,), last
    observation `next`, whether the last step ended the episode (n,). For relabelling: the effort's
    term of every step (n, k), the positions of the tag `way` and of the `target` after every step
    (n, k, 2) [m], NaN after the last, how both `went` in it (n, k, 2, 2) [m], and the frames of
    both observations (n, 3, 6).
    """

    seen: Single
    next: Single
    action: Single
    reward: Single
    effort: Single
    ended: Single
    way: Single
    target: Single
    went: Single
    frames: Single
    next_frames: Single


@dataclass(frozen=True, eq=False)
class Paths:
    """New paths turn p + move of targets at p: complex (n,), each |turn| 1 or 0."""

    turn: Turns
    move: Turns


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
        self.frames = np.zeros((*shape, 3, 6), np.float32)
        self.next_frames = np.zeros((*shape, 3, 6), np.float32)
        self.place, self.target = (np.zeros((*shape, 2), np.float32) for _ in range(2))
        self.went = np.zeros((*shape, 2, 2), np.float32)
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
        self.place[row], self.target[row] = behind.place, behind.target
        self.went[row] = behind.went
        self.effort[row] = behind.effort
        self.episode[row] = self.begun
        self.begun = self.begun + self.n_envs * np.asarray(done, np.int32)
        super().add(obs, next_obs, action, reward, done, infos)

    def _get_samples(self, batch_inds: Any, env: Any = None) -> ReplayBufferSamples:
        fish = np.random.randint(0, self.n_envs, size=len(batch_inds))  # noqa: NPY002 (as SB3)
        at = batch_inds, fish
        found = self._gather(at)
        self._retarget(found, self._other_paths(at))
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
            target=self.target[rows, fish],
            went=self.went[rows, fish],
            frames=self.frames[at],
            next_frames=self.next_frames[last],
        )

    def _written(self, rows: Any) -> Any:
        return rows < (self.buffer_size if self.full else self.pos)

    def _other_paths(self, at: Any) -> Paths:
        """Another path of the target for part of the batch, NaN for the rest."""
        draw = np.random.random_sample(len(at[0]))  # noqa: NPY002
        later, anywhere = self._later(at), self._anywhere(at)
        turn = np.where(draw < self.later, later.turn, anywhere.turn)
        move = np.where(draw < self.later, later.move, anywhere.move)
        return Paths(turn, np.where(draw < self.later + self.anywhere, move, np.nan))

    def _retarget(self, found: Transitions, paths: Paths) -> None:
        """Replace the targets of transitions for which `paths` are finite, in place."""
        lost = (found.ended > 0) & (found.reward < 0)
        chosen = np.isfinite(paths.move) & ~lost
        turn, move, world = paths.turn[chosen], paths.move[chosen], self.source.world
        follows, measure = world.task.follow, world.settings.measure
        for seen, frames in ((found.seen, found.frames), (found.next, found.next_frames)):
            seen[chosen] = _seen(seen[chosen], frames[chosen], turn, move, measure)
        target = turn[:, None] * in_plane(found.target[chosen]) + move[:, None]
        apart = target - in_plane(found.way[chosen])
        away = np.abs(apart).astype(np.float32)
        hit = (away < world.task.arrival) & (not follows)  # NaN after an end is not a hit
        before: Any = np.cumsum(hit, axis=1) - hit == 0
        went = in_plane(found.went[chosen])
        missed = reward.missed(went[..., 0], turn[:, None] * went[..., 1], apart, measure)
        far, weights = away / np.float32(measure.reach), world.settings.reward
        distance, bonus = reward.of_target(weights, far, hit, follows, missed.astype(np.float32))
        earned = (distance + found.effort[chosen] + bonus) * before * self.powers
        found.reward[chosen] = self.source.reward_scale * np.nansum(earned, axis=1)
        found.ended[chosen] = hit.any(axis=1)

    def _later(self, at: Any) -> Paths:
        """Paths through the position of each fish some time later in the same episode, else at this
        step's end. A moving target moves there in the direction that the fish took."""
        longest = round(AHEAD * self.source.world.settings.measure.time)
        ahead = np.random.randint(0, longest, size=len(at[0]))  # noqa: NPY002
        then = (at[0] + ahead) % self.buffer_size
        then = np.where(self.episode[then, at[1]] == self.episode[at], then, at[0]), at[1]
        went = in_plane(self.place[then] - self.place[at])
        moved = in_plane(self.target[then] - self.target[at])
        turn = self._staying(_unit(went * moved.conj()))
        return Paths(turn, self._beside(self.place[then]) - turn * in_plane(self.target[then]))

    def _staying(self, turn: Turns) -> Turns:
        """The turns of new paths; 0 for targets that stay: all of them, unless the task's move."""
        if not self.source.world.task.follow:
            return np.zeros_like(turn)
        return turn * (np.random.random_sample(len(turn)) >= STAY)  # noqa: NPY002

    def _beside(self, place: Single) -> Turns:
        """Move half of the positions by a normal draw of `misses` along both axes."""
        if not self.misses:
            return in_plane(place)
        moved = np.random.random_sample(len(place)) < 0.5  # noqa: NPY002
        misses = self.misses * self.source.world.settings.measure.size
        offset = misses * np.random.standard_normal(place.shape)  # noqa: NPY002
        return in_plane(place + offset * moved[:, None])

    def _anywhere(self, at: Any) -> Paths:
        """Paths that pass around the fish, by distance and bearing, in any direction."""
        task, count = self.source.world.task, len(at[0])
        distance = task.farthest * np.random.random_sample(count)  # noqa: NPY002
        bearing, turned = 2 * np.pi * np.random.random_sample((2, count))  # noqa: NPY002
        place = in_plane(self.place[at]) + distance * np.exp(1j * bearing)
        turn = self._staying(np.exp(1j * turned))
        return Paths(turn, place - turn * in_plane(self.target[at]))


def _unit(turn: Turns) -> Turns:
    """Complex numbers of size 1; 1 for those that are 0."""
    size = np.abs(turn)
    return np.asarray(np.where(size > 0, turn, 1.0) / np.where(size > 0, size, 1.0), np.complex128)


def _seen(seen: Single, frames: Single, turn: Turns, move: Turns, measure: Measure) -> Single:
    """The observations (n, observed) of frames (n, 3, 6) whose targets moved to turn p + move."""
    full, after = np.array(frames, dtype=np.float64), seen.copy()
    target = turn[:, None] * in_plane(full[..., 3:5]) + move[:, None]
    full[..., 3], full[..., 4] = target.real, target.imag
    after[:, FIRST:LAST] = relative(full).reshape(len(full), LAST - FIRST) / scales(measure)[FIRST:]
    if seen.shape[1] > LAST:
        speed = turn * in_plane(seen[:, LAST : LAST + 2])
        after[:, LAST], after[:, LAST + 1] = speed.real, speed.imag
    return after
