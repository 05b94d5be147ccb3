"""Slow averages of a policy's own signals: what they are, what they depend on, what they show."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from support import complaint

pytest.importorskip("gymnasium", reason="the train extra is not installed")
pytest.importorskip("torch", reason="the train extra is not installed")

from tailbeat.control import averages
from tailbeat.control.averages import Averages
from tailbeat.control.measure import PAPER, Measure
from tailbeat.control.observation import AVERAGED, AVERAGES, REMEMBERING, Samples, observe, table
from tailbeat.env import randomize
from tailbeat.env.curriculum import averages_of, velocity_filter
from tailbeat.env.errors import NONE, Errors
from tailbeat.env.sensors import quiet
from tailbeat.env.task import Settings, Task
from tailbeat.env.world import World
from tailbeat.files import BadInput
from tailbeat.fish.store import load_fish
from tailbeat.train.config import RunConfig, begin
from tailbeat.train.recipes import recipe_of

FISH = load_fish("pulley-fish-pool")
HALF = Measure(0.5, 0.4, 0.5, 0.125)
KINDS: Any = {"motion": velocity_filter(PAPER), "averages": averages_of(PAPER)}
STILL = Settings(task=Task(), sensors=quiet(), physics=randomize.none(), **KINDS)
SCALES = np.array([one.scale for one in REMEMBERING])


def samples(count: int = 5) -> Any:
    rng = np.random.default_rng(0)
    shapes: Any = (), (), (), (), (3, 2), (3, 6), (4,)
    return Samples(*(rng.uniform(-1, 1, (count, *shape)) for shape in shapes))


@pytest.mark.parametrize("steps", [np.full(200, 0.02), np.tile([0.01, 0.07], 50)])
def test_a_steady_signal_is_approached_as_by_a_low_pass_however_late_the_steps(steps):
    """1 - exp(-t / T) after t = 4 s, with T = 1 and 4 s."""
    raw, state = samples(), averages.begin(5)
    for elapsed in steps:
        state = averages.update(Averages(), state, raw, np.zeros(5), elapsed)
    seen = observe(replace(raw, averages=state))[:, 28:].reshape(5, 2, 7) * SCALES[28:35]
    signals = [
        raw.yaw_rate, raw.commands[:, 0, 1], np.sin(raw.motor_angle), raw.motion[:, 2],
        raw.motion[:, 3], np.abs(raw.motor_velocity), np.abs(raw.motor_angle),
    ]  # fmt: skip
    for row, (entry, signal) in enumerate(zip(AVERAGED, signals, strict=True)):
        for span, seconds in enumerate((1.0, 4.0)):
            wanted = (1 - np.exp(-4.0 / seconds)) * signal
            assert seen[:, span, row] == pytest.approx(wanted, abs=1e-5), entry.name


def test_a_lag_is_the_short_way_round():
    raw = replace(samples(1), motor_angle=np.array([3.0]))
    state = averages.update(Averages(), averages.begin(1), raw, np.array([-3.0]), 1e9)
    assert state[0, :, 6] == pytest.approx(2 * np.pi - 6.0)


def test_similar_swims_look_alike():
    """Lengths by the reach, times by the time: a small fish sees what the paper's sees."""
    raw, large, small = samples(), averages.begin(5), averages.begin(5)
    alike = replace(raw, yaw_rate=raw.yaw_rate / HALF.time, motion=raw.motion * HALF.speed)
    for _ in range(50):
        large = averages.update(averages_of(PAPER), large, raw, np.ones(5), 0.02)
        short = 0.02 * HALF.time
        small = averages.update(averages_of(HALF), small, alike, np.ones(5), short)
    seen = observe(replace(alike, averages=small), HALF)[:, 24:]
    assert seen == pytest.approx(observe(replace(raw, averages=large))[:, 24:], abs=1e-6)
    assert [one.name for one in table(HALF, "camera", True, True)[28:]] == [
        one.name for one in AVERAGES
    ]
    assert table(HALF, "camera", True, True)[28].source == "camera"


# ---- in a swim ----------------------------------------------------------------------------------


def swum(worlds: World, steps: int = 200, left: float = 0.2) -> Any:
    """The averages (n, 2, 7) that fish observe at the end of a swim."""
    worlds.reset()
    action = np.tile([0.0, left, 0.6, 0.0, 0.0, 0.0], (worlds.count, 1))
    for _ in range(steps):
        done = worlds.step(action)
    return (done.observation * SCALES)[:, 28:].reshape(-1, 2, 7)


def test_they_do_not_depend_on_the_target():
    """So a replayed swim keeps them when it gets another target."""
    near, far = (
        World(FISH, replace(STILL, task=Task(nearest=d, farthest=d + 0.1)), [3]) for d in (1.0, 2.0)
    )
    assert np.array_equal(swum(near), swum(far)) and np.abs(near.target - far.target).max() > 0.5


def test_a_mirrored_swim_has_mirrored_averages():
    signs = np.array([-1, -1, -1, 1, -1, 1, 1])
    left, right = swum(World(FISH, STILL, [3]), left=0.2), World(FISH, STILL, [3])
    right.reset()
    flip = np.where(np.arange(6) == 0, 1.0, -1.0)
    action = np.array([[0.0, 0.2, 0.6, 0.0, 0.0, 0.0]]) * flip
    for _ in range(200):
        done = right.step(action)
    found = (done.observation * SCALES)[:, 28:].reshape(-1, 2, 7)
    assert found * signs == pytest.approx(left, abs=1e-4)
    assert np.abs(left).min() > 1e-3


def test_a_wrong_encoder_shows_in_the_slow_average_and_a_wrong_gyro_too():
    """An encoder off by 8 degrees moves the shaft's mean by them; a gyro's bias of 0.1 rad/s adds
    to the mean yaw rate, up to the low-pass's start."""
    wrong = [NONE, Errors(encoder=np.radians(8)), Errors(yaw_rate_bias=0.1)]
    right, encoder, gyro = swum(World(FISH, STILL, [3, 3, 3], wrong=wrong), left=0.0)[:, 1]
    risen = 1 - np.exp(-200 * 0.02 / 4.0)
    assert encoder[2] - right[2] == pytest.approx(risen * np.radians(8), rel=0.1)
    assert gyro[0] - right[0] == pytest.approx(risen * 0.1, rel=0.02)


def test_a_new_episode_begins_without_a_past():
    world = World(FISH, STILL, [3, 4])
    assert np.abs(swum(world)).max() > 0.1
    seen = world.reset(np.array([True, False]))
    assert not seen[0, 28:].any() and seen[1, 28:].any()


# ---- training -----------------------------------------------------------------------------------


def test_the_option_adds_velocities_and_averages_and_nothing_else(tmp_path):
    plain, more = (
        RunConfig(FISH, tmp_path, recipe_of("smoke"), averages=one) for one in (False, True)
    )
    assert more.settings(0) == replace(plain.settings(0), **KINDS)
    assert more.buffer_bytes - plain.buffer_bytes == 4 * 2 * (42 - 24) * plain.recipe.buffer


def test_a_run_without_averages_is_not_resumed_with_them(tmp_path):
    words = ["train", "--fish", "pulley-fish-pool", "--recipe", "smoke", "--out", tmp_path / "run"]
    begin(RunConfig(FISH, tmp_path / "run", recipe_of("smoke")))
    said = complaint(*map(str, words), "--resume", "--averages")
    assert "averages was False, now True" in said


def test_averages_without_velocities_are_refused():
    with pytest.raises(BadInput, match="averages: they are of velocities too; give motion"):
        World(FISH, replace(STILL, motion=None), [0])
