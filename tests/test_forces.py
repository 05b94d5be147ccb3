"""The fluid law: ours equals the engine's, both equal closed forms, and the engine is pinned."""

from copy import copy
from dataclasses import fields

import mujoco
import numpy as np
import pytest

from forces import (
    FluidForces,
    clamped_kutta,
    ellipsoid_forces,
    fluid_forces,
    generalised,
    geom_semi_axes,
    virtual_mass_and_inertia,
)
from tailbeat.fish import edge
from tailbeat.fish.store import load_fish, shipped
from tailbeat.fish.twin import compile_twin

COMPONENTS = [field.name for field in fields(FluidForces)]
VISCOUS = {"viscous_drag", "viscous_torque"}
SPEEDS = (0.01, 0.03, 0.1, 0.3, 1.0)
PLATES = [  # semi-axes of published fish: fishsim's tail plate and connector, two fins [m]
    (0.0075, 0.0015, 0.05),
    (0.0327, 0.001, 0.1015),
    (0.005, 0.0005, 0.0225),
    (0.077, 0.0025, 0.05),
]
SHAPES = {"ellipsoid": 3, "box": 3, "capsule": 2, "cylinder": 2, "sphere": 1}


def geom(rng: np.random.Generator, kind: str, wet: bool = True) -> str:
    size = " ".join(f"{s:.5f}" for s in 10 ** rng.uniform(-3, -1, SHAPES[kind]))
    coefficients = " ".join(f"{c:.3f}" for c in rng.uniform(0, 10, 5))
    place = " ".join(f"{p:.3f}" for p in rng.uniform(-0.1, 0.1, 3))
    turn = " ".join(f"{a:.1f}" for a in rng.uniform(-180, 180, 3))
    fluid = f'fluidshape="ellipsoid" fluidcoef="{coefficients}"' if wet else ""
    return f'<geom type="{kind}" size="{size}" pos="{place}" euler="{turn}" mass="1" {fluid}/>'


def random_chain(rng: np.random.Generator) -> mujoco.MjModel:
    """A free chain with every geom type, two wet geoms and a dry one per body, in wind."""
    text = ""
    kinds = list(SHAPES)
    for kind, other in zip(kinds, rng.permutation(kinds), strict=True):
        joint = "ball" if text else "free"
        text += f'<body pos="-.1 .01 .02"><joint type="{joint}"/>{geom(rng, kind)}'
        text += geom(rng, str(other)) + geom(rng, "box", wet=False)
    return mujoco.MjModel.from_xml_string(
        '<mujoco><option density="1000" viscosity="0.05" wind=".1 -.2 .05"/>'
        f"<worldbody>{text}{'</body>' * len(kinds)}</worldbody></mujoco>"
    )


def plate(axes: tuple[float, ...], coefficients: str = "0 0 0 0 0") -> mujoco.MjModel:
    size = " ".join(map(str, axes))
    return mujoco.MjModel.from_xml_string(
        '<mujoco><option density="1000" gravity="0 0 0"/><worldbody><body><freejoint/>'
        f'<geom type="ellipsoid" size="{size}" mass="1" fluidshape="ellipsoid"'
        f' fluidcoef="{coefficients}"/></body></worldbody></mujoco>'
    )


def random_batch(count: int = 300) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(2)
    axes = 10 ** rng.uniform(-3, -1, (count, 3))
    mass, inertia = virtual_mass_and_inertia(axes)
    return {
        "velocity": rng.normal(size=(count, 3)),
        "angular_velocity": rng.normal(size=(count, 3)),
        "semi_axes": axes,
        "coefficients": rng.uniform(0, 10, (count, 5)),
        "virtual_mass": mass,
        "virtual_inertia": inertia,
    }


