"""The filters of target and fish, the moving targets of training, and what replay makes of them."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tailbeat.control import motion
from tailbeat.control.actions import PERIOD
from tailbeat.control.observation import FOLLOWING, TABLE, Samples, observe
from tailbeat.control.policy import load_policy
from tailbeat.env import randomize, target_paths
from tailbeat.env.curriculum import FOLLOWING as FOLLOWING_STAGES
from tailbeat.env.curriculum import MOVING as MOVING_TASK
from tailbeat.env.curriculum import settings_of
from tailbeat.env.reward import in_plane
from tailbeat.env.sensors import SensorModel, motion_filter
from tailbeat.env.task import Scene, Settings, Task
from tailbeat.env.vector_env import FishVecEnv
from tailbeat.env.world import World, seeds_from
from tailbeat.fish.store import load_fish
from tailbeat.operator.paths import HALF_EIGHT
from tailbeat.train.replay import Paths, RelabelBuffer

FISH = load_fish("pulley-fish-pool")
CONSTANTS = motion_filter()
FOLLOWED = Task(seconds=4.0, nearest=0.3, farthest=1.0, follow=True, target_speed=0.18)
MOVING = Settings(task=FOLLOWED, motion=CONSTANTS)


def frames(place: Any, target: Any, staleness: Any, yaw: float = 0.0) -> Any:
    """Frames (n, 3, 6) with the same newest place and target."""
    found = np.zeros((len(place), 3, 6))
    found[..., :2], found[..., 2] = np.asarray(place)[:, None], yaw
    found[..., 3:5], found[..., 5] = np.asarray(target)[:, None], np.asarray(staleness)[:, None]
    return found


def test_the_filter_s_noise_is_the_camera_s():
    """In training, and so in the shipped contract."""
    rough = replace(SensorModel(), position_noise=0.02)
    assert motion_filter(rough) == replace(CONSTANTS, noise=0.02)
    asked = settings_of(FOLLOWING_STAGES[0], task=MOVING_TASK)  # its own sensors are exact
    assert asked.motion == load_policy("pulley-fish-pool-follow").contract.motion == CONSTANTS
    assert CONSTANTS.noise == SensorModel().position_noise


def textbook(times: Any, places: Any, density: float) -> list[Any]:
    """States and covariances of one axis, by matrices, at the `times` [s] of new frames."""
    x, p = np.array([places[0], 0.0]), np.diag([CONSTANTS.noise**2, CONSTANTS.speed**2])
    found = [(x, p)]
    for dt, place in zip(np.diff(times), places[1:], strict=True):
        f = np.array([[1, dt], [0, 1]])
        q = density * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
        x, p = f @ x, f @ p @ f.T + q
        gain = p[:, 0] / (p[0, 0] + CONSTANTS.noise**2)
        x, p = x + gain * (place - x[0]), p - np.outer(gain, p[0])
        found.append((x, p))
    return found


def test_a_new_policy_is_trained_with_the_shipped_filter() -> None:
    assert load_policy("pulley-fish-pool-follow").contract.motion == CONSTANTS


def test_the_filter_is_the_textbook_s():
    """Over frames at irregular times; each is seen late, and some of them twice."""
    rng = np.random.default_rng(0)
    times = np.cumsum(rng.uniform(0.012, 0.07, 120))
    place, target = rng.normal(size=(120, 2)), 0.03 * rng.normal(size=(120, 2))
    wanted = [
        textbook(times, places[:, 0], density)
        for places, density in ((place, CONSTANTS.fish), (target, CONSTANTS.target))
    ]
    first = frames(place[:1], target[:1], [0.03])
    state, before = motion.begin(CONSTANTS, first), times[0] + 0.03
    for k in range(1, 120):
        for late in (0.03, 0.05):  # the same frame twice
            now = times[k] + late
            here = frames(place[k : k + 1], target[k : k + 1], [late])
            state, before = motion.update(CONSTANTS, state, here, now - before), now
        for row in (motion.FISH, motion.TARGET):
            x, p = wanted[row][k]
            assert state.place[0, row, 0] == pytest.approx(x[0], abs=1e-9)
            assert state.velocity[0, row, 0] == pytest.approx(x[1], abs=1e-9)
            assert state.doubt[0, row] == pytest.approx([p[0, 0], p[0, 1], p[1, 1]], abs=1e-9)


def watched(noise: float, speed: float = 0.1) -> tuple[Any, Any]:
    """Errors [m/s] of the filtered velocity of a target, and of the one from two frames, the naive
    way, for 50 fish after 3 s; a tenth of the frames are lost."""
    rng, count = np.random.default_rng(1), 50
    state: Any = None
    before: Any = None
    error: list[Any] = []
    naive: list[Any] = []
    taken = np.zeros(count)
    target = np.zeros((count, 2))
    for step in range(300):
        now = 0.02 * step
        seen = rng.uniform(size=count) < 0.9
        new = np.where(seen, now - rng.uniform(0.03, 0.045, count), taken)
        place = np.stack([speed * new, np.zeros(count)], axis=1)
        shown = place + noise * rng.normal(size=place.shape)
        target = np.where((new > taken)[:, None], shown, target)
        taken = np.maximum(new, taken)
        here = frames(np.zeros((count, 2)), target, now - taken)
        state = (
            motion.begin(CONSTANTS, here)
            if state is None
            else motion.update(CONSTANTS, state, here, 0.02)
        )
        if step > 150 and before is not None:
            moved = taken > before[0]
            error.append(state.velocity[:, motion.TARGET] - [speed, 0])
            span = (taken - before[0])[moved, None]
            naive.append((target - before[1])[moved] / span - [speed, 0])
        before = taken, target
    return np.concatenate(error), np.concatenate(naive)


def test_a_noisy_target_s_velocity_is_known_to_some_centimetres_a_second():
    error, naive = watched(0.003)
    assert error.std() < 0.02 and abs(error.mean()) < 0.005
    assert naive.std() > 8 * error.std()  # two frames alone tell nothing at 0.1 m/s


def test_a_still_target_has_no_velocity_and_a_jump_begins_anew():
    state = motion.begin(CONSTANTS, frames([[0, 0]], [[1, 0]], [0.04]))
    for step in range(100):
        place = [[1.0 + 0.002 * step, 0.0]]
        state = motion.update(CONSTANTS, state, frames([[0, 0]], place, [0.04]), 0.02)
    assert state.velocity[0, motion.TARGET] == pytest.approx([0.1, 0.0], abs=0.003)
    state = motion.update(CONSTANTS, state, frames([[0, 0]], [[2.0, 1.0]], [0.04]), 0.02)
    assert not state.velocity[0, motion.TARGET].any()
    assert state.place[0, motion.TARGET] == pytest.approx([2.0, 1.0])


def test_a_late_step_does_not_change_a_velocity():
    """Frames have their own times: a loop that misses a period sees the same target."""
    found = []
    for steps in (np.full(100, 0.02), np.tile([0.02, 0.06], 50)):
        state, now = motion.begin(CONSTANTS, frames([[0, 0]], [[0, 0]], [0.04])), 0.0
        for elapsed in steps:
            now += elapsed
            shown = frames([[0, 0]], [[0.12 * now, 0.0]], [0.04])
            state = motion.update(CONSTANTS, state, shown, elapsed)
        found.append(state.velocity[0, motion.TARGET, 0])
    assert found == pytest.approx([0.12, 0.12], abs=0.002)


def test_velocities_are_seen_from_the_fish():
    state = motion.begin(CONSTANTS, frames([[0, 0]], [[0, 0]], [0.0]))
    state = state._replace(velocity=np.array([[[0.3, 0.0], [0.0, 0.1]]]))  # fish, target
    seen = motion.observed(state, np.array([np.pi / 2]))
    assert seen[0] == pytest.approx([0.1, 0.0, 0.0, -0.3])
    none = np.zeros(1)
    raw = Samples(none, none, none, none, np.zeros((1, 3, 2)), np.zeros((1, 3, 6)), seen)
    columns = {entry.name: i for i, entry in enumerate(FOLLOWING)}
    found = observe(raw)[0]
    assert found[columns["target's velocity ahead"]] == pytest.approx(0.2)
    assert found[columns["own velocity left"]] == pytest.approx(-0.6)
    assert len(found) == len(TABLE) + 4


def test_a_world_s_velocities_are_true_but_for_the_noise():
    world = World(FISH, replace(MOVING, physics=randomize.none()), seeds_from(0, 40))
    world.reset()
    for _ in range(150):
        before = world.target.copy()
        done = world.step(np.zeros((40, 6)))
    true = in_plane(world.target - before) / 0.02
    yaw = world.frames[:, 0, 2]
    seen = in_plane(0.5 * done.observation[:, 24:26]) * np.exp(1j * yaw)
    error = np.abs(seen - true)
    assert (np.abs(true) > 0.02).sum() > 15 and np.median(error) < 0.01


# ---- the paths of training ----------------------------------------------------------------------


def test_drawn_targets_stay_move_stop_and_jump_but_never_hurry():
    rng, paths = np.random.default_rng(3), []
    for _ in range(300):
        paths.append(target_paths.draw(np.ones(2), 2000, 0.18, 1.0, rng))
    steps = np.diff(np.array(paths), axis=1)
    speed = np.hypot(steps[..., 0], steps[..., 1]) / 0.02
    still, jumping = (speed == 0).all(axis=1), (speed > 1).any(axis=1)
    assert 50 < still.sum() < 100 and 25 < jumping.sum() < 65
    moving = speed[~still & ~jumping]
    assert moving.max() <= 0.18 + 1e-9 and moving.mean() > 0.05
    stopping = (moving < 1e-6).any(axis=1) & (moving > 0.02).any(axis=1)
    assert 25 < stopping.sum() < 90
    assert all((path[0] == 1).all() for path in paths)


def test_bends_are_no_tighter_than_the_fish_turns():
    rng = np.random.default_rng(5)
    for _ in range(50):
        way = np.diff(target_paths._way(2000, 0.18, 1.0, rng), axis=0)
        length = np.hypot(*way.T)
        kept = (length[1:] > 1e-5) & (length[:-1] > 1e-5)
        heading = np.unwrap(np.arctan2(way[:, 1], way[:, 0]))
        bend = np.abs(np.diff(heading))[kept] / length[1:][kept]
        assert bend.max(initial=0) <= 1 / target_paths.TIGHTEST + 1e-3


def test_drawn_figure_eights_are_smaller_than_that_of_the_trials_and_cross_themselves():
    """No bend of theirs is tighter than the fish's circle with its widest centre, 0.15 m."""
    rng = np.random.default_rng(6)
    for _ in range(50):
        way = target_paths._eight(60_000, 0.18, 1.0, rng)  # some laps
        step = np.diff(way, axis=0)
        length = np.hypot(*step.T)
        assert length.max() <= 0.18 * PERIOD + 1e-9 and way[0] == pytest.approx([0, 0])
        middle = (way.max(axis=0) + way.min(axis=0)) / 2
        along = np.hypot(*(way - middle).T).max()
        assert 0.8 * 0.99 < along < 1.3 * 1.01 < HALF_EIGHT[0]
        chord = np.diff(way[:: round(0.02 / length.max())], axis=0)  # 2 cm each
        heading = np.unwrap(np.arctan2(chord[:, 1], chord[:, 0]))
        assert np.ptp(heading) < 2 * np.pi  # a circle would go on turning
        assert np.abs(np.diff(heading)).max() < 0.02 / 0.15


