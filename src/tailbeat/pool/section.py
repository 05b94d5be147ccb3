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

import numpy as np
from numba import njit

STATES = 6  # z1, z2, alpha_l, x, and two of the edge-vortex term
STILL = 0.01  # m/s: floor of the speed that carries the wake away
KC_TIME = 0.7  # s, over which the edge-vortex term remembers the stroke


@njit(cache=True)
def section(u, w, omega, state, chord, height, slope, p):  # type: ignore[no-untyped-def]
    """Normal force, force along t and moment [N, N, N m] of a section in a state (6,).

    `slope` is the lift slope over 2 pi; `p` a row of `water.ROW`.
    """
    (rho, eta, vortex, c_n, c_d0) = p[0], p[1], p[2], p[3], p[4]
    with_lag, with_stall = p[15] > 0, p[16] > 0
    w34 = w - omega * chord / 4
    q = (1 - p[18] - p[20]) * w34 + state[0] + state[1] if with_lag else w34
    x = state[3] if with_stall else 1.0
    root = np.sqrt(x)
    attached = ((1 + root) / 2) ** 2
    area = rho * np.pi * chord * height
    lift = -area * slope * attached * u * q
    if u < 0:
        lift *= 0.5  # the sharp edge leads: half, chosen
    edge = q + omega * chord / 4
    suction = eta * root * area * slope**2 * edge * edge
    lost = -vortex * (1 - eta * root) * area * slope**2 * abs(edge) * edge
    across = -0.5 * rho * chord * height * c_n * abs(w) * w * (1 - root)
    kc = _edge_vortices(w, u, state, chord, height, rho) * p[14] if p[14] > 0 else 0.0
    normal = lift + lost + across + kc
    forward = suction - 0.5 * rho * chord * height * c_d0 * abs(u) * u
    return normal, forward, chord / 4 * lift


@njit(cache=True)
def _edge_vortices(w, u, state, chord, height, rho):  # type: ignore[no-untyped-def]
    """Extra normal drag of short strokes (Graham-type law); a variant, not validated."""
    stroke = np.sqrt(2 * max(state[5], 1e-12))
    kc = max(2 * np.pi * stroke / chord, 1e-3)
    drag = min(max(8 * kc ** (-1.0 / 3.0), 2.0), 10.0)
    rate = abs(w) / max(stroke, 1e-4) * chord / (2 * np.sqrt(u * u + 1e-4))
    return -0.5 * rho * chord * height * drag * rate / (1 + rate) * abs(w) * w


@njit(cache=True)
def advance(u, w, omega, state, chord, dt, p):  # type: ignore[no-untyped-def]
    """The section's state (6,) one step on, in place; each lag by its exact exponential."""
    w34 = w - omega * chord / 4
    q = (1 - p[18] - p[20]) * w34 + state[0] + state[1] if p[15] > 0 else w34
    reduced = 2 * np.sqrt(u * u + w34 * w34 + STILL * STILL) / chord * dt
    for i in range(2):
        keep = np.exp(-p[19 + 2 * i] * reduced)
        state[i] = state[i] * keep + p[18 + 2 * i] * w34 * (1 - keep)
    keep = np.exp(-reduced / p[9])
    state[2] = state[2] * keep + np.arctan2(q, abs(u)) * (1 - keep)
    keep = np.exp(-reduced / p[10])
    state[3] = state[3] * keep + attached_share(state[2], p) * (1 - keep)
    keep = np.exp(-dt / KC_TIME)
    state[4] = state[4] * keep + KC_TIME * w * (1 - keep)
    state[5] = state[5] * keep + state[4] * state[4] * (1 - keep)


@njit(cache=True)
def attached_share(alpha, p):  # type: ignore[no-untyped-def]
    """Static separation point x0 (1 attached) at an angle of attack [rad] (Leishman-Beddoes)."""
    angle, first = abs(np.degrees(alpha)), p[11]
    if angle <= first:
        return 1 - 0.3 * np.exp((angle - first) / p[12])
    return 0.04 + 0.66 * np.exp((first - angle) / p[13])
