"""The fin's section: Wagner lag, filtered Leishman-Beddoes stall, suction, drag; compiled.

Frame: t along the chord towards the leading edge, n to the left, centre at mid-chord. `u`, `w` are
the centre's velocity relative to the water along t and n [m/s], `omega` the yaw rate [rad/s].
Forces are on the foil, moments about mid-chord; added mass is not here but in the plant's inertia.

    w34 = w - omega c/4,  V = sqrt(u^2 + w34^2 + 0.01^2),  sigma = 2 V / c
    q = (1 - sum A) w34 + sum z,  dz_i/dt = b_i sigma (A_i w34 - z_i)             (Wagner, Jones)
    dalpha_l/dt = sigma (atan2(q, |u|) - alpha_l) / Tp,  dx/dt = sigma (x0(alpha_l) - x) / Tf
    N = -rho pi c h a K u q at the quarter chord,  K = ((1 + sqrt x) / 2)^2
    S = eta sqrt(x) rho pi c h a^2 (q + omega c/4)^2 along t;  lost suction becomes normal force
"""

from typing import NamedTuple

import numpy as np

from tailbeat.pool.compiled import compiled

# z1, z2 [m/s], alpha_l [rad], the attached share x, and two of the edge-vortex term [m, m^2].
WAKE = np.dtype(
    [(name, float) for name in ("z1", "z2", "angle", "attached", "drift", "stroke_square")]
)
UNDISTURBED = np.array((0.0, 0.0, 0.0, 1.0, 0.0, 0.0), WAKE)  # attached, nothing shed
STILL = 0.01  # m/s: floor of the speed that carries the wake away
KC_TIME = 0.7  # s, over which the edge-vortex term remembers the stroke


class Flow(NamedTuple):
    """Velocity of a centre through the water along t and n [m/s], yaw rate [rad/s]."""

    u: float
    w: float
    omega: float


@compiled
def section(flow, wake, fin, water):  # type: ignore[no-untyped-def]
    """Normal force, force along t and moment [N, N, N m] of a fin with its `wake` (see `WAKE`).

    `fin` gives chord, height [m] and the lift slope over 2 pi; `water` is a row of `water.rows`.
    """
    rho, eta, chord, height, slope = water.density, water.suction, fin.chord, fin.height, fin.slope
    u, w, omega = flow.u, flow.w, flow.omega
    q = _lagged(w - omega * chord / 4, wake, water)
    x = wake.attached if water.with_stall > 0 else 1.0
    root = np.sqrt(x)
    attached = ((1 + root) / 2) ** 2
    area = rho * np.pi * chord * height
    lift = -area * slope * attached * u * q
    if u < 0:
        lift *= 0.5  # the sharp edge leads: half, chosen
    edge = q + omega * chord / 4
    suction = eta * root * area * slope**2 * edge * edge
    lost = -water.vortex * (1 - eta * root) * area * slope**2 * abs(edge) * edge
    across = -0.5 * rho * chord * height * water.fin_drag * abs(w) * w * (1 - root)
    share = water.edge_vortices
    kc = _edge_vortices(flow, wake, fin, rho) * share if share > 0 else 0.0
    normal = lift + lost + across + kc
    forward = suction - 0.5 * rho * chord * height * water.fin_friction * abs(u) * u
    return normal, forward, chord / 4 * lift


@compiled
def _lagged(w34, wake, water):  # type: ignore[no-untyped-def]
    """The wash q [m/s] that circulation has followed so far."""
    if water.with_lag > 0:
        return (1 - water.a1 - water.a2) * w34 + wake.z1 + wake.z2
    return w34


@compiled
def _edge_vortices(flow, wake, fin, rho):  # type: ignore[no-untyped-def]
    """Extra normal drag of short strokes (Graham-type law); a variant, not validated."""
    u, w, chord = flow.u, flow.w, fin.chord
    stroke = np.sqrt(2 * max(wake.stroke_square, 1e-12))
    kc = max(2 * np.pi * stroke / chord, 1e-3)
    drag = min(max(8 * kc ** (-1.0 / 3.0), 2.0), 10.0)
    rate = abs(w) / max(stroke, 1e-4) * chord / (2 * np.sqrt(u * u + 1e-4))
    return -0.5 * rho * chord * fin.height * drag * rate / (1 + rate) * abs(w) * w


@compiled
def advance(flow, wake, chord, dt, water):  # type: ignore[no-untyped-def]
    """The section's wake one step on, in place; each lag by its exact exponential."""
    u, w = flow.u, flow.w
    w34 = w - flow.omega * chord / 4
    q = _lagged(w34, wake, water)
    reduced = 2 * np.sqrt(u * u + w34 * w34 + STILL * STILL) / chord * dt
    keep = np.exp(-water.b1 * reduced)
    wake.z1 = wake.z1 * keep + water.a1 * w34 * (1 - keep)
    keep = np.exp(-water.b2 * reduced)
    wake.z2 = wake.z2 * keep + water.a2 * w34 * (1 - keep)
    keep = np.exp(-reduced / water.lag_pressure)
    wake.angle = wake.angle * keep + np.arctan2(q, abs(u)) * (1 - keep)
    keep = np.exp(-reduced / water.lag_separation)
    wake.attached = wake.attached * keep + attached_share(wake.angle, water) * (1 - keep)
    keep = np.exp(-dt / KC_TIME)
    wake.drift = wake.drift * keep + KC_TIME * w * (1 - keep)
    wake.stroke_square = wake.stroke_square * keep + wake.drift * wake.drift * (1 - keep)


@compiled
def attached_share(alpha, water):  # type: ignore[no-untyped-def]
    """Static separation point x0 (1 attached) at an angle of attack [rad] (Leishman-Beddoes)."""
    angle, first = abs(np.degrees(alpha)), water.stall_angle
    if angle <= first:
        return 1 - 0.3 * np.exp((angle - first) / water.stall_before)
    return 0.04 + 0.66 * np.exp((first - angle) / water.stall_after)
