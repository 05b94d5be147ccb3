"""The environment: batch equals single, draws never add up, checkers pass, bad settings refused."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from mujoco import batch

pytest.importorskip("stable_baselines3", reason="the train extra is not installed")

from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as check_sb3

from tailbeat.control.actions import PERIOD, Direct, Generator
from tailbeat.control.observation import TABLE
from tailbeat.env import randomize, sensors
from tailbeat.env.randomize import Randomisation
from tailbeat.env.sensors import SensorModel, quiet
from tailbeat.env.task import Scene, Settings, Task, check_settings
from tailbeat.env.vector_env import FishEnv, FishVecEnv, FishVectorEnv
from tailbeat.env.world import World
from tailbeat.files import BadInput
from tailbeat.fish.store import load_fish
from tailbeat.fish.twin import compile_twin

FISH = load_fish("pulley-fish")
STILL = Settings(sensors=quiet(), physics=randomize.none())
COLUMN = {entry.name: i for i, entry in enumerate(TABLE)}


def played(world: World, actions: np.ndarray) -> list[np.ndarray]:
    """States after each step, and observations, rewards."""
    world.reset()
    found, body = [], world.simulator
    for action in actions:
        done = world.step(action)
        found.append(
            np.concatenate([body.qpos, body.qvel, done.observation, done.reward[:, None]], axis=1)
        )
    return found


def random_actions(steps: int, count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1, 1, (steps, count, 6))


def test_a_batch_equals_its_members_at_any_number_of_threads():
    actions = random_actions(60, 5)
    seeds = [11, 22, 33, 44, 55]
    together = played(World(FISH, Settings(), seeds, threads=2), actions)
    again = played(World(FISH, Settings(), seeds, threads=1), actions)
    assert all(np.array_equal(a, b) for a, b in zip(together, again, strict=True))
    for i in (0, 3):
        alone = played(World(FISH, Settings(), seeds[i : i + 1]), actions[:, i : i + 1])
        assert all(np.array_equal(a[0], b[i]) for a, b in zip(alone, together, strict=True))


def test_two_worlds_share_nothing():
    one, two = (World(FISH, Settings(), [7]) for _ in range(2))
    one.reset(), two.reset()
    for _ in range(5):
        one.step(np.ones((1, 6)))
    assert np.all(two.simulator.qpos == 0) and two.age[0] == 0
    assert np.abs(one.simulator.qpos).max() > 0


def test_fish_that_end_begin_anew_and_the_others_go_on():
    env = FishVectorEnv(FISH, 4, replace(STILL, task=Task(seconds=0.2)), seed=0)
    env.reset(seed=0)
    env.world.age[:2] = 5
    for _ in range(5):
        seen, _, _, truncated, info = env.step(np.zeros((4, 6)))
    assert truncated.tolist() == [True, True, False, False]
    assert env.world.age.tolist() == [0, 0, 5, 5]
    assert not np.array_equal(info["final_obs"][0], seen[0])
    assert np.array_equal(info["final_obs"][2], seen[2])


def test_the_reward_is_the_paper_s_and_arrival_ends_an_episode():
    world = World(FISH, STILL, [0, 1])
    world.reset()
    action = np.array([[0.5, 0.1, -0.3, 0.2, 0.9, -1.0]] * 2)
    world.target[1] = world.pose[1, :2] + [0.03, 0.0]
    done = world.step(action)
    distance = np.linalg.norm(world.target - world.pose[:, :2], axis=1)
    expected = -distance - 0.1 * np.linalg.norm(action, axis=1) + [0.0, 1000.0]
    assert done.reward == pytest.approx(expected)
    assert done.reached.tolist() == [False, True] and done.terminated.tolist() == [False, True]


def test_out_of_range_is_a_truncation_not_an_escape():
    near = replace(STILL, task=Task(nearest=0.1, farthest=0.15, limit=0.16))
    env = FishVectorEnv(FISH, 1, near, seed=0)
    env.reset(seed=0)
    for _ in range(300):
        *_, reward, terminated, truncated, info = env.step(np.array([[0.0, 0.0, 0.0, 1, 0, 0]]))
        if terminated[0] or truncated[0]:
            break
    assert truncated[0] and not terminated[0] and "final_obs" in info and reward[0] < 0


def test_targets_lie_where_the_task_says():
    task = Task(nearest=0.8, farthest=1.5, arc=0.5)
    world = World(FISH, replace(STILL, task=task), list(range(200)))
    world.reset()
    away = world.target - world.pose[:, :2]
    distance, bearing = np.hypot(*away.T), np.arctan2(away[:, 1], away[:, 0])
    assert 0.8 <= distance.min() and distance.max() <= 1.5 and np.ptp(distance) > 0.6
    assert np.abs(bearing).max() <= 0.5 and np.ptp(bearing) > 0.8


def test_targets_behind_a_fish_lie_on_both_sides_and_come_of_the_same_draws():
    def bearings(least: float) -> np.ndarray:
        task = Task(arc=3.0, least_arc=least)
        world = World(FISH, replace(STILL, task=task), list(range(200)))
        world.reset()
        ahead, left = (world.target - world.pose[:, :2]).T
        return np.arctan2(left, ahead)

    everywhere, behind = bearings(0.0), bearings(2.5)
    off = np.abs(behind)
    assert 2.5 <= off.min() < 2.55 and 2.95 < off.max() <= 3.0
    assert np.array_equal(np.sign(behind), np.sign(everywhere))
    assert np.allclose(off, 2.5 + np.abs(everywhere) / 6)


@pytest.mark.parametrize(("away", "kept"), [(0.2, True), (0.5, False)])
def test_a_target_that_goes_on_ends_nothing_and_counts_when_it_was_kept(away, kept):
    task = Task(nearest=away, farthest=away, arrival=0.1, seconds=10.0, follow=True)
    world = World(FISH, replace(STILL, task=task), [0, 1])
    world.reset()
    world.paths[:] = world.target[:, None]
    done = [world.step(np.zeros((2, 6))) for _ in range(500)]
    assert not any(one.terminated.any() for one in done) and done[-1].truncated.all()
    lost = 2.0 * away + 12.0 * away / 1.5  # at rest, though it should be there in 1.5 s
    assert done[50].terms.bonus == pytest.approx([-lost, -lost], abs=0.05)
    assert not done[-2].reached.any() and (done[-1].reached == kept).all()


def test_an_undisturbed_observation_is_the_truth():
    world = World(FISH, STILL, [3])
    world.reset()
    for action in random_actions(40, 1):
        seen = world.step(action).observation[0]
    exact = world.simulator.qpos[0, world.simulator.motor]
    assert seen[COLUMN["sin motor angle"]] == pytest.approx(np.sin(exact), abs=1e-6)
    assert seen[COLUMN["yaw rate"]] * 2.0 == pytest.approx(world.simulator.qvel[0, 2], abs=1e-5)
    age = seen[COLUMN["frame 0 (newest): staleness"]] * 0.1
    assert -1e-6 <= age < 1 / 60 + 1e-6
    distance = np.linalg.norm(world.target - world.pose[:, :2])
    shown = seen[COLUMN["frame 0 (newest): target distance"]] * 2.0
    assert shown == pytest.approx(distance, abs=0.02)  # as old as the frame is


# ---- sensors ------------------------------------------------------------------------------------


def watched(model: SensorModel, steps: int = 600) -> tuple[np.ndarray, np.ndarray]:
    """Staleness of the newest frame and yaw-rate readings of a fish that does not move."""
    state = sensors.empty(1, steps)
    sensors.begin(model, state, 0, np.zeros(3), np.array([1.0, 0.0]), np.random.default_rng(0))
    pose, zero = np.zeros((1, 3)), np.zeros(1)
    place = np.array([[1.0, 0.0]])
    still = sensors.Motion(pose, pose, place, place, zero, zero, zero)
    age, gyro = [], []
    for step in range(steps):
        reading = sensors.sense(model, state, np.array([step]), still)
        age.append(reading.frames[0, :, 5])
        gyro.append(reading.yaw_rate[0])
    return np.array(age), np.array(gyro)


def test_frames_come_late_uneven_and_with_gaps():
    model = SensorModel(stamp_noise=0.0)
    age, gyro = watched(model)
    newest = age[20:, 0]
    assert newest.min() >= model.latency - 1e-9
    assert newest.mean() == pytest.approx(model.latency + 0.0075 + 0.5 / 60, abs=0.006)
    assert newest.max() > model.latency + model.latency_jitter + 1 / 60  # a dropped frame
    assert np.all(np.diff(age[20:], axis=1) > 0)  # newest first
    assert np.std(gyro) > model.yaw_rate_noise * 0.8


def test_a_frame_shows_a_moving_target_where_it_was_then_and_one_that_jumps_at_one_place():
    """The target was that of the step's end: up to 20 ms ahead of the fish in the same frame."""
    ways = np.zeros((2, 61, 2))
    ways[0, :, 0] = 0.3 * PERIOD * np.arange(61)
    ways[1, 31:, 0] = 1.0
    scene = Scene(np.zeros((2, 3)), np.zeros((2, 3)), ways, np.full(2, np.inf))
    world, seen = World(FISH, STILL, [1, 2], scene=scene), set()
    world.reset()
    for step in range(1, 61):
        frames = world.step(np.zeros((2, 6))).frames[:, 0]
        if step > 2:
            assert frames[0, 3] == pytest.approx(0.3 * (step * PERIOD - frames[0, 5]), abs=1e-9)
        seen |= {float(frames[1, 3])}
    assert seen == {0.0, 1.0}


