"""Lift by the direction of the flow."""

import mujoco
import numpy as np
import pytest

from even_lift import kutta_led
from forces import ellipsoid_forces, fluid_forces, generalised
from tailbeat.control.actions import PERIOD
from tailbeat.files import BadInput
from tailbeat.fish import edge
from tailbeat.fish.description import Fish, TrailingEdge
from tailbeat.fish.rollout import Start, Swim, swim
from tailbeat.fish.store import load_fish, with_values
from tailbeat.fish.twin import Options, compile_twin

GAITS = [(1.2, 0.5), (1.5, 0.6), (2.0, 0.3), (3.0, 0.2), (3.5, 0.18)]  # Hz, rad
PLATE = np.array([0.035, 0.001, 0.08])


def edged(name: str, **blend: float) -> Fish:
    return load_fish(name).model_copy(update={"trailing_edge": TrailingEdge(**blend)})


def model_of(fish: Fish, root: str = "planar") -> mujoco.MjModel:
    return compile_twin(fish, Options(root=root)).model  # type: ignore[arg-type]


def sines(fish: Fish, seconds: float, launch: float, gaits: list = GAITS) -> list[Swim]:
    """Gaits through the servo, launched along the heading."""
    twin = compile_twin(fish)
    step = twin.model.opt.timestep
    time = np.arange(0, seconds, step)
    commands = [stroke * np.sin(2 * np.pi * rate * time) for rate, stroke in gaits]
    start = Start(np.zeros(3), np.array([launch, 0.0, 0.0]))
    return swim([twin] * len(gaits), [start] * len(gaits), commands, round(0.02 / step))


def last_speed(done: Swim) -> float:
    """Along the heading over the last second [m/s]."""
    way, yaw = done.qpos[-1, :2] - done.qpos[-51, :2], done.qpos[-51:, 2].mean()
    return float(way @ [np.cos(yaw), np.sin(yaw)])


# ---- the law ------------------------------------------------------------------------------------


@pytest.mark.parametrize("root", ["planar", "free"])
def test_the_chord_speed_is_the_engines_velocity_of_each_part(root: str) -> None:
    model = model_of(edged("pulley-fish-pool"), root)
    model.opt.wind = 0.1, -0.2, 0.0
    data, rng = mujoco.MjData(model), np.random.default_rng(0)
    where = edge.chords(model)
    for _ in range(5):
        data.qvel = rng.normal(size=model.nv)
        mujoco.mj_integratePos(model, data.qpos, rng.normal(size=model.nv), 0.5)
        mujoco.mj_forward(model, data)
        found = edge.chord_speeds(where, data.qpos[None], data.qvel[None], model.opt.wind[None])[0]
        for geom, ours in zip(where.geom, found, strict=True):
            local = np.empty(6)
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_GEOM, geom, local, 1)
            wind = data.geom_xmat[geom].reshape(3, 3).T @ model.opt.wind
            assert ours == pytest.approx(local[3] - wind[0], abs=1e-9)


def test_weights_run_from_one_ahead_to_the_reverse_lift_astern() -> None:
    blend = np.array([0.03, -0.4])
    found = edge.weights(np.array([1.0, 0.0, -1.0]), blend)
    assert found == pytest.approx([1.0, 0.3, -0.4])
    even = edge.weights(np.linspace(-1, 1, 9), np.array([0.03, 1.0]))
    assert even == pytest.approx(np.ones(9))  # the bare engine


def kutta(velocity: list[float], reverse: float) -> np.ndarray:
    """Force of a towed plate, the weight of its chord speed taken in."""
    factor = edge.weights(np.array([velocity[0]]), np.array([0.001, reverse]))[0]
    row = np.array([0, 0, 0, factor, 0.0])
    none = np.zeros(3)
    return ellipsoid_forces(velocity, none, PLATE, row, none, none, 1000.0, 0.0).kutta


def test_a_plate_towed_across_its_chord_is_pushed_ahead_in_both_directions() -> None:
    """Thin aerofoil with its circulation set at the rear end (r = -1): the force along the chord
    keeps its sign, the force across it changes; the even law does the opposite."""
    ahead, astern = kutta([0.3, 0.05, 0], -1.0), kutta([-0.3, 0.05, 0], -1.0)
    assert astern == pytest.approx(ahead * [1, -1, 1])
    assert ahead[0] > 0
    even = kutta([-0.3, 0.05, 0], 1.0)
    assert even == pytest.approx(ahead * [-1, 1, 1])
    assert kutta([-0.3, 0.05, 0], 0.0) == pytest.approx(np.zeros(3), abs=1e-12)


def test_the_mirrored_flow_gives_the_mirrored_force() -> None:
    for u in (0.3, -0.3):
        left, right = kutta([u, 0.05, 0], -0.5), kutta([u, -0.05, 0], -0.5)
        assert right == pytest.approx(left * [1, -1, 1])


