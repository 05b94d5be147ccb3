"""Policies that reach and observe velocities: what an askew tag does to what they see, and how
they are trained."""

from dataclasses import replace

import numpy as np
import pytest

from policies import POLICIES
from support import complaint

pytest.importorskip("gymnasium", reason="the train extra is not installed")
pytest.importorskip("torch", reason="the train extra is not installed")

from tailbeat.control.actions import Generator
from tailbeat.control.measure import PAPER
from tailbeat.control.policy import load_policy
from tailbeat.env import randomize, tours
from tailbeat.env.curriculum import STAGES, velocity_filter
from tailbeat.env.errors import NONE, Errors
from tailbeat.env.randomize import Randomisation
from tailbeat.env.sensors import quiet
from tailbeat.env.task import Settings, Task
from tailbeat.env.world import World
from tailbeat.fish.store import load_fish
from tailbeat.pool import mess
from tailbeat.train.config import RunConfig, begin, check
from tailbeat.train.recipes import recipe_of
from tailbeat.train.spaces import action_space

FISH = load_fish("pulley-fish-pool")
ASKEW = np.radians(12)
FRONT, OWN = slice(13, 15), slice(26, 28)  # the newest frame's target, and the own velocity


def direction(seen, where):
    ahead, left = seen[:, where].astype(float).T
    return np.arctan2(left, ahead)


def test_an_askew_tag_turns_bearing_and_course_alike():
    """So their difference tells the way to the target whatever the tag's angle. A bearing alone is
    off by all of it."""
    still = Settings(
        task=Task(farthest=2.5), sensors=quiet(), physics=randomize.none(),
        motion=velocity_filter(PAPER),
    )  # fmt: skip
    world = World(FISH, still, [3, 3], wrong=[NONE, Errors(askew=ASKEW)])
    world.reset()
    for _ in range(150):
        done = world.step(np.tile([0.0, 0.2, 0.6, 0.0, 0.0, 0.0], (2, 1)))
    bearing, course = (direction(done.observation, where) for where in (FRONT, OWN))
    apart = (np.diff(bearing) + np.pi) % (2 * np.pi) - np.pi
    assert apart[0] == pytest.approx(-ASKEW, abs=1e-3)
    assert np.diff(course)[0] == pytest.approx(-ASKEW, abs=1e-3)
    assert np.hypot(*world.simulator.qvel[0, :2]) > 0.1  # it swims, so it has a course


def run(out, **changed):
    return RunConfig(FISH, out, recipe_of("smoke"), seed=0, **changed)


def test_the_option_adds_velocities_and_nothing_else(tmp_path):
    plain, more = (run(tmp_path, velocities=v).settings(0) for v in (False, True))
    assert plain.motion is None and more == replace(plain, motion=velocity_filter(PAPER))
    last = RunConfig(FISH, tmp_path, velocities=True).settings(len(STAGES) - 1)
    assert not last.task.follow and last.task.target_speed == 0


KEPT = sorted(name for name in POLICIES if "-velocities-" in name)


def test_there_are_three_seeds():
    assert len(KEPT) == 3


@pytest.mark.parametrize("name", KEPT)
def test_a_policy_that_reaches_is_not_taken_for_one_that_follows(name):
    contract = load_policy(POLICIES[name]).contract
    assert contract.motion is not None and len(contract.observation) == 28
    task = tours.settings(contract, 60.0).task
    assert not task.follow and task.target_speed == 0


def test_a_run_without_velocities_is_not_resumed_with_them(tmp_path):
    words = ["train", "--fish", "pulley-fish-pool", "--recipe", "smoke", "--out", tmp_path / "run"]
    begin(run(tmp_path / "run"))
    said = complaint(*map(str, words), "--resume", "--velocities")
    assert "velocities was False, now True" in said


def test_a_run_of_before_the_wider_centre_goes_on_with_its_own(tmp_path):
    usual, older = (action_space(None, FISH, centre=c) for c in (None, 0.8))
    assert isinstance(usual, Generator)
    assert usual.offset == pytest.approx(1.2) and older == replace(usual, offset=0.8)
    words = ["train", "--fish", "pulley-fish-pool", "--out", tmp_path / "run", "--resume"]
    begin(RunConfig(FISH, tmp_path / "run", actions=older))
    said = complaint(*map(str, words))
    assert "actions.offset was 0.8, now 1.2" in said and "Give the options" in said
    check(RunConfig(FISH, tmp_path / "run", actions=older), resume=True)
    for wrong in (["--centre", "-1"], ["--centre", "0.8", "--actions", "direct"]):
        assert "only of generator actions" in complaint(*map(str, words), *wrong)


# ---- how wrong fish are built -------------------------------------------------------------------


def test_a_build_has_a_lab_s_sizes_and_is_never_narrower_than_the_usual_ranges():
    usual, rough = Randomisation(), mess.build(mess.level("rough"))
    assert mess.build(mess.level("clean")) == usual
    assert (rough.tail_stiffness, rough.servo_limit) == pytest.approx((0.4, 0.4))
    assert (rough.head_mass, rough.fluid, rough.current) == pytest.approx((0.3, 0.3, 0.06))
    assert rough.servo_damping == usual.servo_damping and rough.push == usual.push
    assert all(getattr(rough, name) >= width for name, width in vars(usual).items())
    randomize.check(mess.build(mess.level("wrecked")))


def test_a_run_draws_the_build_in_its_stages_shares(tmp_path):
    wide = mess.build(mess.level("rough"))
    plain, built = (RunConfig(FISH, tmp_path, build=one) for one in (None, wide))
    first, third, last = (built.settings(i) for i in (0, 3, len(STAGES) - 1))
    assert first == plain.settings(0) and last.physics == wide
    assert third.physics.tail_stiffness == pytest.approx(0.4 / 3)
    assert replace(last, physics=plain.settings(len(STAGES) - 1).physics) == plain.settings(
        len(STAGES) - 1
    )


def test_a_run_is_not_resumed_with_another_build_and_levels_are_named(tmp_path):
    words = ["train", "--fish", "pulley-fish-pool", "--recipe", "smoke", "--out", tmp_path / "run"]
    begin(run(tmp_path / "run"))
    said = complaint(*map(str, words), "--resume", "--build", "rough")
    assert "build.tail_stiffness was None, now 0.4" in said
    assert "mess 'odd': allowed are clean, everyday" in complaint(
        *map(str, words), "--build", "odd"
    )
