"""The action space of a motor that turns without end: its angle, its mirror image, its limits."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("gymnasium", reason="the train extra is not installed")

from tailbeat.control import actions as act
from tailbeat.control.actions import PERIOD, ActionState, Generator, Turning
from tailbeat.env import randomize
from tailbeat.env.measured import measure_of
from tailbeat.env.sensors import quiet
from tailbeat.env.task import Settings, Task, check_settings
from tailbeat.env.world import World
from tailbeat.files import BadInput
from tailbeat.fish.store import load_fish
from tailbeat.pool.simulator import PoolSimulator
from tailbeat.pool.water import Water

CRANK, PULLEY = load_fish("crank-fish"), load_fish("pulley-fish")
SPACE = Turning(3.0)


def stepped(action: np.ndarray, steps: int, period: float = PERIOD) -> ActionState:
    """The state after a constant action, begun at its speed."""
    state = ActionState(act._turning_goal(SPACE, action[None]), np.zeros(1))
    for _ in range(steps):
        state = act.step(SPACE, state, action[None], period)
    return state


def closed_form(time: float) -> float:
    """Angle at full speed and depth, fastest at the angle 0, from 0 on."""
    depth, mean = SPACE.depth, 2 * np.pi * SPACE.ceiling
    even = mean * np.sqrt(1 - depth**2) * time
    turns = np.floor(even / (2 * np.pi) + 0.5)
    rest = even - 2 * np.pi * turns
    ratio = np.sqrt((1 + depth) / (1 - depth))
    return float(2 * np.pi * turns + 2 * np.arctan(ratio * np.tan(rest / 2)))


def test_the_angle_is_the_closed_form_s():
    """At the highest speed and depth, over ten turns and more."""
    steps = 400
    found = stepped(np.array([1.0, 1.0, 0.0]), steps).phase[0]
    assert found == pytest.approx(closed_form(steps * PERIOD), abs=2e-2)
    one = stepped(np.array([1.0, 1.0, 0.0]), 1).phase[0]
    assert one == pytest.approx(closed_form(PERIOD), abs=2e-4)


@pytest.mark.parametrize("seed", range(5))
def test_it_never_turns_back_whatever_is_asked(seed):
    rng = np.random.default_rng(seed)
    state = act.reset(SPACE, 8)
    for _ in range(200):
        before, state = state.phase, act.step(SPACE, state, rng.uniform(-3, 3, (8, 3)), PERIOD)
        assert np.all(state.phase >= before)
        assert np.hypot(state.u[:, 1], state.u[:, 2]).max() <= SPACE.depth + 1e-12
    assert np.all(act.setpoint(SPACE, state) == state.phase)


def test_an_action_of_minus_one_stops_it():
    assert stepped(np.array([-1.0, 1.0, 0.0]), 50).phase[0] == 0.0


def test_a_batch_equals_its_members():
    actions = np.random.default_rng(0).uniform(-1, 1, (5, 3))
    together = act.step(SPACE, act.reset(SPACE, 5), actions, PERIOD)
    for i in range(5):
        alone = act.step(SPACE, act.reset(SPACE, 1), actions[i : i + 1], PERIOD)
        assert alone.phase[0] == together.phase[i] and np.array_equal(alone.u[0], together.u[i])


@pytest.mark.parametrize(
    ("space", "complaint"),
    [
        (Turning(0.0), "ceiling = 0 Hz"),
        (replace(SPACE, floor=3.0), "floor = 3 Hz"),
        (replace(SPACE, depth=1.0), "depth = 1; give 0 or more, and less than 1"),
        (replace(SPACE, tau=0.0), "tau = 0 s"),
    ],
)
def test_limits_that_cannot_be_are_refused(space, complaint):
    with pytest.raises(BadInput, match=complaint):
        act.check_space(space)


def test_a_crank_turns_and_a_pulley_swings():
    assert isinstance(check_settings(CRANK, Settings()), Turning)
    with pytest.raises(BadInput, match="generator for crank-fish, whose motor is a crank"):
        check_settings(CRANK, Settings(Generator(-1.0, 1.0)))
    with pytest.raises(BadInput, match="turning for pulley-fish, whose motor is a pulley"):
        check_settings(PULLEY, Settings(SPACE))
    with pytest.raises(BadInput, match=r"reaches 3 Hz and the identified band ends at 2\.5 Hz"):
        check_settings(CRANK, Settings(SPACE))


# ---- in water -----------------------------------------------------------------------------------

SPEED = 2.0  # turns a second, before the slower half of each turn
LEFT, RIGHT = 315.0, 135.0  # deg, phase of the fast half


@pytest.fixture(scope="module")
def turned() -> dict[tuple[str, float], tuple[float, float]]:
    """Surge [m/s] and yaw rate [rad/s] in twin and pool, by phase of the fast half; NaN: even."""
    phases, space = (np.nan, LEFT, RIGHT), Turning(CRANK.band[1])
    share = 2 * SPEED / space.ceiling - 1
    actions = np.array(
        [[share, *(np.nan_to_num([np.cos(p), np.sin(p)]))] for p in np.radians(phases)]
    )
    settings = Settings(space, Task(limit=50.0), sensors=quiet(), physics=randomize.none())
    found: dict[tuple[str, float], tuple[float, float]] = {}
    for name, pool in (("twin", None), ("pool", PoolSimulator(CRANK, [Water()] * 3))):
        world = World(CRANK, settings, [1, 2, 3], simulator=pool)
        world.reset()
        poses = []
        for _ in range(800):
            world.step(actions)
            poses.append(world.simulator.qpos[:, :3].copy())
        paces = pace(np.array(poses[400:]))
        found |= {(name, phase): one for phase, one in zip(phases, paces, strict=True)}
    return {(n, -1.0 if np.isnan(p) else p): one for (n, p), one in found.items()}


def pace(poses: np.ndarray) -> list[tuple[float, float]]:
    moved, yaw = np.diff(poses[..., :2], axis=0), poses[:-1, :, 2]
    seconds = len(moved) * PERIOD
    surge = (moved[..., 0] * np.cos(yaw) + moved[..., 1] * np.sin(yaw)).sum(axis=0) / seconds
    rate = (poses[-1, :, 2] - poses[0, :, 2]) / seconds
    return list(zip(surge.tolist(), rate.tolist(), strict=True))


@pytest.mark.thorough
@pytest.mark.parametrize("where", ["twin", "pool"])
def test_it_steers_to_both_sides_in_the_twin_and_in_water_that_is_not_the_twin_s(where, turned):
    even, left, right = (turned[where, phase] for phase in (-1.0, LEFT, RIGHT))
    assert abs(even[1]) < 0.02  # rad/s: straight ahead
    assert left[1] > 0.1 and right[1] == pytest.approx(-left[1], rel=0.2)
    assert 1.0 < left[0] / left[1] < 2.0  # m: less than four lengths


def test_its_measure_is_taken_by_turning():
    found = measure_of(CRANK)
    assert found.speed > 0.5 and found.reach >= 1.0


def test_a_robot_s_driver_refuses_a_motor_that_turns_without_end():
    from tailbeat.control.policy import load_policy
    from tailbeat.robot.fits import check_driven

    contract = load_policy("pulley-fish-pool-generator").contract
    check_driven(contract)
    with pytest.raises(BadInput, match="commands angles within a turn"):
        check_driven(replace(contract, actions=SPACE))
