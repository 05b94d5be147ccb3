"""MuJoCo's ellipsoid fluid law in numpy, component by component, for any batch of geoms.

Why a second implementation: the tests hold the engine to it. The engine's law
changed once without a changelog line (Kutta lift, MuJoCo 3.14) and lacks a half (added mass). What
that means for published coefficients is in docs/explain/fluid-law.md.

Frame of the law: the geom's own axes, at the geom's centre; velocities are of that centre relative
to the water; forces and torques are those of the water on the geom. SI, 64 bit. Leading batch axes
broadcast. Source: MuJoCo documentation, "Fluid forces: ellipsoid model".
"""

from dataclasses import dataclass, fields

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import elliprd

from tailbeat.fish import edge

Array = NDArray[np.float64]
GUARD = 1e-15  # mjMINVAL: what MuJoCo up to 3.13 kept its denominators above, whatever their unit


@dataclass(frozen=True, eq=False)
class FluidForces:
    """Components on each geom, all (…, 3): forces [N], torques about the geom's centre [N m]."""

    drag: Array  # blunt and slender, grows with speed squared
    viscous_drag: Array
    kutta: Array
    magnus: Array
    added_mass: Array  # p × ω
    angular_drag: Array  # angular and slender
    viscous_torque: Array
    added_mass_torque: Array  # p × v (Munk) + L × ω

    @property
    def force(self) -> Array:
        """Sum of the five forces (…, 3) [N]."""
        return self.drag + self.viscous_drag + self.kutta + self.magnus + self.added_mass

    @property
    def torque(self) -> Array:
        """Sum of the three torques (…, 3) [N m]."""
        return self.angular_drag + self.viscous_torque + self.added_mass_torque


# ---- the law ------------------------------------------------------------------------------------


def ellipsoid_forces(
    velocity: ArrayLike,
    angular_velocity: ArrayLike,
    semi_axes: ArrayLike,
    coefficients: ArrayLike,
    virtual_mass: ArrayLike,
    virtual_inertia: ArrayLike,
    density: float,
    viscosity: float,
) -> FluidForces:
    """Forces of the water on ellipsoids, in the geom frame.

    Args:
        velocity: of the geom's centre relative to the water (…, 3) [m/s].
        angular_velocity: (…, 3) [rad/s].
        semi_axes: (…, 3) [m], above zero.
        coefficients: (…, 5) in the engine's order: blunt, slender, angular, Kutta, Magnus.
        virtual_mass: per unit density (…, 3) [m^3], see `virtual_mass_and_inertia`.
        virtual_inertia: per unit density (…, 3) [m^5].
        density: of the water [kg/m^3].
        viscosity: dynamic [Pa s]; water has 1e-3.

    Returns:
        Each component (…, 3) over the broadcast batch.

    Raises:
        ValueError: a last axis is not 3 (5 for coefficients), or batch axes do not broadcast.
    """
    v, w = _rows("velocity", velocity), _rows("angular_velocity", angular_velocity)
    s, c = _rows("semi_axes", semi_axes), _rows("coefficients", coefficients, 5)
    blunt, slender, angular, kutta, magnus = (c[..., i, None] for i in range(5))
    momentum = density * _rows("virtual_mass", virtual_mass) * v  # p
    turning = density * _rows("virtual_inertia", virtual_inertia) * w  # L
    diameter = 2 / 3 * s.sum(axis=-1, keepdims=True)  # D of the sphere that stands in at low Re
    return FluidForces(
        drag=-density * _norm(v) * _drag_area(v, s, blunt, slender) * v,
        viscous_drag=-3 * np.pi * viscosity * diameter * v,
        kutta=density * kutta * _kutta_per_unit(v, s),
        magnus=density * magnus * _volume(s) * np.cross(w, v),
        added_mass=np.cross(momentum, w),
        angular_drag=-density * _angular_drag(w, s, angular, slender) * w,
        viscous_torque=-np.pi * viscosity * diameter**3 * w,
        added_mass_torque=np.cross(momentum, v) + np.cross(turning, w),
    )


def _rows(name: str, value: ArrayLike, length: int = 3) -> Array:
    """64-bit array whose last axis has `length` entries."""
    array = np.asarray(value, dtype=np.float64)
    if array.shape[-1:] != (length,):
        raise ValueError(f"{name} has shape {array.shape}; its last axis must have {length}")
    return array


def _norm(vector: Array) -> Array:
    return np.linalg.norm(vector, axis=-1, keepdims=True)


def _ratio(above: Array, below: Array) -> Array:
    """above / below, and 0 where below is 0: a geom at rest feels nothing."""
    return np.divide(above, below, out=np.zeros_like(below), where=below != 0)


def _volume(semi_axes: Array) -> Array:
    return 4 / 3 * np.pi * semi_axes.prod(axis=-1, keepdims=True)


