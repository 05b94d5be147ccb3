"""MuJoCo's ellipsoid fluid law in numpy, component by component, for any batch of geoms.

Why a second implementation: it shows which term pushes, and it pins the engine. The law changed
once without a changelog line (Kutta lift, MuJoCo 3.14) and lacks a half (added mass); see
docs/fluid.md.

Frames: everything is in the geom's own frame, at its centre, SI, velocities relative to the water;
a leading batch axis broadcasts. Coefficients in the engine's order: blunt, slender, angular, Kutta,
Magnus. Source: MuJoCo manual, "Fluid forces", ellipsoidal model.
"""

from dataclasses import dataclass, fields

import mujoco
import numpy as np
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray

Array = NDArray[np.float64]
TINY = 1e-15  # the engine's own guard against division by zero


@dataclass(frozen=True, eq=False)
class FluidForces:
    """Components on each geom, (…, 3): forces [N], torques about the geom's centre [N m]."""

    drag: Array
    viscous: Array
    kutta: Array
    magnus: Array
    added_mass: Array
    angular_drag: Array
    viscous_torque: Array
    added_mass_torque: Array

    @property
    def force(self) -> Array:
        """Sum of all forces (…, 3) [N]."""
        return self.drag + self.viscous + self.kutta + self.magnus + self.added_mass

    @property
    def torque(self) -> Array:
        """Sum of all torques (…, 3) [N m]."""
        return self.angular_drag + self.viscous_torque + self.added_mass_torque


def ellipsoid_forces(
    velocity: Array,
    spin: Array,
    semi_axes: Array,
    coefficients: Array,
    virtual_mass: Array,
    virtual_inertia: Array,
    density: float,
    viscosity: float,
) -> FluidForces:
    """The law. velocity [m/s], spin [rad/s], semi_axes [m] are (…, 3); coefficients (…, 5);
    virtual mass [m^3] and inertia [m^5] (…, 3), per unit density; density [kg/m^3], dynamic
    viscosity [Pa s]."""
    blunt, slender, angular, kutta, magnus = np.moveaxis(coefficients, -1, 0)[..., None]
    momentum = density * virtual_mass * velocity
    turning = density * virtual_inertia * spin
    volume = 4 / 3 * np.pi * semi_axes.prod(axis=-1, keepdims=True)
    across = semi_axes.sum(axis=-1, keepdims=True) * 2 / 3  # equivalent diameter D
    return FluidForces(
        drag=-density
        * _drag_area(velocity, semi_axes, blunt, slender)
        * _norm(velocity)
        * velocity,
        viscous=-3 * np.pi * across * viscosity * velocity,
        kutta=kutta * density * kutta_area(velocity, semi_axes),
        magnus=magnus * density * volume * np.cross(spin, velocity),
        added_mass=np.cross(momentum, spin),
        angular_drag=-density * _angular_drag(spin, semi_axes, angular, slender) * spin,
        viscous_torque=-np.pi * across**3 * viscosity * spin,
        added_mass_torque=np.cross(momentum, velocity) + np.cross(turning, spin),
    )


def _norm(vector: Array) -> Array:
    return np.linalg.norm(vector, axis=-1, keepdims=True)


def _faces(semi_axes: Array) -> Array:
    """Products of the other two semi-axes, (s1 s2, s2 s0, s0 s1)."""
    s = semi_axes
    return np.stack([s[..., 1] * s[..., 2], s[..., 2] * s[..., 0], s[..., 0] * s[..., 1]], -1)


def _projected_area(velocity: Array, semi_axes: Array) -> Array:
    """Area of the ellipsoid's shadow along the velocity (…, 1) [m^2]."""
    face = _faces(semi_axes)
    above = np.sum(face**4 * velocity**2, axis=-1, keepdims=True)
    below = np.sum(face**2 * velocity**2, axis=-1, keepdims=True)
    return np.pi * np.sqrt(_ratio(above, below))