# ---- replay -------------------------------------------------------------------------------------


def swum(scene: Scene | None) -> tuple[RelabelBuffer, Any]:
    """A buffer of one episode of six fish with fixed actions, and the target of every step."""
    settings = replace(MOVING, sensors=SensorModel())
    env = FishVecEnv(FISH, 6, settings, seed=0, reward_scale=0.01)
    env.world.scene = scene
    spaces = env.observation_space, env.action_space
    buffer = RelabelBuffer(6 * 150, *spaces, "cpu", n_envs=6, source=env, discount=0.99, returns=5)
    seen: Any = env.reset()
    rng, paths = np.random.default_rng(2), [env.world.target.copy()]
    for _ in range(150):
        after: Any
        action = rng.uniform(-1, 1, (6, 6)).astype(np.float32)
        after, reward, done, infos = env.step(action)
        buffer.add(seen, after, action, reward, done, infos)
        paths.append(env.world.target.copy())
        seen = after
    return buffer, np.array(paths)


def test_a_relabelled_swim_is_the_swim_with_that_target():
    """The same noise and actions with the moved path, once relabelled and once really swum."""
    buffer, paths = swum(None)
    assert not (np.hypot(*np.moveaxis(np.diff(paths, axis=0), -1, 0)) > 0.1).any(axis=0).all()
    turn = np.exp(1j * np.linspace(0, 5, 6)).astype(np.complex128)
    move = np.asarray(np.linspace(-0.5, 1, 6) * (1 + 0.3j), np.complex128)
    turn[:2] = 0.0  # two targets stay
    other = turn * in_plane(paths) + move
    start = np.zeros((6, 3))
    way = np.stack([other.real, other.imag], axis=-1).transpose(1, 0, 2)
    scene = Scene(start, np.zeros((6, 3)), way, np.full(6, np.inf))
    truth, _ = swum(scene)
    at = tuple(index.ravel() for index in np.indices((145, 6)))
    found, wanted = buffer._gather(at), truth._gather(at)
    buffer._retarget(found, Paths(turn[at[1]], move[at[1]]))
    for name in ("seen", "next", "reward", "ended"):
        assert getattr(found, name) == pytest.approx(getattr(wanted, name), abs=2e-5), name
    assert wanted.reward.std() > 0.01


def test_new_paths_pass_where_the_fish_went():
    buffer, _ = swum(None)
    buffer.misses = 0.0
    at = tuple(index.ravel() for index in np.indices((100, 6)))
    paths = buffer._later(at)
    size = np.abs(paths.turn)
    assert ((size < 1e-12) | (np.abs(size - 1) < 1e-12)).all()
    assert 0.15 < (size < 0.5).mean() < 0.35
    new = (
        paths.turn[:, None] * in_plane(buffer.target[:, at[1]].swapaxes(0, 1)) + paths.move[:, None]
    )
    apart = np.abs(new - in_plane(buffer.place[:, at[1]].swapaxes(0, 1)))
    assert apart.min(axis=1).max() < 1e-5
