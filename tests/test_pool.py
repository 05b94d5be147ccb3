"""The plant: the twin's tree, exact added mass, conservation, convergence, and no surprises."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from tailbeat.files import BadInput
from tailbeat.fish.store import load_fish
from tailbeat.fish.twin import compile_twin
from tailbeat.pool.chain import build_chain, dofs, fin_factors
from tailbeat.pool.dynamics import Around, Work, add_bodies, scratch, solve
from tailbeat.pool.hydrodynamics import MODE, add_water, current
from tailbeat.pool.kinematics import pose
from tailbeat.pool.plant import Plant, Surroundings, at_rest, build_plant, step_plant, stirred
from tailbeat.pool.section import UNDISTURBED
from tailbeat.pool.tendons import tendon_lengths
from tailbeat.pool.water import ROW, Water, ablations, ensemble, fingerprint

FISH = load_fish("pulley-fish")
# Kirchhoff's water: added mass and nothing else.
BARE = replace(
    Water(),
    suction=0.0,
    vortex=0.0,
    fin_drag=0.0,
    fin_friction=0.0,
    body_friction=0.0,
    body_drag=0.0,
    with_stall=False,
)


def sine(plant: Plant, frequency: float, stroke: float, seconds: float) -> np.ndarray:
    """Commands (1, steps): a sine that fades in over a second, held at 50 Hz."""
    held = np.floor(np.arange(round(seconds / plant.dt)) * plant.dt * 50 + 1e-9) / 50
    return (stroke * np.minimum(held, 1.0) * np.sin(2 * np.pi * frequency * held))[None]


def assembled(plant: Plant, q: np.ndarray, v: np.ndarray, wet: bool = False) -> Work:
    """Mass matrix, bias forces and frames of bodies, and of the plant's water where `wet`."""
    chain = plant.chain
    work = scratch(len(q), len(chain.bodies), len(chain.fins))
    work.mass[:], work.force[:] = 0.0, 0.0
    pose(q, v, chain.bodies, work.frames)
    add_bodies(chain, plant.servo[0]["armature"], work)
    if wet:
        each = plant.each
        around = Around(*(values[0] for values in each))
        add_water(chain, around, 0.0, 0.0, np.full(len(chain.fins), UNDISTURBED), work)
    return work


# ---- the tree -----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["pulley-fish", "crank-fish"])
def test_the_dry_tree_is_the_twin_s(name):
    fish = load_fish(name).model_copy(update={"added_inertia": 0.0})
    air = fish.medium.model_copy(update={"density": 1e-9, "viscosity": 0.0})
    exact = fish.simulation.model_copy(update={"step": 1e-9})  # the step takes off no armature
    twin = compile_twin(fish.model_copy(update={"medium": air, "simulation": exact}))
    plant = build_plant(fish)
    data, rng = mujoco.MjData(twin.model), np.random.default_rng(0)
    straight = mujoco.MjData(twin.model)
    mujoco.mj_forward(twin.model, straight)
    for _ in range(5):
        data.qpos, data.qvel = rng.normal(0, 0.3, (2, twin.model.nv))
        mujoco.mj_forward(twin.model, data)
        full = np.zeros((twin.model.nv, twin.model.nv))
        mujoco.mj_fullM(twin.model, data, full)
        found = assembled(plant, data.qpos.copy(), data.qvel.copy())
        assert found.mass == pytest.approx(full, rel=1e-6, abs=1e-9)
        assert -found.force == pytest.approx(data.qfrc_bias, rel=1e-6, abs=1e-9)
        tendon_lengths(data.qpos.copy(), plant.chain, found.frames, found.lengths, found.pulls)
        moved = data.ten_length - straight.ten_length
        assert found.lengths - plant.chain.neutral == pytest.approx(moved, abs=3e-5)


# ---- added mass ---------------------------------------------------------------------------------