def _ratio(above: Array, below: Array) -> Array:
    """above / below, 0 at rest."""
    return np.divide(above, below, out=np.zeros_like(above), where=below > 0)


def _drag_area(velocity: Array, semi_axes: Array, blunt: Array, slender: Array) -> Array:
    """C_blunt A_proj + C_slender (A_max - A_proj); no factor one half: C_blunt is C_d / 2."""
    _, middle, high = np.moveaxis(np.sort(semi_axes, axis=-1), -1, 0)[..., None]
    shadow = _projected_area(velocity, semi_axes)
    return blunt * shadow + slender * (np.pi * high * middle - shadow)


def _angular_drag(spin: Array, semi_axes: Array, angular: Array, slender: Array) -> Array:
    """|spin ∘ (C_angular I_D + C_slender (I_max - I_D))|, (…, 1) [m^5/s]."""
    s = semi_axes
    other = np.stack(
        [np.maximum(s[..., 1], s[..., 2]), np.maximum(s[..., 2], s[..., 0]),
         np.maximum(s[..., 0], s[..., 1])], -1,
    )  # fmt: skip
    about = 8 * np.pi / 15 * s * other**4
    ordered = np.sort(s, axis=-1)
    largest = 8 * np.pi / 15 * ordered[..., 1:2] * ordered[..., 2:3] ** 4
    return _norm(spin * (angular * about + slender * (largest - about)))


def kutta_area(velocity: Array, semi_axes: Array) -> Array:
    """Kutta lift per unit coefficient and density, |v|^2 times area, (…, 3) [m^4/s^2].

    cosα A_proj ((n × v) × v), n = a² ∘ v / |a² ∘ v| as MuJoCo 3.14 and later have it, so that lift
    grows with v². Perpendicular to the velocity: lift does no work.
    """
    face = _faces(semi_axes)
    normal = face**2 * velocity
    below = np.sum(face**4 * velocity**2, axis=-1, keepdims=True)
    above = np.sum(face**2 * velocity**2, axis=-1, keepdims=True)
    cosine = _ratio(above, _norm(velocity) * np.sqrt(below))
    unit = _ratio(normal, np.broadcast_to(np.sqrt(below), normal.shape))
    turned = np.cross(np.cross(unit, velocity), velocity)
    return cosine * _projected_area(velocity, semi_axes) * turned


def clamped_share(velocity: Array, semi_axes: Array) -> Array:
    """Share of true Kutta lift that engines up to 3.13 delivered, (…,).

    They divided by max(1e-15, |v| Σ a⁴ v²), and Σ a⁴ v² is below that at fish scale, so that lift
    faded like v³ more than it should. Explains coefficients published from those engines.
    """
    face = _faces(semi_axes)
    below = np.sum(face**4 * velocity**2, axis=-1) * np.linalg.norm(velocity, axis=-1)
    return below / np.maximum(TINY, below)


def virtual_mass_and_inertia(semi_axes: Array) -> tuple[Array, Array]:
    """Added mass [m^3] and added inertia [m^5] of an ellipsoid per unit density, (…, 3).

    Lamb (1932), Tuckerman (1925): m_i = V κ_i / (2 - κ_i), κ_i = s0 s1 s2 ∫ dλ / ((s_i² + λ) Δ).
    """
    kappa = _kappa(semi_axes)
    volume = 4 / 3 * np.pi * semi_axes.prod(axis=-1, keepdims=True)
    mass = volume * kappa / np.maximum(TINY, 2 - kappa)
    b, c = np.roll(semi_axes, -1, -1), np.roll(semi_axes, -2, -1)
    kb, kc = np.roll(kappa, -1, -1), np.roll(kappa, -2, -1)
    above = (b**2 - c**2) ** 2 * np.abs(kc - kb)
    below = 2 * np.abs(b**2 - c**2) + (b**2 + c**2) * (kb - kc) * np.sign(b**2 - c**2)
    return mass, volume / 5 * above / np.maximum(TINY, np.abs(below))