def _faces(semi_axes: Array) -> Array:
    """a = (s1 s2, s2 s0, s0 s1): π a_i is the area seen along axis i."""
    return np.roll(semi_axes, -1, axis=-1) * np.roll(semi_axes, -2, axis=-1)


def _projections(velocity: Array, semi_axes: Array) -> tuple[Array, Array]:
    """Σ a² v² and Σ a⁴ v², each (…, 1)."""
    square = _faces(semi_axes) ** 2 * velocity
    return np.sum(square * velocity, -1, keepdims=True), np.sum(square**2, -1, keepdims=True)


def _drag_area(velocity: Array, semi_axes: Array, blunt: Array, slender: Array) -> Array:
    """C_blunt A_proj + C_slender (A_max - A_proj), (…, 1) [m^2]; no ½, so C_blunt is C_d / 2."""
    _, middle, largest = np.moveaxis(np.sort(semi_axes, axis=-1), -1, 0)[..., None]
    second, fourth = _projections(velocity, semi_axes)
    projected = np.pi * np.sqrt(_ratio(fourth, second))  # shadow along the velocity
    return blunt * projected + slender * (np.pi * largest * middle - projected)


def _angular_drag(spin: Array, semi_axes: Array, angular: Array, slender: Array) -> Array:
    """|ω ∘ (C_angular I_D + C_slender (I_max - I_D))|, (…, 1) [m^5/s]."""
    radius = np.maximum(np.roll(semi_axes, -1, axis=-1), np.roll(semi_axes, -2, axis=-1))
    about = 8 / 15 * np.pi * semi_axes * radius**4
    _, middle, largest = np.moveaxis(np.sort(semi_axes, axis=-1), -1, 0)[..., None]
    most = 8 / 15 * np.pi * middle * largest**4
    return _norm(spin * (angular * about + slender * (most - about)))


def _kutta_per_unit(velocity: Array, semi_axes: Array) -> Array:
    """Kutta lift per unit coefficient and density, (…, 3) [m^4/s^2].

    cosα A_proj ((n × v) × v) with n = a²∘v / |a²∘v|, multiplied out: the normal's length, cosα and
    A_proj share factors. It grows with speed squared, as in MuJoCo 3.14 and later.
    """
    second, fourth = _projections(velocity, semi_axes)
    factor = np.pi * np.sqrt(_ratio(second, fourth))
    return _ratio(factor, _norm(velocity)) * _turned(velocity, semi_axes)


def _turned(velocity: Array, semi_axes: Array) -> Array:
    """((a²∘v) × v) × v: at right angles to the velocity, so lift does no work."""
    return np.cross(np.cross(_faces(semi_axes) ** 2 * velocity, velocity), velocity)


# ---- what older engines gave --------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class ClampedKutta:
    """Kutta lift of MuJoCo up to 3.13: force (…, 3) [N], and its share of the true one (…,)."""

    force: Array
    fraction: Array


def clamped_kutta(
    velocity: ArrayLike, semi_axes: ArrayLike, coefficient: ArrayLike, density: float
) -> ClampedKutta:
    """Kutta lift as MuJoCo up to 3.13 gave it; a diagnostic for coefficients published from there.

    Those engines divided by max(1e-15, |v| Σ a⁴ v²) for cosα and by max(1e-15, Σ a² v²) for A_proj.
    The first is far below 1e-15 for thin plates in slow water, so that lift faded there like v⁵.

    Args:
        velocity: of the geom's centre relative to the water, geom frame (…, 3) [m/s].
        semi_axes: (…, 3) [m], above zero.
        coefficient: Kutta coefficient (…,).
        density: of the water [kg/m^3].

    Returns:
        Force in the geom frame, and the fraction delivered: 1 where no guard acts, 0 at rest.
    """
    v, s = _rows("velocity", velocity), _rows("semi_axes", semi_axes)
    second, fourth = _projections(v, s)
    cosine = _guarded(_norm(v) * fourth)
    fraction = cosine * np.sqrt(_guarded(second))
    scale = density * np.asarray(coefficient, dtype=np.float64)[..., None]
    return ClampedKutta(scale * fraction * _kutta_per_unit(v, s), fraction[..., 0])


def _guarded(denominator: Array) -> Array:
    """Share left by dividing by max(1e-15, denominator)."""
    return denominator / np.maximum(GUARD, denominator)


# ---- virtual mass -------------------------------------------------------------------------------


