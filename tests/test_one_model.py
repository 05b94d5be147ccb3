"""One model everywhere: training, trials and predictions swim the fish that was identified."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tailbeat.control import actions as act
from tailbeat.control.actions import PERIOD, ActionSpace
from tailbeat.env import randomize
from tailbeat.env.randomize import FIELDS, Randomisation
from tailbeat.env.simulator import TwinSimulator
from tailbeat.env.task import Settings, Task, check_settings
from tailbeat.env.world import World
from tailbeat.evaluate import trial
from tailbeat.evaluate.scenes import grid
from tailbeat.fish.description import Fish
from tailbeat.fish.rollout import Start, Swim, swim
from tailbeat.fish.store import load_fish, shipped
from tailbeat.fish.twin import Options, compile_twin
from tailbeat.identify import runs as replayed
from tailbeat.identify.predict import predict
from tailbeat.identify.runs import as_run
from tailbeat.identify.tag_pose import tracked_pose
from tailbeat.recording import Recording

FISH = load_fish("pulley-fish-pool")
SECONDS = 30.0
STEPS = round(SECONDS / PERIOD)


def wander(space: ActionSpace) -> np.ndarray:
    """Half a minute of actions (steps, size), a new one every half second."""
    drawn = np.random.default_rng(0).uniform(-1, 1, (60, act.size(space)))
    return np.repeat(drawn, STEPS // 60, axis=0).astype(np.float32)


def alone(fish: Fish, space: ActionSpace, actions: np.ndarray, yaw: float = 0.0) -> Swim:
    """The compiled twin, under the setpoints of these actions, sampled every control step."""
    state, setpoints = act.reset(space, 1), []
    for action in actions.astype(float):
        state = act.step(space, state, action[None], PERIOD)
        setpoints.append(act.setpoint(space, state)[0])
    twin = compile_twin(fish)
    substeps = round(PERIOD / twin.model.opt.timestep)
    start = replace(Start.at_rest(), pose=np.array([0.0, 0.0, yaw]))
    return swim([twin], [start], [np.repeat(setpoints, substeps)], substeps)[0]


@pytest.mark.parametrize(
    "name",
    [
        n if n == "pulley-fish-pool" else pytest.param(n, marks=pytest.mark.thorough)
        for n in shipped()
    ],
)
def test_a_world_with_nothing_drawn_swims_the_compiled_twin_bit_for_bit(name: str) -> None:
    fish = load_fish(name)
    settings = Settings(task=Task(seconds=SECONDS), physics=randomize.none())
    world, space = World(fish, settings, [1, 2]), check_settings(fish, settings)
    world.reset()
    swum = [world.simulator.qpos.copy()]
    for action in wander(space):
        world.step(np.tile(action, (2, 1)))
        swum.append(world.simulator.qpos.copy())
    wanted = alone(fish, space, wander(space)).qpos
    for i in range(2):
        assert np.array_equal(np.array(swum)[:, i], wanted)


def test_a_trial_in_the_twin_swims_the_compiled_twin() -> None:
    """What `evaluate` swims in the twin, but for the draws. A trial is stored in single
    precision."""
    pool = trial.Pool(FISH, FISH, check_settings(FISH, Settings()), (), 2, 0)
    scene = grid(FISH, 2, 0, 0.5, 3.0, np.pi)
    condition = pool.in_twin("reach twin", scene)
    condition = replace(condition, physics=randomize.none(), stop=False, seconds=12.0)
    actions = wander(pool.actions)
    found = trial.swim(told(actions), condition, [1, 2])
    for i, steps in enumerate(found.steps):
        wanted = alone(FISH, pool.actions, actions[:steps], scene.start[i, 2]).qpos
        assert steps > 300 and np.array_equal(found.shape[i, : steps + 1], wanted.astype("f4"))


def told(actions: np.ndarray) -> Any:
    """A policy that gives every fish the next of these actions, whatever it observes."""
    coming: Iterator[np.ndarray] = iter(actions)
    return lambda seen: np.tile(next(coming), (len(seen), 1))


def test_predict_replays_the_compiled_twin_bit_for_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two swims of other lengths together, each beside the twin alone under its own commands."""
    given = list[tuple[Start, np.ndarray]]()

    def noted(twins: Any, starts: Any, commands: Any, *more: Any) -> list[Swim]:
        given.extend(zip(starts, commands, strict=True))
        return swim(twins, starts, commands, *more)

    monkeypatch.setattr(replayed, "swim", noted)
    runs = [as_run(launched(seconds), FISH) for seconds in (SECONDS, 4.0)]
    predicted, twin = predict(FISH, runs), compile_twin(FISH, Options(replayed=True))
    every = round(replayed.SAMPLE / twin.model.opt.timestep)
    for found, (start, command) in zip(predicted, given, strict=True):
        wanted = swim([twin], [start], [command], every)[0].qpos
        assert np.array_equal(found.track.pose, tracked_pose(FISH, wanted[:, :3]))


