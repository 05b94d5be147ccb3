"""Guides of a tendon that meet when a hinge bends: there the tendon has no arm left."""

import mujoco
import numpy as np
import pytest

from near_guides import sketched
from tailbeat.emulators.plant_shaft import PlantShaft
from tailbeat.evaluate.zoo import animals
from tailbeat.files import BadInput
from tailbeat.fish import check, convergence
from tailbeat.fish.description import Fish, Simulation, length_of
from tailbeat.fish.linkage import at_shaft, free_bends, moment_arms
from tailbeat.fish.proportions import Given
from tailbeat.fish.store import load_fish
from tailbeat.fish.twin import Options, compile_twin
from tailbeat.identify import step_check
from tailbeat.pool.plant import at_rest, build_plant, step_plant
from tailbeat.pool.water import Water

STOUT = Given(0.175, 0.1, 3, "xl330", k_eff=0.0277)  # heavier than the pulley fish's shape would be
TURNING = Given(0.164, 0.1, 4, "xl330", k_eff=0.0232)


def full_bends(fish: Fish) -> np.ndarray:
    """Bend of the hinges under a slow pull over the motor's whole range [rad]."""
    assert fish.motor.range is not None
    return at_shaft(fish).bend * fish.motor.range[1]


@pytest.mark.parametrize("fish", [load_fish("pulley-fish-pool"), sketched(STOUT)])
def test_where_guides_meet_a_tendon_of_the_compiled_twin_turns_its_pull(fish):
    twin = compile_twin(fish, Options(root="fixed"))
    data = mujoco.MjData(twin.model)
    first = int(twin.model.joint("motor").qposadr[0]) + 1
    for hinge, free in enumerate(free_bends(fish)):
        arms = []
        for share in (0.98, 1.02):
            mujoco.mj_resetData(twin.model, data)
            data.qpos[first + hinge] = share * free  # to the left, where the left guides close
            mujoco.mj_forward(twin.model, data)
            arms.append(moment_arms(twin, data)[0][hinge])
        assert arms[0] > 0 > arms[1]


@pytest.mark.parametrize("hinges", [2, 3, 5, 8])
@pytest.mark.parametrize("mass", [0.06, 0.1, 0.16])
def test_no_sketch_bends_a_hinge_until_its_guides_meet(hinges, mass):
    fish = sketched(Given(0.18, mass, hinges, "xl330"))
    assert (full_bends(fish) < 0.9 * free_bends(fish)).all()


@pytest.mark.parametrize("seed", range(6))
def test_no_fish_of_a_zoo_bends_a_hinge_until_its_guides_meet(seed):
    for one in animals(seed):
        if one.given is not None:
            fish = sketched(one.given)
            assert (full_bends(fish) < 0.95 * free_bends(fish)).all(), one.name


@pytest.mark.thorough
def test_the_check_names_the_hinge_whose_guides_meet():
    narrow, wide, shipped = sketched(STOUT, narrow=True), sketched(STOUT), load_fish("pulley-fish")
    said = check.check(narrow, length_of(narrow)).warnings
    assert (
        "hinge 1 of 3 bends by 46 deg at full stroke, and its tendon's guides meet at 39" in said[0]
    )
    for fish in (wide, shipped):
        assert not [one for one in check.check(fish, length_of(fish)).warnings if "guides" in one]


def held_time(seconds: int, step: float) -> np.ndarray:
    """The time of each step [s], held for 20 ms as the robot's loop holds its setpoints."""
    return np.floor(np.arange(round(seconds / step)) * step / 0.02 + 1e-9) * 0.02


def full_stroke(fish: Fish, step: float) -> np.ndarray:
    """Poses of the head at each 20 ms of four seconds at full stroke and the lowest beat, in the
    virtual pool."""
    assert fish.motor.range is not None
    plant = build_plant(fish, dt=step)
    time = held_time(4, step)
    command = fish.motor.range[1] * np.sin(2 * np.pi * fish.band[0] * time)
    swum = step_plant(plant, at_rest(plant), command[None], round(0.02 / step))
    return np.asarray(swum.q[0, :, :3])


def test_in_the_virtual_pool_a_stout_fish_swims_alike_at_any_step():
    fish = sketched(STOUT)
    usual, fine = full_stroke(fish, 2e-3), full_stroke(fish, 2.5e-4)
    way = np.hypot(*np.diff(fine[:, :2], axis=0).T).sum()
    assert np.hypot(*(usual - fine)[:, :2].T).max() < 0.01 * way
    assert not np.isfinite(full_stroke(sketched(STOUT, narrow=True), 2e-3)).all()


def any_commands(fish: Fish, swims: int, seconds: int, step: float) -> np.ndarray:
    """Setpoints of beats, strokes and centres that change every two seconds."""
    assert fish.motor.range is not None
    rng, most = np.random.default_rng(1), fish.motor.range[1]
    each = swims, seconds // 2, 1
    beat = rng.uniform(fish.band[0] / 4, fish.band[1], each)
    stroke, centre = rng.uniform(0, most, each), rng.uniform(-0.7 * most, 0.7 * most, each)
    held = centre + stroke * np.sin(2 * np.pi * beat * held_time(2, step))
    return np.asarray(np.clip(held, -most, most).reshape(swims, -1))


@pytest.mark.parametrize("seed", [0, 3])
def test_no_swim_of_a_zoo_s_smallest_fish_is_lost_in_the_virtual_pool(seed):
    given = animals(seed)[0].given
    assert given is not None
    for narrow in (True, False):
        fish = sketched(given, narrow)
        plant = build_plant(fish, [Water()] * 8)
        commands = any_commands(fish, 8, 10, plant.dt)
        lost = step_plant(plant, at_rest(plant), commands, 10).lost.sum()
        assert lost >= 4 if narrow else lost == 0


def test_an_emulated_fish_that_diverges_is_named():
    fish = sketched(STOUT, narrow=True)
    shaft = PlantShaft(fish=fish)
    assert fish.motor.range is not None
    with pytest.raises(BadInput, match="sketch: diverges in the virtual pool"):
        for step in range(200):
            turn = np.sin(2 * np.pi * fish.band[0] * 0.02 * step)
            shaft.advance(float(fish.motor.range[1] * turn), 0.02)


@pytest.mark.thorough
def test_a_shorter_step_that_hardly_errs_less_is_not_taken():
    """Its guides meet, and it ends at another place with every step."""
    fish = sketched(TURNING, narrow=True)
    coarse, fine = (Simulation(step=step, integrator="Euler") for step in (0.004, 0.0005))
    errors = [convergence.deviation(fish, one).error for one in (coarse, fine)]
    assert min(errors) > convergence.ALLOWED
    assert convergence.choose(fish, (coarse, fine)).simulation == coarse
    kept = step_check.held(fish.model_copy(update={"simulation": coarse}))
    assert not kept.changed and "shorter ones hardly less" in kept.warnings[0]
