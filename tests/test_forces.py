"""The fluid law: ours equals the engine's, and both equal closed forms. Pins the engine."""

import mujoco
import numpy as np
import pytest

from tailbeat.fish.forces import (
    clamped_share,
    ellipsoid_forces,
    generalised,
    kutta_area,
    model_forces,
    semi_axes,
    virtual_mass_and_inertia,
    wetted,
)
from tailbeat.fish.store import load_fish, shipped
from tailbeat.fish.twin import compile_twin

THIN = [
    (0.0075, 0.0015, 0.05),
    (0.0327, 0.001, 0.1015),
    (0.005, 0.0005, 0.0225),
    (0.077, 0.0025, 0.05),
]
SIZES = {"ellipsoid": 3, "box": 3, "capsule": 2, "cylinder": 2, "sphere": 1}


def random_chain(rng: np.random.Generator) -> mujoco.MjModel:
    """A free chain of every geom type with random sizes and coefficients, wind and viscosity."""
    text = ""
    for i, (kind, count) in enumerate(SIZES.items()):
        size = " ".join(f"{s:.4f}" for s in rng.uniform(0.002, 0.1, count))
        coefficients = " ".join(f"{c:.3f}" for c in rng.uniform(0, 3, 5))
        joint = "free" if i == 0 else "ball"
        place = "0 0 0" if i == 0 else "-.1 .01 .02"
        text += (
            f'<body pos="{place}"><joint type="{joint}"/><geom type="{kind}" size="{size}"'
            f' pos=".02 0 .01" euler="10 20 30" mass="1" fluidshape="ellipsoid"'
            f' fluidcoef="{coefficients}"/>'
        )
    return mujoco.MjModel.from_xml_string(
        '<mujoco><option density="1000" viscosity="0.01" wind=".1 -.2 .05"/>'
        f"<worldbody>{text}{'</body>' * 5}</worldbody></mujoco>"
    )


def test_law_equals_the_engine_over_random_states():
    rng = np.random.default_rng(0)
    for _ in range(20):
        model = random_chain(rng)
        data = mujoco.MjData(model)
        for _ in range(10):
            data.qpos[:] = rng.normal(size=model.nq)
            data.qvel[:] = rng.normal(size=model.nv) * 10 ** rng.uniform(-2, 1)
            mujoco.mj_forward(model, data)
            ours = generalised(model, data, model_forces(model, data))
            error = np.linalg.norm(ours - data.qfrc_fluid) / np.linalg.norm(data.qfrc_fluid)
            assert error < 1e-10


@pytest.mark.parametrize("name", shipped())
def test_law_equals_the_engine_on_shipped_fish(name):
    model = compile_twin(load_fish(name)).model
    data = mujoco.MjData(model)
    rng = np.random.default_rng(1)
    for _ in range(20):
        data.qpos[:] = rng.normal(scale=0.3, size=model.nq)
        data.qvel[:] = rng.normal(size=model.nv)
        mujoco.mj_forward(model, data)
        ours = generalised(model, data, model_forces(model, data))
        assert np.linalg.norm(ours - data.qfrc_fluid) < 1e-10 * np.linalg.norm(data.qfrc_fluid)


def plate(axes: tuple[float, ...], coefficients: str) -> mujoco.MjModel:
    size = " ".join(map(str, axes))
    return mujoco.MjModel.from_xml_string(
        '<mujoco><option density="1000" gravity="0 0 0"/><worldbody><body><freejoint/>'
        f'<geom type="ellipsoid" size="{size}" mass="1" fluidshape="ellipsoid"'
        f' fluidcoef="{coefficients}"/></body></worldbody></mujoco>'
    )


@pytest.mark.parametrize("axes", THIN)
@pytest.mark.parametrize("term", ["1 0 0 0 0", "0 1 0 0 0", "0 0 1 0 0", "0 0 0 1 0", "0 0 0 0 1"])
def test_engine_forces_grow_with_speed_squared(axes, term):
    """Kutta lift did not up to MuJoCo 3.13; coefficients from there are not ours."""
    model = plate(axes, term)
    model.geom_fluid[:, 6:12] = 0.0
    data = mujoco.MjData(model)
    scaled = []
    for speed in (0.01, 0.03, 0.1, 0.3, 1.0):
        data.qvel[:] = speed * np.array([1.0, 0.5, 0.2, 3.0, -2.0, 1.0])
        mujoco.mj_forward(model, data)
        scaled.append(data.qfrc_fluid / speed**2)
    assert np.abs(scaled[0]).max() > 0
    assert np.allclose(scaled, scaled[-1], rtol=1e-9, atol=1e-12 * np.abs(scaled[-1]).max())