def test_the_numpy_law_is_the_engines_with_weighed_coefficients() -> None:
    model = model_of(edged("pulley-fish-pool", reverse=-0.5))
    data, rng = mujoco.MjData(model), np.random.default_rng(1)
    where, blend = edge.chords(model), edge.blend_of(model)
    assert blend is not None
    nominal = model.geom_fluid[where.geom, edge.KUTTA].copy()
    for _ in range(5):
        data.qpos, data.qvel = 0.4 * rng.normal(size=model.nq), 0.3 * rng.normal(size=model.nv)
        speed = edge.chord_speeds(where, data.qpos[None], data.qvel[None], np.zeros((1, 3)))
        mujoco.mj_forward(model, data)
        ours = generalised(model, data, fluid_forces(model, data))
        model.geom_fluid[where.geom, edge.KUTTA] = nominal * edge.weights(speed, blend)[0]
        mujoco.mj_forward(model, data)
        assert ours == pytest.approx(data.qfrc_fluid, rel=1e-9, abs=1e-12)
        model.geom_fluid[where.geom, edge.KUTTA] = nominal


@pytest.mark.thorough
def test_the_even_engine_swims_backward_for_good_and_a_trailing_edge_does_not() -> None:
    """The fault this law is for, and its cure, by the same launch."""
    even = kutta_led(even=True)
    assert max(last_speed(done) for done in sines(even, 8.0, -0.1)) < -0.05
    for whole in (kutta_led(even=False), edged("pulley-fish-pool")):
        for launch in (0.0, -0.03, -0.1, -0.3):
            assert min(last_speed(done) for done in sines(whole, 12.0, launch)) > 0.05


def beats_and_turns(fish: Fish) -> list[Swim]:
    """The gaits launched backward and forward, and two tight turns from rest."""
    twin, step = compile_twin(fish), fish.simulation.step
    time = np.arange(0, 8, step)
    beats = [stroke * np.sin(2 * np.pi * rate * time) for rate, stroke in GAITS]
    turns = [0.4 + 0.6 * np.sin(2 * np.pi * rate * time) for rate in (1.0, 1.5)]
    launches = [-0.3] * len(beats) + [0.3] * len(beats) + [0.0] * len(turns)
    starts = [Start(np.zeros(3), np.array([launch, 0.0, 0.0])) for launch in launches]
    return swim([twin] * len(starts), starts, [*beats, *beats, *turns], round(PERIOD / step))


def path_errors(rough: list[Swim], fine: list[Swim]) -> np.ndarray:
    """Root mean square distance of each swim, as a fraction of its path."""
    pairs = [(a.qpos[:, :2], b.qpos[:, :2]) for a, b in zip(rough, fine, strict=True)]
    way = [np.linalg.norm(np.diff(b, axis=0), axis=1).sum() for _, b in pairs]
    apart = [np.sqrt(np.square(a - b).sum(axis=1).mean()) for a, b in pairs]
    return np.array(apart) / np.array(way)


@pytest.mark.thorough
def test_the_lift_held_for_a_control_period_errs_less_than_one_percent(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    fish = load_fish("pulley-fish-pool")
    held = beats_and_turns(fish)
    monkeypatch.setattr(edge, "HOLD", fish.simulation.step)
    assert 0 < max(path_errors(held, beats_and_turns(fish))) < 0.01


@pytest.mark.thorough
def test_a_finer_step_changes_no_path_by_one_percent() -> None:
    fish = load_fish("pulley-fish-pool")
    fine = fish.model_copy(update={"simulation": fish.simulation.model_copy(update={"step": 1e-3})})
    assert max(path_errors(beats_and_turns(fish), beats_and_turns(fine))) < 0.01


def test_a_mirrored_command_gives_mirrored_motion() -> None:
    fish = edged("pulley-fish-pool")
    left, right = sines(fish, 4.0, -0.1, [(1.5, 0.6), (1.5, -0.6)])
    assert right.qpos[:, 1:] == pytest.approx(-left.qpos[:, 1:], abs=1e-7)
    assert right.qpos[:, 0] == pytest.approx(left.qpos[:, 0], abs=1e-7)


def test_one_fish_swims_as_among_others_of_other_blends() -> None:
    fishes = [edged("pulley-fish-pool", speed=0.03), edged("pulley-fish-pool", reverse=0.0)]
    twins = [compile_twin(fish) for fish in fishes]
    start, command = Start(np.zeros(3), np.array([-0.1, 0, 0])), 0.6 * np.sin(np.arange(1500) / 50)
    both = swim(twins, [start] * 2, [command, command[:1000]], 5)
    for twin, done, length in zip(twins, both, (1500, 1000), strict=True):
        alone = swim([twin], [start], [command[:length]], 5)[0]
        assert np.array_equal(alone.qpos, done.qpos)


def test_a_part_without_a_length_is_refused_by_name() -> None:
    fish = edged("pulley-fish-pool")
    with pytest.raises(BadInput, match=r"part 'fin' is 0\.5 mm long.*give its length"):
        with_values(fish, {"tail.links.4.parts.1.size": (0.0005, 0.002, 0.16)})  # type: ignore[dict-item]