def virtual_mass_and_inertia(semi_axes: ArrayLike) -> tuple[Array, Array]:
    """Virtual mass [m^3] and virtual inertia [m^5] of ellipsoids per unit density, both (…, 3).

    m_i = V κ_i / (2 - κ_i) and, with b, c the other two semi-axes,
    I_i = V/5 (b² - c²)² (κ_c - κ_b) / (2 (b² - c²) + (b² + c²) (κ_b - κ_c))
    (Tuckerman 1925, NACA report 210). κ_i = s0 s1 s2 ∫ dλ / ((s_i² + λ) Δ) is exact here, by
    Carlson's R_D. The engine's 15-point quadrature is within 1e-4 of it on fish-like plates and
    5e-4 for semi-axes 100 × 0.5 × 50 mm.

    Raises:
        ValueError: the last axis is not 3, or a semi-axis [m] is not above zero.
    """
    s = _rows("semi_axes", semi_axes)
    if not np.all(s > 0):
        raise ValueError(f"semi_axes must be above zero, smallest is {s.min()} m")
    b, c = np.roll(s, -1, axis=-1), np.roll(s, -2, axis=-1)
    kappa = 2 / 3 * s.prod(axis=-1, keepdims=True) * elliprd(b**2, c**2, s**2)
    difference = np.roll(kappa, -1, axis=-1) - np.roll(kappa, -2, axis=-1)  # κ_b - κ_c
    flat = b**2 - c**2
    inertia = -_ratio(flat**2 * difference, 2 * flat + (b**2 + c**2) * difference)
    return _volume(s) * kappa / (2 - kappa), _volume(s) / 5 * inertia


# ---- the law on a compiled model ----------------------------------------------------------------


def fluid_forces(model: mujoco.MjModel, data: mujoco.MjData) -> FluidForces:
    """Components on every geom of a model (ngeom, 3), world axes, at the geom's centre.

    Needs up-to-date positions and velocities (after `mj_forward` or a step). Rows of geoms without
    the ellipsoid law are zero; the engine's inertia-box drag on other bodies is not included. Lift
    is weighed by the flow along the chord where the model was compiled with a trailing edge; its
    coefficients must be the compiled ones.
    """
    rotation = data.geom_xmat.reshape(-1, 3, 3)
    velocity, spin = _geom_velocities(model, data)
    velocity = np.einsum("gji,gj->gi", rotation, velocity)
    local = ellipsoid_forces(
        velocity,
        np.einsum("gji,gj->gi", rotation, spin),
        geom_semi_axes(model),
        _coefficients(model, velocity[:, :1]),
        model.geom_fluid[:, 6:9],
        model.geom_fluid[:, 9:12],
        model.opt.density,
        model.opt.viscosity,
    )
    to_world = _wetness(model)[:, None, None] * rotation
    components = (getattr(local, field.name) for field in fields(FluidForces))
    return FluidForces(*(np.einsum("gij,gj->gi", to_world, part) for part in components))


def generalised(model: mujoco.MjModel, data: mujoco.MjData, forces: FluidForces) -> Array:
    """`fluid_forces` as forces on the joints (nv,) [N or N m].

    Equals the engine's `qfrc_fluid` when no body feels inertia-box drag.
    """
    total = np.zeros(model.nv)
    linear, angular = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    for geom in np.flatnonzero(_wetness(model)):
        body, centre = int(model.geom_bodyid[geom]), data.geom_xpos[geom]
        mujoco.mj_jac(model, data, linear, angular, centre, body)
        total += linear.T @ forces.force[geom] + angular.T @ forces.torque[geom]
    return total


def geom_semi_axes(model: mujoco.MjModel) -> Array:
    """Semi-axes (ngeom, 3) [m] of the ellipsoid that the engine takes for each geom."""
    types, kind = mujoco.mjtGeom, model.geom_type
    radius, half, _ = model.geom_size.T
    sphere, capsule = kind == types.mjGEOM_SPHERE, kind == types.mjGEOM_CAPSULE
    round_ = capsule | (kind == types.mjGEOM_CYLINDER)
    axes = model.geom_size.copy()
    axes[sphere] = radius[sphere, None]
    axes[round_] = np.stack([radius, radius, half + capsule * radius], axis=-1)[round_]
    return axes


def _coefficients(model: mujoco.MjModel, ahead: Array) -> Array:
    """The five of every geom (ngeom, 5); `ahead` (ngeom, 1) is its velocity along its chord."""
    found, blend = model.geom_fluid[:, 1:6].copy(), edge.blend_of(model)
    if blend is not None:
        found[:, 3] *= edge.weights(ahead, blend)[:, 0]
    return found


def _wetness(model: mujoco.MjModel) -> Array:
    """Scale on each geom's forces (ngeom,); 0 without the law or on a body the engine skips."""
    heavy = model.body_mass[model.geom_bodyid] >= GUARD
    return np.maximum(model.geom_fluid[:, 0], 0.0) * heavy


def _geom_velocities(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[Array, Array]:
    """Velocity relative to the water and spin of geom centres (ngeom, 3), world axes."""
    body = model.geom_bodyid
    spin, at_origin = data.cvel[body, :3], data.cvel[body, 3:]
    # `cvel` is given at the centre of mass of the body's whole tree.
    arm = data.geom_xpos - data.subtree_com[model.body_rootid[body]]
    return at_origin + np.cross(spin, arm) - model.opt.wind, spin