def random_batch(count: int = 200) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(2)
    axes = rng.uniform(0.001, 0.1, (count, 3))
    mass, inertia = virtual_mass_and_inertia(axes)
    return {
        "velocity": rng.normal(size=(count, 3)),
        "spin": rng.normal(size=(count, 3)),
        "semi_axes": axes,
        "coefficients": rng.uniform(0, 3, (count, 5)),
        "virtual_mass": mass,
        "virtual_inertia": inertia,
    }


def test_drag_takes_energy_and_lift_does_no_work():
    batch = random_batch()
    found = ellipsoid_forces(**batch, density=1000, viscosity=0.001)
    v, w = batch["velocity"], batch["spin"]
    assert np.all(np.sum((found.drag + found.viscous) * v, axis=1) < 0)
    assert np.all(np.sum((found.angular_drag + found.viscous_torque) * w, axis=1) < 0)
    for force in (found.kutta, found.magnus):
        assert np.abs(np.sum(force * v, axis=1)).max() < 1e-9 * np.abs(force).max()
    work = np.sum(found.added_mass * v + found.added_mass_torque * w, axis=1)
    assert np.abs(work).max() < 1e-9 * np.abs(found.added_mass).max()


def test_mirrored_motion_gives_mirrored_force():
    batch = random_batch()
    mirror, axial = np.array([1, -1, 1]), np.array([-1, 1, -1])
    found = ellipsoid_forces(**batch, density=1000, viscosity=0.001)
    other = ellipsoid_forces(
        **{**batch, "velocity": batch["velocity"] * mirror, "spin": batch["spin"] * axial},
        density=1000,
        viscosity=0.001,
    )
    assert np.allclose(other.force, found.force * mirror, rtol=1e-12)
    assert np.allclose(other.torque, found.torque * axial, rtol=1e-12)


def test_virtual_mass_closed_forms_and_engine():
    radius = 0.05
    mass, inertia = virtual_mass_and_inertia(np.full(3, radius))
    assert mass == pytest.approx(np.full(3, 2 / 3 * np.pi * radius**3), rel=1e-6)  # half of V
    assert np.abs(inertia).max() < 1e-12
    model = random_chain(np.random.default_rng(3))
    ours = np.concatenate(virtual_mass_and_inertia(semi_axes(model, wetted(model))), axis=1)
    engine = model.geom_fluid[:, 6:12]
    assert np.abs(ours - engine).max() < 1e-4 * np.abs(engine).max()


def test_munk_moment_and_stokes_drag():
    axes = np.array([0.1, 0.02, 0.05])
    mass, inertia = virtual_mass_and_inertia(axes)
    still = {"semi_axes": axes, "virtual_mass": mass, "virtual_inertia": inertia}
    v = np.array([0.3, 0.1, 0.0])
    free = ellipsoid_forces(
        v, np.zeros(3), coefficients=np.zeros(5), **still, density=1000, viscosity=0
    )
    munk = 1000 * (mass[0] - mass[1]) * v[0] * v[1]
    assert free.torque == pytest.approx([0, 0, munk], rel=1e-9)
    assert np.abs(free.force).max() == 0
    ball = np.full(3, 0.02)
    creep = ellipsoid_forces(
        v, np.zeros(3), ball, np.zeros(5), np.zeros(3), np.zeros(3), density=1e-9, viscosity=0.01
    )
    assert creep.force == pytest.approx(-6 * np.pi * 0.01 * 0.02 * v, rel=1e-6)


def test_engine_lacks_the_acceleration_half_of_added_mass():
    """A neutrally buoyant sphere pushed by 1 N: 1.910 m/s^2 here, 1.273 in water."""
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><option density="1000" gravity="0 0 0"/><worldbody><body><freejoint/>'
        '<geom type="sphere" size=".05" density="1000" fluidshape="ellipsoid"/></body></worldbody>'
        "</mujoco>"
    )
    data = mujoco.MjData(model)
    data.xfrc_applied[1, 0] = 1.0
    mujoco.mj_forward(model, data)
    assert data.qacc[0] == pytest.approx(1.910, abs=1e-3)


def test_old_engines_lost_kutta_lift_at_fish_scale():
    """Shares of notes on MuJoCo <= 3.13: a tail plate at 0.3 m/s kept 27 %, at 0.1 m/s 1 %."""
    at_45 = np.array([1.0, 1.0, 0.0]) / np.sqrt(2)
    plate_axes = np.array(THIN[0])
    assert clamped_share(0.3 * at_45, plate_axes) == pytest.approx(0.27, abs=0.01)
    assert clamped_share(0.1 * at_45, plate_axes) == pytest.approx(0.01, abs=0.005)
    assert clamped_share(1.0 * at_45, plate_axes) == 1.0
    assert np.linalg.norm(kutta_area(at_45, plate_axes)) > 0