def test_added_mass_of_strips_and_fin_is_the_formula_s():
    plant = build_plant(FISH, [BARE])
    zero = np.zeros(dofs(plant.chain))
    added = assembled(plant, zero, zero, wet=True).mass - assembled(plant, zero, zero).mass
    strips, fin = plant.chain.strips, plant.chain.fins[0]
    chord, height = fin["chord"], fin["height"]
    body = (1000 * np.pi / 4 * strips["height"] ** 2 * strips["length"]).sum()
    plate = 1000 * np.pi / 4 * chord**2 * height * fin_factors(chord, height)[1]
    assert added[1, 1] == pytest.approx(body + plate, rel=1e-9)
    assert added[0, 0] == pytest.approx(BARE.along * body, rel=1e-9)
    assert plate > 15 * 0.020  # the fin carries many times its own mass


def hinge_force(plant: Plant, rate: float, push: float, angle: float) -> float:
    """Force of the water on the fish along x [N] while the last hinge turns, head held."""
    q, v, a = (np.zeros(dofs(plant.chain)) for _ in range(3))
    q[-1], v[-1], a[-1] = angle, rate, push
    dry, wet = assembled(plant, q, v), assembled(plant, q, v, wet=True)
    return float((wet.force - dry.force)[0] - ((wet.mass - dry.mass) @ a)[0])


def test_an_oscillating_plate_in_still_water_is_not_pulled_anywhere():
    """Potential flow has no mean force; the engine's velocity half alone has one."""
    slender = as_strips(build_plant(FISH, [BARE]))
    phase = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    for omega, stroke in ((6.0, 0.6), (50.0, 0.075)):
        force = [
            hinge_force(
                slender,
                -omega * stroke * np.sin(a),
                -(omega**2) * stroke * np.cos(a),
                stroke * np.cos(a),
            )
            for a in phase
        ]
        assert abs(np.mean(force)) < 1e-6 * np.abs(force).max()


def as_strips(plant: Plant) -> Plant:
    """The fin as a slender strip: without circulation the water is conservative."""
    chain = plant.chain
    fins = [tuple(fin)[:4] for fin in chain.fins]
    strips = np.concatenate([chain.strips, np.array(fins, chain.strips.dtype)])
    flat = chain.fins.copy()
    flat["height"] *= 1e-9
    return replace(plant, chain=chain._replace(strips=strips, fins=flat))


def test_energy_and_momentum_are_kept_and_better_with_a_shorter_step():
    """No damping, no drag, a free fish started with its tail moving."""
    soft = FISH.tendons.model_copy(update={"stiffness": 3000.0, "two_way": True})
    tail = FISH.tail.model_copy(update={"damping_time": 0.0})
    off = FISH.servos["identified"].model_copy(
        update={"kp": 1e-9, "damping": 0.0, "force_limit": 1e-9, "delay": 0.0}
    )
    fish = FISH.model_copy(
        update={"tendons": soft, "tail": tail, "servos": {"off": off}, "servo": "off"}
    )
    drifts = []
    for dt in (2e-3, 1e-3, 5e-4):
        plant = as_strips(build_plant(fish, [BARE], dt=dt))
        state = at_rest(plant)
        rng = np.random.default_rng(1)
        state.v[:] = rng.normal(0, 1, state.v.shape) * [0.3, 0.3, 1, 3, 2, 2, 2, 2, 2]
        before = conserved(plant, state.q[0], state.v[0])
        step_plant(plant, state, np.zeros((1, round(1.0 / dt))))
        after = conserved(plant, state.q[0], state.v[0])
        drifts.append(np.abs(after - before) / np.abs(before).max())
    assert drifts[0].max() < 0.02
    assert drifts[1].max() < 0.5 * drifts[0].max()
    assert drifts[2].max() < 0.5 * drifts[1].max()