def error_against_engine(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    """The engine gets the coefficients that a trailing edge gives at this state."""
    mujoco.mj_forward(model, data)
    ours = generalised(model, data, fluid_forces(model, data))
    if (blend := edge.blend_of(model)) is not None:
        where, model = edge.chords(model), copy(model)
        speed = edge.chord_speeds(where, data.qpos[None], data.qvel[None], np.zeros((1, 3)))
        model.geom_fluid[where.geom, edge.KUTTA] *= edge.weights(speed, blend)[0]
        mujoco.mj_forward(model, data)
    return float(np.linalg.norm(ours - data.qfrc_fluid) / np.linalg.norm(data.qfrc_fluid))


# ---- ours equals the engine's -------------------------------------------------------------------


def test_law_equals_the_engine_over_random_states():
    rng = np.random.default_rng(0)
    errors = []
    for _ in range(30):
        model = random_chain(rng)
        model.geom_fluid[:, 0] *= rng.uniform(0.5, 2, model.ngeom)  # any positive scale counts
        data = mujoco.MjData(model)
        for speed in 10 ** rng.uniform(-3, 1, 10):
            data.qpos[:] = rng.normal(size=model.nq)
            data.qvel[:] = speed * rng.normal(size=model.nv)
            errors.append(error_against_engine(model, data))
    assert len(errors) == 300
    assert max(errors) < 1e-10


@pytest.mark.parametrize("name", shipped())
def test_law_equals_the_engine_on_shipped_fish(name):
    model = compile_twin(load_fish(name)).model
    data = mujoco.MjData(model)
    rng = np.random.default_rng(1)
    for _ in range(20):
        data.qpos[:] = rng.normal(scale=0.3, size=model.nq)
        data.qvel[:] = rng.normal(size=model.nv)
        assert error_against_engine(model, data) < 1e-10


def test_dry_geoms_have_zero_rows():
    model = random_chain(np.random.default_rng(4))
    data = mujoco.MjData(model)
    data.qvel[:] = 1.0
    mujoco.mj_forward(model, data)
    forces = fluid_forces(model, data)
    dry = model.geom_fluid[:, 0] == 0
    assert forces.force.shape == (model.ngeom, 3)
    assert not forces.force[dry].any() and not forces.torque[dry].any()
    assert np.all(forces.force[~dry].any(axis=1))


def test_batch_equals_one_by_one():
    batch = random_batch(6)
    stacked = {name: value.reshape(2, 3, -1) for name, value in batch.items()}
    whole = ellipsoid_forces(**stacked, density=1000, viscosity=0.001)
    assert whole.force.shape == (2, 3, 3)
    for i in range(6):
        one = {name: value[i] for name, value in batch.items()}
        single = ellipsoid_forces(**one, density=1000, viscosity=0.001)
        for name in COMPONENTS:
            assert np.array_equal(getattr(whole, name).reshape(6, 3)[i], getattr(single, name))


def test_one_geom_broadcasts_over_velocities():
    speeds = np.random.default_rng(5).normal(size=(7, 3))
    found = ellipsoid_forces(
        speeds, [0, 1, 2], PLATES[0], [1] * 5, [1e-5] * 3, [1e-9] * 3, density=1000, viscosity=0.001
    )
    assert all(getattr(found, name).shape in {(7, 3), (3,)} for name in COMPONENTS)
    assert found.force.shape == found.torque.shape == (7, 3)


# ---- how forces grow ----------------------------------------------------------------------------


@pytest.mark.parametrize("axes", PLATES)
def test_each_component_grows_with_speed_squared(axes):
    mass, inertia = virtual_mass_and_inertia(axes)
    v, w = np.array([1.0, 0.5, 0.2]), np.array([3.0, -2.0, 1.0])
    ladder = np.array(SPEEDS)[:, None]
    found = ellipsoid_forces(
        ladder * v, ladder * w, axes, np.ones(5), mass, inertia, density=1000, viscosity=0.001
    )
    for name in COMPONENTS:
        power = 1 if name in VISCOUS else 2
        scaled = getattr(found, name) / ladder**power
        assert np.abs(scaled[-1]).max() > 0
        assert scaled == pytest.approx(np.broadcast_to(scaled[-1], scaled.shape), rel=1e-12)


TERMS = {"blunt": 0, "slender": 1, "angular": 2, "Kutta": 3, "Magnus": 4, "added mass": 5}


@pytest.mark.parametrize("axes", PLATES)
@pytest.mark.parametrize("term", TERMS)
def test_engine_forces_grow_with_speed_squared(axes, term):
    """Kutta lift did not up to MuJoCo 3.13; coefficients from there are not ours."""
    switches = np.eye(6)[TERMS[term]]
    model = plate(axes, " ".join(map(str, switches[:5])))
    model.geom_fluid[:, 6:12] *= switches[5]
    data = mujoco.MjData(model)
    scaled = []
    for speed in SPEEDS:
        data.qvel[:] = speed * np.array([1.0, 0.5, 0.2, 3.0, -2.0, 1.0])
        mujoco.mj_forward(model, data)
        scaled.append(data.qfrc_fluid / speed**2)
    assert np.abs(scaled[0]).max() > 0
    assert np.allclose(scaled, scaled[-1], rtol=1e-9, atol=1e-12 * np.abs(scaled[-1]).max())


# ---- energy and symmetry ------------------------------------------------------------------------


def test_drag_takes_energy_and_lift_does_no_work():
    batch = random_batch()
    found = ellipsoid_forces(**batch, density=1000, viscosity=0.001)
    v, w = batch["velocity"], batch["angular_velocity"]
    for force in (found.drag, found.viscous_drag):
        assert np.all(np.sum(force * v, axis=1) < 0)
    for torque in (found.angular_drag, found.viscous_torque):
        assert np.all(np.sum(torque * w, axis=1) < 0)
    for lift in (found.kutta, found.magnus):
        size = np.linalg.norm(lift, axis=1) * np.linalg.norm(v, axis=1)
        assert np.all(np.abs(np.sum(lift * v, axis=1)) < 1e-12 * size)


def test_velocity_half_of_added_mass_does_no_work():
    batch = random_batch()
    found = ellipsoid_forces(**batch, density=1000, viscosity=0)
    force = np.sum(found.added_mass * batch["velocity"], axis=1)
    torque = np.sum(found.added_mass_torque * batch["angular_velocity"], axis=1)
    assert np.all(np.abs(force + torque) < 1e-12 * (np.abs(force) + np.abs(torque)) + 1e-15)


def test_mirrored_motion_gives_mirrored_force():
    batch = random_batch()
    mirror = np.array([1, -1, 1])  # reflect y; torque and spin are axial and turn the other way
    reflected = {
        **batch,
        "velocity": batch["velocity"] * mirror,
        "angular_velocity": batch["angular_velocity"] * -mirror,
    }
    found = ellipsoid_forces(**batch, density=1000, viscosity=0.001)
    other = ellipsoid_forces(**reflected, density=1000, viscosity=0.001)
    for name in COMPONENTS:
        sign = -mirror if "torque" in name or name == "angular_drag" else mirror
        assert getattr(other, name) == pytest.approx(getattr(found, name) * sign, rel=1e-12)


# ---- closed forms -------------------------------------------------------------------------------


def test_sphere_carries_half_its_volume_and_no_inertia():
    mass, inertia = virtual_mass_and_inertia(np.full(3, 0.05))
    assert mass == pytest.approx(np.full(3, 0.5 * 4 / 3 * np.pi * 0.05**3), rel=1e-12)
    assert not inertia.any()


def test_thin_disc_carries_the_water_of_lamb():
    """A disc moved broadside carries 8/3 ρ r³ and turned about a diameter 16/45 ρ r⁵ (Lamb)."""
    mass, inertia = virtual_mass_and_inertia([0.05, 0.05, 1e-7])
    assert mass[2] == pytest.approx(8 / 3 * 0.05**3, rel=1e-4)
    assert inertia[:2] == pytest.approx(np.full(2, 16 / 45 * 0.05**5), rel=1e-4)
    assert inertia[2] == 0


@pytest.mark.parametrize(
    ("axes", "accuracy"), [*((p, 1e-4) for p in PLATES), ((0.1, 5e-4, 0.05), 1e-3)]
)
def test_virtual_mass_equals_the_compiled_model(axes, accuracy):
    """The engine's 15-point quadrature sets how near; ours is exact."""
    engine = plate(axes).geom_fluid[0, 6:12]
    assert np.concatenate(virtual_mass_and_inertia(axes)) == pytest.approx(engine, rel=accuracy)


def test_virtual_mass_equals_the_compiled_model_for_every_shape():
    model = random_chain(np.random.default_rng(3))
    wet = model.geom_fluid[:, 0] > 0
    mass, inertia = virtual_mass_and_inertia(geom_semi_axes(model)[wet])
    assert mass == pytest.approx(model.geom_fluid[wet, 6:9], rel=1e-2)
    assert inertia == pytest.approx(model.geom_fluid[wet, 9:12], rel=1e-2)


def test_munk_moment():
    axes = np.array([0.1, 0.02, 0.05])
    mass, inertia = virtual_mass_and_inertia(axes)
    v = np.array([0.3, 0.1, 0.0])
    found = ellipsoid_forces(
        v, np.zeros(3), axes, np.zeros(5), mass, inertia, density=1000, viscosity=0
    )
    munk = 1000 * (mass[0] - mass[1]) * v[0] * v[1]  # < 0: turns the long axis across the stream
    assert munk < 0
    assert found.torque == pytest.approx([0, 0, munk], rel=1e-12)
    assert not found.force.any()


def test_stokes_drag_of_a_sphere():
    v, w, radius, viscosity = np.array([0.3, 0.1, 0.0]), np.array([1.0, 2.0, 3.0]), 0.02, 0.01
    nothing = np.zeros(3)
    found = ellipsoid_forces(
        v, w, np.full(3, radius), np.zeros(5), nothing, nothing, density=1000, viscosity=viscosity
    )
    assert found.force == pytest.approx(-6 * np.pi * viscosity * radius * v, rel=1e-12)
    assert found.torque == pytest.approx(-8 * np.pi * viscosity * radius**3 * w, rel=1e-12)


def test_blunt_coefficient_is_half_of_the_usual_drag_coefficient():
    found = ellipsoid_forces(
        [2.0, 0, 0],
        np.zeros(3),
        np.full(3, 0.1),
        [0.25, 0, 0, 0, 0],
        np.zeros(3),
        np.zeros(3),
        density=1000,
        viscosity=0,
    )
    half_rho_v2_area_cd = 0.5 * 1000 * 2.0**2 * np.pi * 0.1**2 * 0.5
    assert found.force == pytest.approx([-half_rho_v2_area_cd, 0, 0], rel=1e-12)


def test_rest_gives_no_force():
    axes, nothing = np.array(PLATES[0]), np.zeros(3)
    found = ellipsoid_forces(nothing, nothing, axes, np.ones(5), axes, axes, 1000, 0.001)
    assert not found.force.any() and not found.torque.any()
    assert clamped_kutta(nothing, axes, 1.0, 1000).fraction == 0


# ---- the engine, pinned -------------------------------------------------------------------------


def test_engine_lacks_the_acceleration_half_of_added_mass():
    """A neutrally buoyant sphere pushed by 1 N: 1.910 m/s^2 in the engine, 1.273 in water."""
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><option density="1000" gravity="0 0 0"/><worldbody><body><freejoint/>'
        '<geom type="sphere" size=".05" density="1000" fluidshape="ellipsoid"/></body></worldbody>'
        "</mujoco>"
    )
    data = mujoco.MjData(model)
    data.xfrc_applied[1, 0] = 1.0
    mujoco.mj_forward(model, data)
    mass = 1000 * 4 / 3 * np.pi * 0.05**3
    assert data.qacc[0] == pytest.approx(1 / mass, rel=1e-12)
    assert 1 / mass == pytest.approx(1.910, abs=5e-4)
    assert 1 / (1.5 * mass) == pytest.approx(1.273, abs=5e-4)