# ---- randomisation ------------------------------------------------------------------------------


def drawn(ranges: Randomisation, seeds: range) -> randomize.Physics:
    world = World(FISH, replace(STILL, physics=ranges), list(seeds))
    for _ in range(20):
        world.reset()
    return world.simulator.physics


def test_draws_stay_in_their_bands_after_many_resets():
    """Twenty episodes of twenty fish: had draws accumulated, they would have left the bands."""
    ranges = Randomisation()
    physics = drawn(ranges, range(20))
    head = physics.twin.model.body("head").id
    for name, part, width in (
        ("body_mass", head, ranges.head_mass),
        ("jnt_stiffness", slice(4, None), ranges.tail_stiffness),
        ("dof_damping", slice(4, None), ranges.tail_damping),
        ("actuator_gainprm", (0, 0), ranges.servo_gain),
        ("opt.density", (), ranges.density),
    ):
        place = part if isinstance(part, tuple) else (part,)
        values = physics.fields[name][(slice(None), *place)]
        ratio = np.asarray(values / physics.nominal[name][place])
        assert np.abs(ratio - 1).max() <= width + 1e-9, name
        assert np.ptp(ratio) > 0.5 * width, name
    wet = physics.nominal["geom_fluid"][:, 1] > 0
    fluid = physics.fields["geom_fluid"][:, wet, 1:6] / physics.nominal["geom_fluid"][wet, 1:6]
    assert np.abs(fluid - 1).max() <= ranges.fluid + 1e-9 < np.ptp(fluid)