def launched(seconds: float) -> Recording:
    """A recorded swim at 0.2 m/s, its motor swept from 1 to 2 Hz."""
    time = np.arange(0, seconds, 0.02)
    motor = 0.4 * np.sin(2 * np.pi * (1 + time / seconds / 2) * time)
    columns = {"motor_angle_rad": motor, "x_m": 0.2 * time, "y_m": 0 * time, "yaw_rad": 0 * time}
    return Recording("launched", time, columns, {"launch": "0.2 0 0"})


# ---- draws --------------------------------------------------------------------------------------


def drawn(fish: Fish, ranges: Randomisation, count: int = 1, seed: int = 0) -> TwinSimulator:
    body, rng = TwinSimulator(fish, count), np.random.default_rng(seed)
    body.rest(np.arange(count))
    for i in range(count):
        body.draw(i, ranges, rng)
    body.ready(np.arange(count))
    return body


# What may change in the model when one quantity is drawn, beside the engine's own inverse weights
# of what carries a mass.
FOLLOWS = {
    "head_mass": {"body_mass", "body_subtreemass"},
    "head_inertia": {"body_inertia"},
    "head_centre": {"body_ipos", "dof_length", "bvh_aabb"},  # a hinge's lever, bounding boxes
    "tail_stiffness": {"jnt_stiffness"},
    "tail_damping": {"dof_damping"},
    "fluid": {"geom_fluid"},
    "servo_gain": {"actuator_gainprm", "actuator_biasprm"},
    "servo_damping": {"dof_damping"},
    "servo_limit": {"actuator_forcerange"},
    "servo_delay": {"actuator_delay"},
    "density": {"opt.density"},
    "current": {"opt.wind"},
}
INERTIAL = {"dof_M0", "dof_invweight0", "body_invweight0", "tendon_invweight0", "actuator_acc0"}


def changed_fields(fish: Fish, ranges: Randomisation) -> set[str]:
    """Fields of the batch's own model that differ from the compiled one."""
    from mujoco import batch  # its list of fields alone

    model, own = compile_twin(fish).model, drawn(fish, ranges).batch.get_model(0)
    found = set()
    for name in batch.MODEL_FIELDS:
        a, b = (m.opt if name.startswith("opt.") else m for m in (model, own))
        leaf = name.removeprefix("opt.")
        if not np.array_equal(getattr(a, leaf), getattr(b, leaf)):
            found.add(name)
    return found


@pytest.mark.parametrize("name", ["pulley-fish-pool", "crank-fish"])
@pytest.mark.parametrize("quantity", FOLLOWS)
def test_a_draw_changes_what_was_drawn_and_nothing_else(name: str, quantity: str) -> None:
    ranges = replace(randomize.none(), **{quantity: getattr(Randomisation(), quantity)})
    found = changed_fields(load_fish(name), ranges)
    inertial = INERTIAL if quantity.startswith("head") else set()
    assert found <= FOLLOWS[quantity] | inertial
    without = name == "crank-fish" and quantity in ("servo_delay", "servo_damping")  # it has none
    assert bool(found) is not without


def test_a_draw_of_masses_leaves_the_waters_virtual_masses_out() -> None:
    """`mj_setConst` derives them anew: this is what trained every policy on another fish."""
    fish = load_fish("pulley-fish-pool")
    body = drawn(fish, Randomisation(), 3)
    nominal = compile_twin(fish).model.geom_fluid[:, 6:]
    assert np.array_equal(body.physics.fields["geom_fluid"][2, :, 6:], nominal)
    assert "tendon_invweight0" in FIELDS