def _kappa(semi_axes: Array, points: int = 400) -> Array:
    """The three shape integrals, by Gauss-Legendre after λ = (largest axis)² x³ / (1 - x)²."""
    x, weight = leggauss(points)
    x, weight = (x + 1) / 2, weight / 2
    largest = semi_axes.max(axis=-1, keepdims=True) ** 2
    lam = largest * x**3 / (1 - x) ** 2
    slope = largest * (3 * x**2 * (1 - x) + 2 * x**3) / (1 - x) ** 3
    square = semi_axes[..., :, None] ** 2 + lam[..., None, :]
    root = np.sqrt(square.prod(axis=-2, keepdims=True))
    product = semi_axes.prod(axis=-1)[..., None]
    return product * np.sum(weight * slope[..., None, :] / (square * root), axis=-1)


# ---- the same for a compiled model --------------------------------------------------------------


def wetted(model: mujoco.MjModel) -> NDArray[np.int_]:
    """Indices of the geoms that feel the ellipsoid law."""
    return np.flatnonzero(model.geom_fluid[:, 0] > 0)


def model_forces(model: mujoco.MjModel, data: mujoco.MjData) -> FluidForces:
    """Components on each wetted geom of a model at its present state, in the world frame."""
    geoms = wetted(model)
    turn = data.geom_xmat[geoms].reshape(-1, 3, 3)
    spin, velocity = _geom_velocities(model, data, geoms)
    rows = model.geom_fluid[geoms]
    local = ellipsoid_forces(
        np.einsum("gji,gj->gi", turn, velocity),
        np.einsum("gji,gj->gi", turn, spin),
        semi_axes(model, geoms),
        rows[:, 1:6],
        rows[:, 6:9],
        rows[:, 9:12],
        model.opt.density,
        model.opt.viscosity,
    )
    scale = rows[:, :1]
    return FluidForces(
        *(
            scale * np.einsum("gij,gj->gi", turn, getattr(local, field.name))
            for field in fields(FluidForces)
        )
    )


def _geom_velocities(
    model: mujoco.MjModel, data: mujoco.MjData, geoms: NDArray[np.int_]
) -> tuple[Array, Array]:
    """Spin and velocity of geom centres relative to the water, in the world frame."""
    found = np.zeros((geoms.size, 6))
    kind = mujoco.mjtObj.mjOBJ_GEOM
    for row, geom in zip(found, geoms, strict=True):
        mujoco.mj_objectVelocity(model, data, kind, int(geom), row, 0)
    return found[:, :3], found[:, 3:] - model.opt.wind


def semi_axes(model: mujoco.MjModel, geoms: NDArray[np.int_]) -> Array:
    """Semi-axes (g, 3) [m] of the ellipsoids the engine takes for geoms of any shape."""
    size = model.geom_size[geoms].copy()
    kind = model.geom_type[geoms]
    types = mujoco.mjtGeom
    sphere, capsule = kind == types.mjGEOM_SPHERE, kind == types.mjGEOM_CAPSULE
    cylinder = kind == types.mjGEOM_CYLINDER
    size[sphere] = size[sphere][:, :1]
    size[capsule | cylinder, 2] = size[capsule | cylinder, 1]
    size[capsule | cylinder, 1] = size[capsule | cylinder, 0]
    size[capsule, 2] += size[capsule, 0]
    return size


def generalised(model: mujoco.MjModel, data: mujoco.MjData, forces: FluidForces) -> Array:
    """Forces on the joints (nv,), to set beside the engine's `qfrc_fluid`."""
    total = np.zeros(model.nv)
    linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    for geom, force, torque in zip(wetted(model), forces.force, forces.torque, strict=True):
        body, point = int(model.geom_bodyid[geom]), data.geom_xpos[geom]
        mujoco.mj_jac(model, data, linear, angular, point, body)
        total += linear.T @ force + angular.T @ torque
    return total