def test_zones_of_equal_values_are_drawn_apart_and_parts_of_a_zone_together():
    fish = load_fish("crank-fish")
    assert len(set(fish.zones.values())) == 1 < len(fish.zones)
    twin = compile_twin(fish)
    physics = randomize.expand(twin, batch.Batch(twin.model, 1))
    randomize.randomize(physics, Randomisation(), 0, np.random.default_rng(0))
    drawn = [physics.fields["geom_fluid"][0, twin.zones == z, 1:6] for z in range(len(fish.zones))]
    assert len(np.unique([rows[0] for rows in drawn], axis=0)) == len(fish.zones)
    assert all(np.array_equal(rows, np.tile(rows[0], (len(rows), 1))) for rows in drawn)


def test_a_posterior_s_draws_are_drawn_whole_and_reach_as_far_as_the_stage_allows():
    """Zones of one draw belong together: the recordings tie them to each other."""
    twin = compile_twin(FISH)
    draws = np.random.default_rng(1).lognormal(0, 0.5, (4, len(FISH.zones), 5))
    wet = twin.zones >= 0
    for share in (0.0, 0.5, 1.0):
        physics = randomize.expand(twin, batch.Batch(twin.model, 40), draws)
        ranges = replace(Randomisation(), fluid=share * Randomisation.fluid)
        for fish in range(40):
            randomize.randomize(physics, ranges, fish, np.random.default_rng(fish))
        nominal = physics.nominal["geom_fluid"][wet, 1:6]
        ratio = physics.fields["geom_fluid"][:, wet, 1:6] / np.where(nominal > 0, nominal, 1.0)
        allowed = np.where(nominal > 0, 1 + share * (draws[:, twin.zones[wet]] - 1), 0.0)
        own = np.abs(ratio[:, None] - allowed).max(axis=(2, 3)).argmin(axis=1)
        assert ratio == pytest.approx(allowed[own], abs=1e-12)
        assert len(set(own.tolist())) == (1 if share == 0 else len(draws))


@pytest.mark.parametrize("name", list(Randomisation.__annotations__))
def test_every_draw_changes_the_motion(name):
    if name == "push_share":
        pytest.skip("how often, not how much: `push` shows it")
    value: dict[str, Any] = {name: getattr(Randomisation(), name)}
    if name == "push":
        value["push_share"] = 0.2
    only = replace(randomize.none(), **value)
    # a stroke large and quick enough to meet the servo's limit
    space = Generator(-1.39, 1.39, first=1.3)
    actions = np.tile([0.0, 0.1, 0.0, 1.0, 0.0, 0.0], (100, 1, 1))
    ends = []
    for ranges in (randomize.none(), only):
        world = World(FISH, replace(STILL, physics=ranges, actions=space), [5])
        ends.append(played(world, actions)[-1][:, :9])
    assert np.abs(ends[1] - ends[0]).max() > 1e-6


