"""The replay buffer: several steps in one transition, and other targets for replayed swims."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("stable_baselines3", reason="the train extra is not installed")

import torch
from stable_baselines3.common.buffers import NStepReplayBuffer

from tailbeat.control.measure import Measure
from tailbeat.control.observation import TABLE
from tailbeat.env import randomize
from tailbeat.env.reward import in_plane
from tailbeat.env.sensors import motion_filter, quiet
from tailbeat.env.task import Settings, Task
from tailbeat.env.vector_env import FishVecEnv
from tailbeat.env.world import World
from tailbeat.fish.store import load_fish
from tailbeat.train import checkpoint
from tailbeat.train import config as config
from tailbeat.train.replay import FIRST, Paths, RelabelBuffer, Transitions, _seen

FISH = load_fish("pulley-fish-pool")
STILL = Settings(sensors=quiet(), physics=randomize.none())
RETURNS = 5


@pytest.fixture(scope="module")
def filled() -> tuple[RelabelBuffer, np.ndarray]:
    return fill()


@pytest.fixture(scope="module")
def followed() -> tuple[RelabelBuffer, Any]:
    return fill(follow=True, target_speed=0.3)


def fill(**moving: Any) -> tuple[RelabelBuffer, Any]:
    """A buffer of short episodes, some of which arrive, and the target of every transition; those
    of `moving` targets go on after that."""
    task = Task(seconds=2.0, nearest=0.1, farthest=0.6, arrival=0.08, **moving)
    settings = Settings(task=task, motion=motion_filter() if moving else None)
    env = FishVecEnv(FISH, 8, settings, seed=0, reward_scale=0.01)
    spaces = env.observation_space, env.action_space
    buffer = RelabelBuffer(
        8 * 400, *spaces, "cpu", n_envs=8, source=env, discount=0.99, returns=RETURNS
    )
    seen: Any = env.reset()
    rng, targets = np.random.default_rng(0), []
    for _ in range(400):
        targets.append(env.world.target.copy())
        action = rng.uniform(-1, 1, (8, 6)).astype(np.float32)
        after: Any
        after, reward, done, infos = env.step(action)
        last = after.copy()
        for fish in np.flatnonzero(done).tolist():
            last[fish] = infos[fish]["terminal_observation"]
        buffer.add(seen, last, action, reward, done, infos)
        seen = after
    return buffer, np.array(targets)


def everything(buffer: RelabelBuffer) -> tuple[Any, Transitions]:
    at = tuple(index.ravel() for index in np.indices(buffer.dones.shape))
    return at, buffer._gather(at)


def test_steps_in_a_row_make_one_transition_as_in_sb3_s_own_buffer(filled, monkeypatch):
    buffer, _ = filled
    spaces = buffer.source.observation_space, buffer.source.action_space
    theirs = NStepReplayBuffer(8 * 400, *spaces, "cpu", n_envs=8, n_steps=RETURNS, gamma=0.99)
    for name in (*checkpoint.ARRAYS, "pos", "full"):
        setattr(theirs, name, getattr(buffer, name))
    rows = np.tile(np.arange(400), 8)
    monkeypatch.setattr(buffer, "later", 0.0)  # every target stays what it was
    monkeypatch.setattr(buffer, "anywhere", 0.0)
    samples: list[Any] = []
    for one in (buffer, theirs):
        np.random.seed(0)  # noqa: NPY002 (both draw the fish from it)
        samples.append(one._get_samples(rows))
    assert len(samples[1].discounts.unique()) == RETURNS  # transitions of every length
    for ours, sb3 in zip(*samples, strict=True):
        assert torch.allclose(ours, sb3, rtol=1e-6, atol=1e-7)


def moved(found: Transitions, targets: Any) -> Paths:
    """Paths on which still targets stand at `targets`, and moving ones stay what they were."""
    turn = np.full(len(targets), 1.0 if found.seen.shape[1] > 24 else 0.0, complex)
    return Paths(turn, (1 - turn) * in_plane(targets))


def check_the_same_target_changes_nothing(buffer: RelabelBuffer, targets: Any) -> Transitions:
    at, found = everything(buffer)
    before = replace(found, **{name: one.copy() for name, one in vars(found).items()})
    buffer._retarget(found, moved(found, targets[at]))
    for name in ("seen", "next", "reward", "ended"):
        assert getattr(found, name) == pytest.approx(getattr(before, name), abs=1e-5), name
    return before


@pytest.mark.thorough
def test_the_same_target_gives_the_same_sight_reward_and_end(filled):
    before = check_the_same_target_changes_nothing(*filled)
    assert before.ended.sum() >= 1 and filled[0].timeouts.sum() > 10


@pytest.mark.thorough
def test_the_same_target_that_goes_on_gives_the_same_reward_and_no_end(followed):
    before = check_the_same_target_changes_nothing(*followed)
    assert not before.ended.any() and np.ptp(before.reward) > 0.1  # nearness pays


def test_a_place_on_the_way_as_target_is_arrived_at(filled):
    buffer, _ = filled
    at, parts = everything(buffer)
    buffer._retarget(parts, moved(parts, buffer.place[at]))
    assert parts.ended.all()
    assert (parts.reward > 9.0).all()


def test_targets_elsewhere_are_seen_where_they_are(filled):
    buffer, _ = filled
    at, _ = everything(buffer)
    paths = buffer._anywhere(at)
    place = np.stack([paths.move.real, paths.move.imag], axis=1)
    assert not paths.turn.any()
    before, frames = buffer.observations[at], buffer.frames[at]
    seen = _seen(before, frames, paths.turn, paths.move, Measure())[:, FIRST:]
    x, y, yaw = buffer.frames[at][:, 0, :3].T
    ahead = np.cos(yaw) * (place[:, 0] - x) + np.sin(yaw) * (place[:, 1] - y)
    column = [entry.name for entry in TABLE].index("frame 0 (newest): target ahead") - FIRST
    assert seen[:, column] * 2.0 == pytest.approx(ahead, abs=1e-5)


def test_half_of_the_later_targets_lie_just_beside_the_way(filled, monkeypatch):
    buffer, _ = filled
    monkeypatch.setattr(buffer, "misses", 0.1)
    place = np.zeros((4000, 2), np.float32)
    there = buffer._beside(place)
    shifted = np.stack([there.real, there.imag], axis=1)
    aside = shifted[np.abs(shifted).sum(axis=1) > 0]
    assert len(aside) == pytest.approx(2000, abs=150)
    assert aside.std(axis=0) == pytest.approx(0.1, abs=0.01)


def test_the_mirrored_fish_sees_the_mirrored_observation():
    """The whole environment is symmetric: mirrored actions give mirrored observations."""
    worlds = [World(FISH, STILL, [3]) for _ in range(2)]
    for world in worlds:
        world.reset()
    worlds[1].target = worlds[1].target * [1, -1]
    worlds[1].seen.frames[..., 4] *= -1
    flip = np.where(np.arange(6) == 0, 1.0, -1.0)
    for action in np.random.default_rng(0).uniform(-1, 1, (60, 1, 6)):
        a, b = (worlds[0].step(action), worlds[1].step(action * flip))
    sided = ("sin motor angle", "motor velocity", "yaw rate", "centre", "target left")
    mirrored = np.array([entry.name.endswith(sided) for entry in TABLE])
    signs = np.where(mirrored, -1, 1)
    assert b.observation == pytest.approx(a.observation * signs, abs=1e-5)
    assert mirrored.sum() == 3 + 3 + 3