def conserved(plant: Plant, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Energy [J] and linear momentum [N s] of fish and water."""
    found, chain = assembled(plant, q, v, wet=True), plant.chain
    tendon_lengths(q, chain, found.frames, found.lengths, found.pulls)
    stretch = found.lengths - chain.neutral
    elastic = 0.5 * chain.hinges["stiffness"] @ q[4:] ** 2
    elastic += 0.5 * chain.tendon[0]["stiffness"] * stretch @ stretch
    return np.array([0.5 * v @ found.mass @ v + elastic, *(found.mass @ v)[:2]])


# ---- behaviour ----------------------------------------------------------------------------------


def speed(plant: Plant, commands: np.ndarray, every: int) -> float:
    swum = step_plant(plant, at_rest(plant), commands, every)
    late = swum.q[0, swum.time > swum.time[-1] - 4]
    way = late[-1, :2] - late[0, :2]
    heading = late[:, 2].mean()
    return float(way @ [np.cos(heading), np.sin(heading)]) / 4


@pytest.mark.thorough
@pytest.mark.parametrize(("frequency", "stroke"), [(1.0, 0.9), (2.0, 0.6), (4.0, 0.35)])
def test_two_milliseconds_are_short_enough(frequency, stroke):
    speeds = []
    for dt in (0.002, 0.0005):
        plant = build_plant(FISH, dt=dt)
        speeds.append(speed(plant, sine(plant, frequency, stroke, 10.0), round(0.02 / dt)))
    assert speeds[0] == pytest.approx(speeds[1], rel=0.02)
    assert speeds[0] > 0.1


def test_a_mirrored_command_gives_a_mirrored_swim():
    plant = build_plant(FISH)
    command = sine(plant, 1.5, 0.5, 3.0) + 0.2
    left = step_plant(plant, at_rest(plant), command)
    right = step_plant(plant, at_rest(plant), -command)
    assert left.q[0, -1, 0] == pytest.approx(right.q[0, -1, 0], rel=1e-9)
    assert left.q[0, -1, 1:] == pytest.approx(-right.q[0, -1, 1:], rel=1e-9)
    assert left.q[0, -1, 3] > 0  # the motor followed


def test_a_positive_motor_angle_bends_the_tip_to_the_left():
    plant = build_plant(FISH, around=[Surroundings(held=True)])
    swum = step_plant(plant, at_rest(plant), np.full((1, 1000), 0.5))
    assert swum.q[0, -1, 3] > 0.2
    assert swum.q[0, -1, 4:].sum() > 0.1  # hinges turn about -z: the tip, behind, goes left


def test_a_batch_equals_its_members_and_a_pause_changes_nothing():
    waters = ensemble(5, seed=3)
    servos = [FISH.servos[name] for name in ("identified", "idealised")] * 2 + [
        FISH.servos["identified"]
    ]
    around = [stirred(i) for i in range(5)]
    plant = build_plant(FISH, waters, servos, around, dt=0.001)
    command = np.repeat(sine(plant, 2.0, 0.5, 2.0), 5, axis=0)
    together = step_plant(plant, at_rest(plant), command)
    for i in (1, 4):
        alone = build_plant(FISH, [waters[i]], [servos[i]], [around[i]], dt=0.001)
        assert np.array_equal(step_plant(alone, at_rest(alone), command[:1]).q[0], together.q[i])
    state = at_rest(plant)
    step_plant(plant, state, command[:, :777])
    kept = state.copy()
    second = step_plant(plant, state, command[:, 777:])
    assert np.array_equal(second.q[:, -1], together.q[:, -1])
    assert np.array_equal(step_plant(plant, kept, command[:, 777:]).q, second.q)


def test_the_servo_hears_the_command_its_delay_later():
    slow = FISH.servos["identified"]
    quick = slow.model_copy(update={"delay": 0.0})
    plant = build_plant(FISH, servo=[quick, slow.model_copy(update={"delay": 0.0125})])
    command = np.zeros((2, 500))
    command[:, 100:] = 0.5
    angle = step_plant(plant, at_rest(plant), command).q[:, :, 3]
    time = plant.dt * np.arange(501)
    reached = [np.interp(0.05, a, time) for a in angle]
    assert reached[1] - reached[0] == pytest.approx(0.0125, abs=4e-4)


def test_a_poke_gives_its_momentum_and_walls_hold():
    poked = Surroundings(pokes=((0.1, 0.05, 0.0, 4.0, 0.0),))
    plant = build_plant(FISH, [BARE], around=[poked])
    state = at_rest(plant)
    step_plant(plant, state, np.zeros((1, 100)))
    mass = assembled(plant, state.q[0], state.v[0], wet=True).mass
    assert (mass @ state.v[0])[1] == pytest.approx(4.0 * 0.05, rel=0.06)  # less what lift took
    small = build_plant(FISH, around=[Surroundings(walls=(1.5, 1.0))])
    swum = step_plant(small, at_rest(small), sine(small, 1.5, 0.8, 20.0), 10)
    assert np.abs(swum.q[0, :, 0]).max() < 0.9 and np.abs(swum.q[0, :, 1]).max() < 0.7


def test_stirred_water_has_no_divergence_and_carries_a_fish():
    modes = np.array(list(stirred(4, size=0.05).modes), MODE)
    rng, h = np.random.default_rng(0), 1e-5
    for x, y, t in rng.uniform(-2, 2, (20, 3)):
        du = current(x + h, y, t, modes)[0] - current(x - h, y, t, modes)[0]
        dv = current(x, y + h, t, modes)[1] - current(x, y - h, t, modes)[1]
        assert abs(du + dv) / (2 * h) < 1e-6
    drift = build_plant(FISH, around=[Surroundings(modes=((0.4, 0.0, 1e-6, 0.0, 0.0),))])
    swum = step_plant(drift, at_rest(drift), np.zeros((1, 10_000)))
    assert swum.v[0, -1, 0] == pytest.approx(0.4, rel=0.1)


def test_every_parameter_of_the_water_changes_a_swim():
    plant = build_plant(FISH)
    command = sine(plant, 1.5, 0.7, 3.0)
    base = step_plant(plant, at_rest(plant), command).q[0, -1]
    changes: dict[str, Any] = {
        "density": 900.0, "suction": 0.3, "vortex": 0.5, "fin_drag": 2.0, "fin_friction": 0.06,
        "body_friction": 0.08, "body_drag": 1.0, "along": 0.08, "added_mass": 1.2,
        "lag_pressure": 3.0, "lag_separation": 6.0, "stall_angle": 14.0, "stall_before": 5.0,
        "stall_after": 5.0, "edge_vortices": 1.0, "lag": "section", "with_lag": False,
        "with_stall": False, "with_added_inertia": False,
    }  # fmt: skip
    for name, value in changes.items():
        other = build_plant(FISH, [replace(Water(), **{name: value})])
        moved = step_plant(other, at_rest(other), command).q[0, -1] - base
        assert np.abs(moved).max() > 1e-5, name
    assert len(ROW.names or ()) == 22 and set(ablations()) >= {"full", "no lag", "no stall"}


def random_year(count: int, seed: int) -> np.ndarray:
    """Fish that were lost among `count` random 10 s commands in random pools."""
    rng = np.random.default_rng(seed)
    servos = [FISH.servos["identified"], FISH.servos["idealised"]]
    chosen = [servos[i] for i in rng.integers(2, size=count)]
    around = [
        replace(
            stirred(int(k), size=rng.uniform(0, 0.1)),
            walls=(5.5, 2.7) if k % 2 else None,
            pokes=((rng.uniform(0, 9), 0.2, *rng.normal(0, 5, 2), rng.normal(0, 0.5)),),
        )
        for k in rng.integers(1000, size=count)
    ]
    plant = build_plant(FISH, ensemble(count, seed), chosen, around)
    time = np.arange(0, 10, 0.02)
    rate = rng.uniform(0, 12, (count, 1)) + rng.uniform(-2, 2, (count, 1)) * np.sin(time)
    phase = 2 * np.pi * np.cumsum(rate, axis=1) * 0.02
    sizes = rng.normal(0, 0.7, (5, count, 1))
    command = sizes[0] + sizes[1] * np.cos(phase) + sizes[2] * np.sin(phase)
    command += sizes[3] * np.cos(2 * phase) + sizes[4] * np.sin(2 * phase)
    held = np.repeat(np.clip(command, -1.39, 1.39), 10, axis=1)
    state = at_rest(plant)
    state.v[:, :3] = rng.normal(0, 0.5, (count, 3))
    swum = step_plant(plant, state, held, 50)
    return swum.lost | (np.abs(swum.q[:, :, 4:]).max(axis=(1, 2)) > np.pi)


ALONE = """
import numba, numpy as np
from tailbeat.fish.store import load_fish
from tailbeat.pool.plant import at_rest, build_plant, step_plant
plant = build_plant(load_fish("pulley-fish"))
step_plant(plant, at_rest(plant), np.zeros((1, 2)))
try:
    print(numba.threading_layer())
except ValueError:  # none was started
    print("no threads")
"""


def test_a_fish_alone_is_stepped_without_a_pool_of_threads():
    """On a busy machine they waited for each other, 35 ms a step: the servo's emulator was late."""
    done = subprocess.run([sys.executable, "-c", ALONE], capture_output=True, text=True)
    assert done.stdout == "no threads\n", done.stderr


@pytest.mark.parametrize("speed", [1e2, 1e8, 1e200])
def test_a_fish_that_diverges_is_lost_and_leaves_the_others_alone(speed):
    """Far enough, the compiled step divides by zero: its samples are not finite from there on."""
    water = replace(Water(), with_added_inertia=False)
    plant, alone = build_plant(FISH, [water] * 2), build_plant(FISH, [water])
    commands = np.repeat(sine(plant, 2.0, 0.5, 0.6), 2, axis=0)
    state = at_rest(plant)
    state.v[1] = speed
    swum = step_plant(plant, state, commands)
    assert swum.lost.tolist() == [False, True]
    assert not np.isfinite(swum.q[1, -1]).any() and not np.isfinite(state.q[1]).any()
    assert np.array_equal(swum.q[0], step_plant(alone, at_rest(alone), commands[:1]).q[0])


@pytest.mark.thorough
@pytest.mark.long
def test_no_fish_is_lost_in_24_random_swims():
    assert not random_year(24, seed=0).any()


@pytest.mark.slow
def test_no_fish_is_lost_in_a_random_year():
    for seed in range(10):
        assert not random_year(1000, seed).any()


# ---- bad input, and the frozen numbers ----------------------------------------------------------


def test_what_the_plant_cannot_carry_is_refused():
    with pytest.raises(BadInput, match=r"step 20 ms; at most"):
        build_plant(FISH, dt=0.02)
    zones = FISH.model_dump()
    zones["tail"]["links"][-1]["parts"][-1]["zone"] = "tail"
    with pytest.raises(BadInput, match="no part has zone fin"):
        build_chain(type(FISH).model_validate(zones))
    with pytest.raises(BadInput, match="give one of each"):
        build_plant(FISH, ensemble(3, 0), around=[stirred(0), stirred(1)])


def test_the_water_is_frozen():
    """The hash stands in docs/explain/pool.md: a change of the water changes every result."""
    page = (Path(__file__).parents[1] / "docs" / "explain" / "pool.md").read_text()
    assert f"`{fingerprint()}`" in page


def test_the_solver_solves():
    rng = np.random.default_rng(0)
    square = rng.normal(size=(9, 9))
    matrix, rhs = square @ square.T + np.eye(9), rng.normal(size=9)
    found = rhs.copy()
    solve(matrix.copy(), found)
    assert matrix @ found == pytest.approx(rhs)
