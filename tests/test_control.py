"""The action spaces keep their promises whatever the policy does; the observation is its table."""

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from tailbeat.control.actions import (
    Direct,
    Filtered,
    Generator,
    check_band,
    check_space,
    reset,
    setpoint,
    size,
    step,
    targets,
)
from tailbeat.control.band import Monitor, share_below, velocity_spectrum
from tailbeat.control.observation import SCALES, TABLE, Samples, as_markdown, bearing, observe
from tailbeat.files import BadInput

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
    assert np.array_equal(targets(GENERATOR, action), before)


@pytest.mark.parametrize("space", SPACES, ids=lambda s: s.kind)
@pytest.mark.parametrize("seed", range(3))
def test_setpoints_stay_inside_the_servo_s_range(space, seed):
    setpoints, _ = played(space, wild(space, 400, 16, seed))
    assert setpoints.min() >= -1.4 and setpoints.max() <= 1.4
    assert np.ptp(setpoints) > 0.5


def test_the_generator_s_setpoint_is_continuous():
    """Between two steps of 0.1 ms it moves no further than its fastest wave and lag allow."""
    space = replace(GENERATOR, low=-10.0, high=10.0)
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
        (replace(GENERATOR, low=2.0), "must rise"),
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
    assert found["sin motor angle"] == pytest.approx(np.sin(raw.motor_angle), rel=1e-5)
    assert found["motor velocity"] == pytest.approx(raw.motor_velocity, rel=1e-5)
    assert found["yaw rate"] == pytest.approx(raw.yaw_rate, rel=1e-5)
    assert found["cos phase"] == pytest.approx(np.cos(raw.phase), rel=1e-5)
    assert found["command 0 (newest): frequency"] == pytest.approx(raw.commands[:, 0, 0], rel=1e-5)
    assert found["command 2: centre"] == pytest.approx(raw.commands[:, 2, 1], rel=1e-5)
    assert found["frame 1: staleness"] == pytest.approx(raw.frames[:, 1, 5], rel=1e-5)
    distance = found["frame 0 (newest): target distance"]
    ahead, left = (found[f"frame 0 (newest): target {n}"] for n in ("ahead", "left"))
    assert distance == pytest.approx(np.hypot(ahead, left), rel=1e-5)


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
    first = Samples(*(getattr(raw, name)[:1] for name in asdict(raw)))
    assert np.array_equal(observe(first)[0], observe(raw)[0])
    assert len(as_markdown().splitlines()) == 26


# ---- band ---------------------------------------------------------------------------------------


def test_two_tones_share_the_power_of_their_speeds():
    rng = np.random.default_rng(0)
    time = (np.arange(400) + rng.uniform(-0.3, 0.3, 400)) * 0.02  # a loop with jitter
    angle = 0.3 * np.sin(2 * np.pi * 2 * time) + 0.1 * np.sin(2 * np.pi * 6 * time + 1) + 0.1 * time
    # speeds 0.3 * 2 and 0.1 * 6: the same power
    assert share_below(time, angle, 4.0) == pytest.approx(0.5, abs=0.03)
    assert share_below(time, angle, 7.0) > 0.97
    total = np.trapezoid(velocity_spectrum(time, angle).power) / 8
    assert total == pytest.approx(2 * 0.5 * (2 * np.pi * 0.6) ** 2, rel=0.15)


def test_the_running_share_follows_the_last_four_seconds():
    monitor = Monitor(4.0)
    assert monitor.share() is None
    for t in np.arange(0, 6, 0.02):
        monitor.add(t, 0.5 * np.sin(2 * np.pi * 1.3 * t))
    calm = monitor.share()
    assert calm is not None and calm > 0.95
    for t in np.arange(6, 11, 0.02):
        monitor.add(t, 0.2 * np.sin(2 * np.pi * 7 * t))
    fast = monitor.share()
    assert fast is not None and fast < 0.1
    assert len(monitor.samples) <= 202
    for t in np.arange(11, 16, 0.02):
        monitor.add(t, 0.0)
    assert monitor.share() is None


@pytest.mark.parametrize(
    ("beat", "side"), [(0.4, "below"), (2.0, "inside"), (3.0, "inside"), (6.0, "above")]
)
def test_a_beat_counts_on_its_side_of_the_band(beat, side):
    time = np.arange(0, 10, 0.02)
    found = velocity_spectrum(time, np.sin(2 * np.pi * beat * time)).shares((1.0, 4.0))
    assert getattr(found, side) > 0.95
    assert found.below + found.inside + found.above == pytest.approx(1.0)


def test_both_edges_lie_inside_and_a_still_tail_has_no_shares():
    time = np.arange(0, 10.001, 0.02)
    angle = np.sin(2 * np.pi * 2 * time)
    found = velocity_spectrum(time, angle)
    band = (float(found.frequency[18]), float(found.frequency[20]))  # the tone's three lines
    assert found.shares(band).inside > 0.999
    assert np.isnan(velocity_spectrum(time, 0 * time).shares(band).inside)
    with pytest.raises(BadInput, match="needs 8"):
        velocity_spectrum(time[:3], angle[:3])


def test_a_piece_too_short_for_the_lower_edge_does_not_say_what_lies_below():
    for seconds, known in ((2.0, False), (4.0, True)):
        time = np.arange(0, seconds, 0.02)
        found = velocity_spectrum(time, np.sin(2 * np.pi * 0.4 * time)).shares((1.0, 4.0))
        assert np.isfinite(found.above) and np.isfinite([found.below, found.inside]).all() == known


def test_the_running_monitor_tells_below_from_inside():
    monitor = Monitor(4.0, floor=1.0)
    assert monitor.shares() is None
    for t in np.arange(0, 6, 0.02):
        monitor.add(t, 0.5 * np.sin(2 * np.pi * 0.4 * t))
    slow, share = monitor.shares(), monitor.share()
    assert slow is not None and slow.below > 0.9
    assert share == pytest.approx(1 - slow.above)


def test_a_bearing_is_from_straight_ahead_and_to_the_left():
    half = np.pi / 2
    pose = np.array([[1.0, 1.0, 0.0], [1.0, 1.0, half], [0.0, 0.0, 3.0], [0.0, 0.0, -3.0]])
    place = np.array([[1.0, 3.0], [1.0, 3.0], [-1.0, 0.0], [-1.0, 0.0]])
    assert bearing(pose, place) == pytest.approx([half, 0.0, np.pi - 3.0, 3.0 - np.pi])
