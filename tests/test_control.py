"""The action spaces keep their promises whatever the policy does; the observation is its table."""

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from tailbeat.control.actions import (
    ActionState,
    Direct,
    Filtered,
    Generator,
    check_band,
    check_space,
    command,
    reset,
    setpoint,
    size,
    step,
    targets,
)
from tailbeat.control.band import share_below
from tailbeat.control.measure import PAPER
from tailbeat.control.observation import (
    TABLE,
    Samples,
    as_markdown,
    bearing,
    observe,
    scales,
    wrapped,
)
from tailbeat.files import BadInput

SCALES = scales(PAPER)
GENERATOR = Generator(-1.4, 1.4)
SPACES = (GENERATOR, Direct(-1.4, 1.4), Filtered(-1.4, 1.4))
DT = 0.02


def played(space, actions: np.ndarray, dt: float = DT) -> tuple[np.ndarray, np.ndarray]:
    """Setpoints and phases (steps, n) of actions (steps, n, size)."""
    state = reset(space, actions.shape[1])
    setpoints, phases = [], []
    for action in actions:
        state = step(space, state, action, dt)
        setpoints.append(setpoint(space, state))
        phases.append(state.phase)
    return np.array(setpoints), np.array(phases)


def wild(space, steps: int, count: int, seed: int) -> np.ndarray:
    """Actions that jump between extremes, stay, or wander."""
    rng = np.random.default_rng(seed)
    held = rng.integers(1, 40)
    rough = rng.choice([-1.0, 1.0, 0.0, 3.0, -3.0], size=(steps // held + 1, count, size(space)))
    return np.repeat(rough, held, axis=0)[:steps] + rng.normal(0, 0.3, (steps, count, size(space)))


# ---- actions ------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("binds", ["fundamental", "signal"])
def test_the_fundamental_never_passes_its_ceiling(seed, binds):
    space = replace(GENERATOR, binds=binds)
    _, phases = played(space, wild(space, 500, 8, seed))
    turned = np.diff(np.unwrap(phases, axis=0), axis=0) / DT / (2 * np.pi)
    assert turned.max() <= space.fundamental * (1 + 1e-9)
    assert turned.min() >= -1e-9
    assert space.fundamental == (4.0 if binds == "fundamental" else 2.0)


def rates(space, actions: np.ndarray) -> np.ndarray:
    """Fundamental (steps - 1, n) [Hz], from the phase."""
    _, phases = played(space, actions)
    return np.diff(np.unwrap(phases, axis=0), axis=0) / DT / (2 * np.pi)


@pytest.mark.parametrize(("binds", "ceiling"), [("fundamental", 4.0), ("signal", 2.0)])
def test_actions_map_to_the_range_from_floor_to_ceiling(binds, ceiling):
    space = replace(GENERATOR, floor=1.0, binds=binds)
    actions = np.zeros((200, 3, 6))
    actions[:, :, 0] = [-1.0, 0.0, 1.0]
    found = rates(space, actions)
    assert found[-1] == pytest.approx([1.0, (1 + ceiling) / 2, ceiling], rel=1e-9)
    assert reset(space, 1).u.tolist() == [[0.0] * 6]  # still, below the floor
    assert found[0, 0] < 0.5 and (np.diff(found[:, 0]) >= -1e-9).all()


@pytest.mark.parametrize("seed", range(3))
def test_the_fundamental_stays_above_its_floor_once_it_is_there(seed):
    found = rates(replace(GENERATOR, floor=1.0), wild(GENERATOR, 500, 8, seed))
    assert found[100:].min() >= 1.0 - 1e-6
    assert found.max() <= 4.0 * (1 + 1e-9)


def test_without_a_floor_targets_are_bit_equal_to_those_of_before_the_field():
    action = np.random.default_rng(0).uniform(-1, 1, (1000, 6))
    half = np.pi * 4.0
    before = action * [half, 0.8, 1.0, 1.0, 0.4, 0.4]
    before[:, 0] += half
    assert np.array_equal(targets(replace(GENERATOR, offset=0.8), action), before)


@pytest.mark.parametrize("space", SPACES, ids=lambda s: s.kind)
@pytest.mark.parametrize("seed", range(3))
def test_setpoints_stay_inside_the_servo_s_range(space, seed):
    setpoints, _ = played(space, wild(space, 400, 16, seed))
    assert setpoints.min() >= -1.4 and setpoints.max() <= 1.4
    assert np.ptp(setpoints) > 0.5


def test_the_generator_s_setpoint_is_continuous():
    """Between two steps of 0.1 ms it moves no further than its fastest wave and lag allow."""
    space = replace(GENERATOR, low=-10.0, high=10.0, offset=0.8)
    fine = 1e-4
    setpoints, _ = played(space, np.repeat(wild(space, 50, 8, 1), 200, axis=0), fine)
    wave = 2 * np.pi * 4 * np.hypot(1, 1) + 2 * np.pi * 8 * np.hypot(0.4, 0.4)
    lag = 2 * (0.8 + 2 * 1.0 + 2 * 0.4) / space.tau
    assert np.abs(np.diff(setpoints, axis=0)).max() < (wave + lag) * fine


@pytest.mark.parametrize(("binds", "edge"), [("fundamental", 8.0), ("signal", 4.0)])
def test_power_above_the_ceilings_harmonic_is_negligible(binds, edge):
    """The lag modulates the waves, so there are side bands: 3 Hz of margin (two corners of tau)."""
    space = replace(GENERATOR, low=-10.0, high=10.0, binds=binds)
    for seed in range(4):
        setpoints, _ = played(space, wild(space, 2000, 4, seed), 0.005)
        for signal in setpoints.T:
            window = np.hanning(signal.size) * (signal - signal.mean())
            power = np.square(np.abs(np.fft.rfft(window)))
            frequency = np.fft.rfftfreq(signal.size, 0.005)
            assert power[frequency > edge + 3.0].sum() < 0.02 * power.sum()


def test_direct_action_has_no_such_bound():
    setpoints, _ = played(SPACES[1], np.sign(np.sin(np.arange(400) * 3.0))[:, None, None])
    time = np.asarray(np.arange(400) * DT, dtype=float)
    share = share_below(time, setpoints[:, 0], 4.0)
    assert share < 0.1


def test_lag_and_phase_are_exact_for_any_step():
    action = np.array([[0.3, 0.5, -0.2, 0.9, 0.1, -0.4]])
    one = step(GENERATOR, reset(GENERATOR, 1), action, 0.1)
    many = reset(GENERATOR, 1)
    for _ in range(100):
        many = step(GENERATOR, many, action, 0.001)
    assert many.u == pytest.approx(one.u, rel=1e-12)
    assert many.phase == pytest.approx(one.phase, rel=1e-12)
    assert one.u[0, 0] == pytest.approx(1.3 / 2 * 8 * np.pi * (1 - np.exp(-1)))
    slow = step(SPACES[2], reset(SPACES[2], 1), np.ones((1, 1)), 0.04)
    assert slow.u[0, 0] == pytest.approx(1.4 * (1 - np.exp(-1)))


@pytest.mark.parametrize("space", SPACES, ids=lambda s: s.kind)
def test_a_batch_equals_its_members(space):
    actions = wild(space, 50, 5, 3)
    together, _ = played(space, actions)
    for i in range(5):
        alone, _ = played(space, actions[:, i : i + 1])
        assert np.array_equal(alone[:, 0], together[:, i])


@pytest.mark.parametrize(
    ("space", "complaint"),
    [
        (replace(GENERATOR, low=2.0), "a low below the high"),
        (Direct(1.4, 1.4), "a low below the high"),
        (Filtered(-1.4, 1.4, tau=0.0), "tau = 0"),
        (replace(GENERATOR, ceiling=0.0), "ceiling = 0"),
        (replace(GENERATOR, tau=0.0), "tau = 0"),
        (replace(GENERATOR, ceiling=-1.0), "ceiling = -1"),
        (replace(GENERATOR, second=-0.1), "give 0 or more"),
        (replace(GENERATOR, floor=-0.5), "floor = -0.5 Hz; give 0 or more"),
        (replace(GENERATOR, floor=4.0), "less than the highest fundamental, 4 Hz"),
        (replace(GENERATOR, floor=2.0, binds="signal"), "highest fundamental, 2 Hz"),
        (replace(GENERATOR, floor=np.nan), "floor = nan Hz"),
    ],
)
def test_limits_that_cannot_be_are_refused(space, complaint):
    with pytest.raises(BadInput, match=complaint) as refused:
        check_space(space)
    assert str(refused.value).count(". ") == 0  # one sentence


@pytest.mark.parametrize(
    "space",
    [
        *SPACES,
        replace(GENERATOR, ceiling=0.5),
        replace(GENERATOR, offset=0.0, first=0.0, second=0.0),
        replace(GENERATOR, floor=3.9),
    ],
)
def test_limits_that_can_be_are_taken(space):
    check_space(space)


def test_the_setpoint_is_the_paper_s_wave():
    """theta_c + a1 cos phi + b1 sin phi + a2 cos 2 phi + b2 sin 2 phi, at eighths of a turn."""
    centre, a1, b1, a2, b2 = 0.1, 0.2, 0.3, 0.04, 0.05
    state = ActionState(np.tile([9.0, centre, a1, b1, a2, b2], (5, 1)), np.arange(5) * np.pi / 4)
    side = np.sqrt(0.5)
    wanted = [a1 + a2, side * (a1 + b1) + b2, b1 - a2, side * (b1 - a1) - b2, a2 - a1]
    assert setpoint(GENERATOR, state) == pytest.approx(centre + np.array(wanted))
    assert command(GENERATOR, state).tolist() == [[9.0, centre]] * 5


@pytest.mark.parametrize("space", SPACES, ids=lambda s: s.kind)
def test_actions_beyond_one_ask_for_no_more_than_one(space):
    for sign in (-1.0, 1.0):
        ends = [played(space, np.full((30, 1, size(space)), sign * x))[0] for x in (1.0, 1.5, 99.0)]
        assert np.array_equal(ends[0], ends[1]) and np.array_equal(ends[0], ends[2])


def test_a_direct_action_runs_from_the_range_s_low_to_its_high():
    space = Direct(-0.4, 1.2)
    state = step(space, reset(space, 3), np.array([[-1.0], [0.0], [1.0]]), DT)
    assert setpoint(space, state) == pytest.approx([-0.4, 0.4, 1.2])
    assert command(space, state) == pytest.approx(np.array([[0, -0.4], [0, 0.4], [0, 1.2]]))


@pytest.mark.parametrize("kind", [Direct, Filtered])
def test_it_begins_straight_or_at_the_nearest_angle_that_the_servo_reaches(kind):
    for low, high, rest in ((-1.4, 1.4, 0.0), (0.2, 1.4, 0.2), (-1.4, -0.3, -0.3)):
        assert setpoint(kind(low, high), reset(kind(low, high), 2)).tolist() == [rest] * 2
    assert setpoint(GENERATOR, reset(GENERATOR, 2)).tolist() == [0.0, 0.0]


def test_bad_actions_and_bands_are_refused():
    state = reset(GENERATOR, 2)
    with pytest.raises(BadInput, match=r"generator takes \(2, 6\)"):
        step(GENERATOR, state, np.zeros((2, 5)), DT)
    with pytest.raises(BadInput, match="action nan; give finite"):
        step(GENERATOR, state, np.full((2, 6), np.nan), DT)
    with pytest.raises(BadInput, match="identified band ends at 3 Hz"):
        check_band(GENERATOR, 3.0)
    check_band(replace(GENERATOR, binds="signal"), 3.0)
    check_band(replace(GENERATOR, floor=0.5), 4.0)  # below the lower edge, if so asked
    assert set(asdict(GENERATOR)) >= {"ceiling", "tau", "kind", "low", "high"}  # the contract


# ---- observation --------------------------------------------------------------------------------


def samples() -> Samples:
    rng = np.random.default_rng(0)
    return Samples(*(rng.normal(size=s) for s in ((3,), (3,), (3,), (3,), (3, 3, 2), (3, 3, 6))))


def test_every_row_of_the_table_is_what_it_says():
    raw = samples()
    seen = observe(raw) * SCALES
    found = {entry.name: seen[:, i] for i, entry in enumerate(TABLE)}
    assert len(TABLE) == seen.shape[1] == 24
    wanted = {
        "cos motor angle": np.cos(raw.motor_angle),
        "sin motor angle": np.sin(raw.motor_angle),
        "motor velocity": raw.motor_velocity,
        "yaw rate": raw.yaw_rate,
        "cos phase": np.cos(raw.phase),
        "sin phase": np.sin(raw.phase),
    }
    for i in range(3):
        age = f"{i}" + " (newest)" * (i == 0)
        wanted[f"command {age}: frequency"] = raw.commands[:, i, 0]
        wanted[f"command {age}: centre"] = raw.commands[:, i, 1]
        wanted[f"frame {age}: staleness"] = raw.frames[:, i, 5]
        fish, target = raw.frames[:, i, :2], raw.frames[:, i, 3:5]
        wanted[f"frame {age}: target distance"] = np.linalg.norm(target - fish, axis=1)
        way, away = (f"frame {age}: target {name}" for name in ("ahead", "left"))
        assert np.hypot(found[way], found[away]) == pytest.approx(
            found[f"frame {age}: target distance"], rel=1e-5
        )
    for name, value in wanted.items():
        assert found[name] == pytest.approx(value, rel=1e-5), name
    assert len(wanted) + 2 * 3 == len(TABLE)


def test_a_target_is_seen_from_the_fish():
    raw = samples()
    raw.frames[:, 0] = [1.0, 2.0, np.pi / 2, 1.0, 5.0, 0.0]  # the fish looks along +y, 3 m short
    seen = observe(raw) * SCALES
    assert seen[0, 12:16] == pytest.approx([3.0, 3.0, 0.0, 0.0], abs=1e-5)
    raw.frames[:, 0] = [1.0, 2.0, np.pi / 2, 0.0, 2.0, 0.0]  # and one to its left
    assert (observe(raw) * SCALES)[0, 12:15] == pytest.approx([1.0, 0.0, 1.0], abs=1e-5)


def test_the_docs_show_the_table():
    page = (Path(__file__).parents[1] / "docs" / "explain" / "action-spaces.md").read_text()
    assert as_markdown() in page


def test_one_fish_is_a_batch_of_one():
    raw = samples()
    first = Samples(*(one[:1] for one in vars(raw).values() if one is not None))
    assert np.array_equal(observe(first)[0], observe(raw)[0])
    assert len(as_markdown().splitlines()) == 44


def test_a_bearing_is_from_straight_ahead_and_to_the_left():
    half = np.pi / 2
    pose = np.array([[1.0, 1.0, 0.0], [1.0, 1.0, half], [0.0, 0.0, 3.0], [0.0, 0.0, -3.0]])
    place = np.array([[1.0, 3.0], [1.0, 3.0], [-1.0, 0.0], [-1.0, 0.0]])
    assert bearing(pose, place) == pytest.approx([half, 0.0, np.pi - 3.0, 3.0 - np.pi])


def test_angles_are_wrapped_to_minus_pi_up_to_pi():
    angles = np.array([-np.pi, np.pi, 0.0, 7.0, -7.0])
    turn = 2 * np.pi
    assert wrapped(angles) == pytest.approx([-np.pi, -np.pi, 0.0, 7.0 - turn, turn - 7.0])