MEASURED_AT_20 = [  # semi-axes [mm]: share kept by MuJoCo <= 3.13 at 20 degrees, by speed [m/s]
    ((40, 20, 25), {0.02: 0.001, 0.05: 0.02, 0.1: 0.17, 0.2: 1}),
    ((20, 10, 20), {0.05: 0.001, 0.1: 0.004, 0.2: 0.035, 0.5: 0.55, 1.0: 1}),
    ((15, 4, 15), {0.2: 0.003, 0.5: 0.04, 1.0: 0.31}),
    ((30, 1, 30), {0.02: 0.001, 0.05: 0.01, 0.1: 0.08, 0.2: 0.61, 0.5: 1}),
    ((20, 0.5, 20), {0.1: 0.003, 0.2: 0.024, 0.5: 0.37, 1.0: 1}),
]
MEASURED_AT_45 = [
    ((50, 20, 50), {0.01: 0.02, 0.03: 0.54, 0.1: 1}),
    ((30, 0.9, 50), {0.01: 0.003, 0.03: 0.07, 0.1: 1}),
    ((7.5, 1.5, 50), {0.1: 0.01, 0.3: 0.27, 1.0: 1}),
    ((5, 0.5, 22.5), {0.3: 0.002, 1.0: 0.08, 3.0: 1}),
]


