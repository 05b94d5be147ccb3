"""Robots that are worse than their description, and critics that know how each is built."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("stable_baselines3", reason="the train extra is not installed")

import torch
from mujoco import batch

from support import tailbeat
from tailbeat.control.policy import decide, load_policy
from tailbeat.env import randomize
from tailbeat.env.hardship import Hardship, harden
from tailbeat.env.hidden import HIDDEN, hidden
from tailbeat.env.randomize import Physics
from tailbeat.env.sensors import quiet
from tailbeat.env.task import Settings, check_settings
from tailbeat.env.vector_env import FishVecEnv
from tailbeat.env.world import World
from tailbeat.files import BadInput
from tailbeat.fish.store import load_fish
from tailbeat.fish.twin import compile_twin
from tailbeat.pool import mess
from tailbeat.train import train as training
from tailbeat.train.config import RunConfig, check
from tailbeat.train.export import act, export
from tailbeat.train.recipes import paper, quick, smoke

FISH = load_fish("pulley-fish-pool")
WRECKED = mess.hardship(mess.level("wrecked"))
STILL = Settings(sensors=quiet(), physics=randomize.none())


def drawn(hard: Hardship, count: int = 60, twice: bool = False) -> Physics:
    """The physics of fish that were drawn with these hardships, once or twice over."""
    twin = compile_twin(FISH)
    physics = randomize.expand(twin, batch.Batch(twin.model, count))
    for fish in range(count):
        for seed in range(2 if twice else 1)[::-1]:
            rng = np.random.default_rng([fish, seed])
            randomize.randomize(physics, randomize.none(), fish, rng)
            harden(physics, hard, fish, rng)
    return physics


def test_sizes_are_those_of_a_level_and_a_servo_also_fades():
    assert WRECKED.torque == WRECKED.gain == pytest.approx(1.6 * 1.36 - 1)
    assert (WRECKED.friction, WRECKED.pull) == pytest.approx((0.3, 0.06))
    assert (WRECKED.sticking, WRECKED.bend) == pytest.approx(np.radians([9, 15]))
    none = mess.hardship(mess.level("clean"))
    assert none == Hardship(none.share, none.full, none.farthest)


def test_draws_stay_in_their_sizes_reach_them_and_do_not_add_up():
    hard = replace(WRECKED, share=1.0)
    physics, again = drawn(hard), drawn(hard, twice=True)
    for name, values in physics.fields.items():
        assert np.array_equal(values, again.fields[name]), name
    fields, usual = physics.fields, physics.nominal
    torque = fields["actuator_forcerange"][:, 0, 1] / usual["actuator_forcerange"][0, 1]
    gain = fields["actuator_gainprm"][:, 0, 0] / usual["actuator_gainprm"][0, 0]
    assert np.array_equal(fields["actuator_biasprm"][:, 0, 1], -fields["actuator_gainprm"][:, 0, 0])
    stiffness = fields["jnt_stiffness"][:, -1] / usual["jnt_stiffness"][-1]
    rub = fields["dof_frictionloss"][:, 3] - usual["dof_frictionloss"][3]
    bend = (fields["qpos_spring"] - usual["qpos_spring"]).sum(axis=1)
    sticking = (fields["dof_frictionloss"][:, 4:] / fields["jnt_stiffness"][:, 4:]).sum(axis=1)
    for values, low, high in (
        (torque, 1 / (1 + hard.torque), 1.0),
        (gain, 1 / (1 + hard.gain), (1 + hard.gain) ** 0.25),
        (stiffness, (1 + hard.stiffness) ** -0.5, 1 + hard.stiffness),
        (physics.fins, 1 / (1 + hard.fin), (1 + hard.fin) ** 0.5),
        (rub, 0.0, hard.friction),
        (sticking, 0.0, hard.sticking),
        (bend, -hard.bend, hard.bend),
    ):
        assert low - 1e-9 <= values.min() and values.max() <= high + 1e-9
        assert np.ptp(values) > 0.8 * (high - low)


def test_in_full_every_size_is_a_whole_one_as_in_a_lab():
    """Factors are their worst or their best, the rest is there at full size. Half of them are."""
    hard = replace(WRECKED, share=1.0, full=1.0)
    physics = drawn(hard)
    fields, usual = physics.fields, physics.nominal
    torque = fields["actuator_forcerange"][:, 0, 1] / usual["actuator_forcerange"][0, 1]
    rub = fields["dof_frictionloss"][:, 3] - usual["dof_frictionloss"][3]
    bend = (fields["qpos_spring"] - usual["qpos_spring"]).sum(axis=1)
    assert rub == pytest.approx(np.full(60, hard.friction))
    for values, ends in (
        (torque, (1 / (1 + hard.torque), 1.0)),
        (physics.fins, (1 / (1 + hard.fin), (1 + hard.fin) ** 0.5)),
        (bend, (-hard.bend, hard.bend)),
    ):
        assert np.unique(np.round(values, 9)) == pytest.approx(ends)
    some = drawn(replace(WRECKED, share=1.0, full=0.5), 200)
    whole = some.fields["dof_frictionloss"][:, 3] - usual["dof_frictionloss"][3] > 0.3 - 1e-9
    assert 70 < whole.sum() < 130


def test_targets_of_the_polish_are_as_far_away_as_a_pool_is_long(tmp_path):
    """A policy that had met none beyond 2.5 m rested at 4 m. From another run's networks the polish
    is half as long."""
    run = RunConfig(FISH, tmp_path, quick(), hard=WRECKED)
    assert run.settings(9).task.farthest == 2.5
    polished = run.settings(9, polishing=True)
    assert polished.task.farthest == 4.0 and polished.hard is not None
    small = replace(run, measure=replace(run.measure, reach=0.5))
    assert small.settings(9, polishing=True).task.farthest == 2.0
    assert replace(run, start=tmp_path).polish * 2 == run.polish == 40_000


def test_a_share_of_robots_is_as_described():
    physics = drawn(replace(WRECKED, share=0.5), 200)
    rubs = physics.fields["dof_frictionloss"] - physics.nominal["dof_frictionloss"]
    usual = (rubs == 0).all(axis=1)
    assert 70 < usual.sum() < 130
    for name, values in physics.fields.items():
        assert (values[usual] == physics.nominal[name]).all(), name


def swum(hard: Hardship | None, action: np.ndarray, seeds: int = 12) -> np.ndarray:
    """Where fish are after 6 s of one action (n, 3): ahead, left, heading."""
    world = World(FISH, replace(STILL, hard=hard), list(range(seeds)))
    world.reset()
    for _ in range(300):
        world.step(np.tile(action, (seeds, 1)))
    return np.array(world.simulator.qpos[:, :3])


BEAT = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0])  # 2 Hz with the whole first harmonic


@pytest.mark.parametrize(
    ("name", "most"),
    [("torque", 0.95), ("gain", 0.95), ("fin", 0.95), ("friction", 0.95), ("sticking", 0.99)],
)
def test_each_hardship_alone_slows_the_fish(name, most):
    """There is less force from the tail, or from the fins. A tail that sticks is hardly slower at a
    large stroke."""
    size = 4.0 * getattr(WRECKED, name)  # the wrecked torque alone still drives this beat
    ahead = swum(Hardship(share=1.0, **{name: size}), BEAT)[:, 0]
    described = swum(None, BEAT)[0, 0]
    assert described > 0.8
    assert ahead.mean() < most * described


def test_a_bent_tail_turns_the_fish_and_a_tether_pulls_it():
    bent = swum(Hardship(share=1.0, bend=WRECKED.bend), BEAT)[:, 2]
    assert np.ptp(bent) > 5 * abs(swum(None, BEAT)[0, 2]) and bent.min() < 0 < bent.max()
    still = np.array([-1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    pulled = swum(Hardship(share=1.0, pull=0.06), still)[:, :2]
    assert np.hypot(*swum(None, still)[0, :2]) < 1e-3 < np.hypot(*pulled.T).max()


def test_a_batch_with_hardships_equals_its_members():
    seeds = [5, 6, 7]
    together = World(FISH, Settings(hard=WRECKED), seeds)
    alone = World(FISH, Settings(hard=WRECKED), seeds[1:2])
    first, second = together.reset(), alone.reset()
    for _ in range(40):
        assert np.array_equal(first[1], second[0])
        assert np.array_equal(hidden(together)[1], hidden(alone)[0])
        first = together.step(np.tile(BEAT, (3, 1))).observation
        second = alone.step(BEAT[None]).observation


def test_hidden_numbers_are_what_was_drawn_in_the_fish_s_own_frame():
    world = World(FISH, replace(STILL, hard=replace(WRECKED, share=1.0)), [1, 2, 3])
    world.reset()
    seen, physics = hidden(world), world.simulator.physics
    assert seen.shape == (3, HIDDEN)
    limit = physics.fields["actuator_forcerange"][:, 0, 1] / FISH.servos["identified"].force_limit
    assert np.exp(0.5 * seen[:, 0]) == pytest.approx(limit, rel=1e-4)
    assert seen[:, 9:11] * 0.04 == pytest.approx(world.pull, rel=1e-4)  # at yaw 0
    world.simulator.qpos[:, 2] = world.pose[:, 2] = np.pi / 2
    turned = hidden(world)[:, 9:11] * 0.04
    assert turned[:, 0] == pytest.approx(world.pull[:, 1], rel=1e-4)
    assert turned[:, 1] == pytest.approx(-world.pull[:, 0], rel=1e-4)
    plain = World(FISH, STILL, [1])
    plain.reset()
    assert np.abs(hidden(plain)).max() < 1e-6


def test_a_crank_has_hardships_too():
    world = World(load_fish("crank-fish"), Settings(hard=replace(WRECKED, share=1.0)), [1, 2])
    world.reset()
    for _ in range(20):
        world.step(np.zeros((2, 3)))
    assert np.isfinite(hidden(world)).all() and np.ptp(hidden(world)[:, 0]) > 0.01


# ---- the training -------------------------------------------------------------------------------


def run_of(folder: Path, **changes: object) -> RunConfig:
    recipe = replace(quick(), fish=4, buffer=400, width=16)
    given = {"recipe": recipe, "hard": WRECKED, "averages": True, "measured": True, **changes}
    return RunConfig(FISH, folder, **given)  # type: ignore[arg-type]


def test_hardships_come_in_the_polish_alone_which_is_longer(tmp_path):
    run = run_of(tmp_path)
    assert run.settings(9).hard is None and run.settings(9, polishing=True).hard == WRECKED
    assert run.polish == 10 * run.recipe.polish
    plain = replace(run, hard=None)
    assert plain.polish == plain.recipe.polish and not plain.informed


def test_critics_see_what_is_hidden_and_the_actor_does_not(tmp_path):
    run = run_of(tmp_path)
    env = training.environment(run)
    model = training.learner(run, env)
    seen = env.reset()
    assert seen.shape[1] == 42 + HIDDEN
    other = seen.copy()
    other[:, 42:] += 1.0
    assert np.array_equal(act(model, seen), act(model, other))
    assert np.array_equal(act(model, seen), act(model, seen[:, :42]))
    action = torch.as_tensor(act(model, seen))
    first, second = (model.critic(torch.as_tensor(one), action)[0] for one in (seen, other))
    assert not torch.equal(first, second)


def test_the_exported_policy_asks_for_nothing_hidden(tmp_path):
    run = run_of(tmp_path)
    env = training.environment(run)
    model = training.learner(run, env)
    seen = env.reset()
    export(model, run, seen[:, :42], {"seed": 0}, tmp_path / "policy.onnx")
    found = decide(load_policy(tmp_path / "policy.onnx"), seen[:, :42])
    assert found == pytest.approx(act(model, seen), abs=1e-5)


def test_what_was_hidden_at_an_episode_s_end_is_that_robot_s(tmp_path):
    """An ended fish restarts as another robot in the same step."""
    settings = replace(run_of(tmp_path).settings(9, polishing=True))
    env = FishVecEnv(FISH, 3, settings, seed=2, informed=True)
    before = env.reset()[:, -HIDDEN:]
    fixed = slice(0, 7)
    env.world.age[:] = env.world.steps_per_episode - 1
    env.step_async(np.zeros((3, 6)))
    after, _, ended, infos = env.step_wait()
    assert ended.all()
    last = np.array([info["terminal_observation"][-HIDDEN:] for info in infos])
    assert last[:, fixed] == pytest.approx(before[:, fixed])
    assert (np.abs(after[:, -HIDDEN:][:, fixed] - before[:, fixed]).max(axis=1) > 0.01).all()


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"recipe": smoke()}, "--hard: recipe smoke has no polish"),
        ({"recipe": paper()}, "--hard: recipe paper has no polish"),
        ({"hard": Hardship(share=1.5)}, "hardship: share = 1.5; allowed is 0 to 1"),
        ({"hard": Hardship(full=-0.5)}, "hardship: full = -0.5; allowed is 0 to 1"),
        ({"hard": Hardship(friction=-0.1)}, "hardship: friction = -0.1; allowed is 0 or more"),
    ],
)
def test_what_cannot_be_is_refused(tmp_path, changes, said):
    run = run_of(tmp_path, **changes)
    with pytest.raises(BadInput, match=said):
        check(run, resume=False)
        check_settings(FISH, run.settings(9, polishing=True))


def test_the_command_refuses_an_unknown_level(tmp_path):
    out = tmp_path / "run"
    done = tailbeat("train", "--fish", "pulley-fish-pool", "--hard", "awful", "--out", out)
    assert done.returncode == 2 and "mess 'awful': allowed are clean" in done.stderr
    assert not out.exists()