# ---- faces --------------------------------------------------------------------------------------


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_the_checkers_pass():
    env = FishEnv(FISH, replace(STILL, task=Task(seconds=1.0)), render_mode="rgb_array")
    check_env(env, skip_render_check=False)
    check_sb3(FishEnv(FISH, seed=1))


def test_a_picture_shows_fish_and_target():
    env = FishEnv(FISH, STILL, seed=0, render_mode="rgb_array")
    env.reset(seed=0)
    empty = env.render()
    for _ in range(50):
        env.step(np.array([0.0, 0.2, 0.0, 1.0, 0.0, 0.0]))
    moved = env.render()
    assert empty is not None and moved is not None
    assert moved.shape == (480, 480, 3) and moved.dtype == np.uint8
    assert (moved != empty).any(axis=2).sum() > 100


def test_a_picture_from_beside_shows_the_looks():
    env = FishEnv(FISH, STILL, seed=0, render_mode="rgb_array", view="beside")
    env.reset(seed=0)
    image = env.render()
    assert image is not None and image.shape[2] == 3
    assert image.std() > 5  # something other than water


def test_sb3_sees_last_sights_and_timeouts():
    env = FishVecEnv(FISH, 3, replace(STILL, task=Task(seconds=0.1)), seed=0)
    env.seed(4)
    first = np.asarray(env.reset())
    for _ in range(5):
        seen, reward, done, infos = env.step(np.zeros((3, 6)))
    assert done.all() and all(info["TimeLimit.truncated"] for info in infos)
    assert infos[0]["terminal_observation"].shape == (24,)
    assert infos[0]["episode"]["l"] == 5
    assert reward.dtype == np.float32 and np.asarray(seen).shape == first.shape
    env.seed(4)
    assert np.array_equal(np.asarray(env.reset()), first)


@pytest.mark.thorough
def test_sac_of_sb3_learns_on_it_without_complaint():
    from stable_baselines3 import SAC

    env = FishVecEnv(FISH, 8, Settings(), seed=0)
    model = SAC("MlpPolicy", env, learning_starts=64, batch_size=32, seed=0, device="cpu")
    model.learn(160)
    assert model.num_timesteps >= 160


@pytest.mark.thorough
def test_nothing_is_lost_in_random_swims():
    env = FishVectorEnv(FISH, 32, replace(Settings(), task=Task(walls=(5.5, 2.7))), seed=0)
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    for _ in range(400):
        seen, reward, *_ = env.step(rng.uniform(-1, 1, (32, 6)))
        assert np.isfinite(seen).all() and np.isfinite(reward).all()
    assert env.world.simulator.warned.sum() == 0


@pytest.mark.slow
def test_a_million_control_steps_leave_no_trace():
    import resource

    env = FishVectorEnv(FISH, 64, seed=0)
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    memory = []
    for step in range(1_000_000 // 64):
        seen, *_ = env.step(rng.uniform(-1, 1, (64, 6)))
        if step % 1000 == 0:
            assert np.isfinite(seen).all()
            memory.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
    assert memory[-1] - memory[2] < 20_000  # kB
    assert env.world.simulator.warned.sum() == 0


# ---- bad settings -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("settings", "complaint"),
    [
        (Settings(task=Task(nearest=0.01)), "arrival < nearest"),
        (Settings(task=Task(farthest=9.0)), "above limit 6 m"),
        (Settings(task=Task(nearest=2.0, walls=(5.5, 2.7))), "fits into walls"),
        (Settings(task=Task(arc=4.0)), "allowed are 0 to pi"),
        (Settings(task=Task(arc=1.0, least_arc=1.5)), "bearings from 1.5 to 1 rad"),
        (Settings(actions=Generator(-1.0, 1.0, ceiling=6.0)), "identified band ends at 4 Hz"),
        (Settings(actions=Direct(-3.0, 3.0)), "motor allows -1.396 to 1.396|motor allows -1.39"),
        (Settings(physics=Randomisation(fluid=1.2)), "fluid = 1.2; allowed"),
    ],
)
def test_settings_that_contradict_are_refused(settings, complaint):
    with pytest.raises(BadInput, match=complaint):
        check_settings(FISH, settings)


def test_bad_actions_are_refused():
    world = World(FISH, STILL, [0])
    world.reset()
    with pytest.raises(BadInput, match="generator takes"):
        world.step(np.zeros((1, 5)))
    with pytest.raises(BadInput, match="give finite numbers"):
        world.step(np.full((1, 6), np.inf))