@pytest.mark.parametrize(
    ("incidence", "axes", "shares"),
    [*((20, *row) for row in MEASURED_AT_20), *((45, *row) for row in MEASURED_AT_45)],
)
def test_old_engines_lost_kutta_lift_at_fish_scale(incidence, axes, shares):
    angle = np.radians(incidence)
    v = np.outer(list(shares), [np.cos(angle), np.sin(angle), 0])
    found = clamped_kutta(v, 1e-3 * np.array(axes), 1.0, 1000)
    # The table is rounded to two decimals, or to one digit below that.
    assert found.fraction == pytest.approx(list(shares.values()), rel=0.1, abs=6e-4)


def test_clamped_kutta_meets_the_law_where_no_guard_acts():
    v = np.array([[2.0, 1.0, 0.5], [0.02, 0.01, 0.005]])
    axes = np.array(PLATES[0])
    old = clamped_kutta(v, axes, 3.0, 1000)
    new = ellipsoid_forces(
        v, np.zeros(3), axes, [0, 0, 0, 3.0, 0], np.zeros(3), np.zeros(3), 1000, 0
    ).kutta
    assert old.fraction[0] == 1 and old.fraction[1] < 1e-3
    assert old.force == pytest.approx(old.fraction[:, None] * new, rel=1e-12)


def test_clamped_kutta_fades_like_the_fifth_power():
    v = np.array([[0.02, 0.01, 0.0], [0.04, 0.02, 0.0]])
    force = np.linalg.norm(clamped_kutta(v, PLATES[0], 1.0, 1000).force, axis=1)
    assert force[1] / force[0] == pytest.approx(2**5, rel=1e-9)


# ---- bad input ----------------------------------------------------------------------------------


def test_wrong_shapes_are_named():
    one = np.ones(3)
    with pytest.raises(
        ValueError, match=r"coefficients has shape \(4,\); its last axis must have 5"
    ):
        ellipsoid_forces(one, one, one, np.ones(4), one, one, 1000, 0)
    with pytest.raises(ValueError, match=r"semi_axes must be above zero, smallest is -0\.1 m"):
        virtual_mass_and_inertia([0.1, -0.1, 0.1])
