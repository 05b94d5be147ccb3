"""One foil led through the water: what theory and towing tanks can be compared with.

The same section, states and added mass as the fish's fin, on an imposed heave and pitch.
"""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tailbeat.pool.section import STATES, advance, section
from tailbeat.pool.water import Water

Array = NDArray[np.float64]
STEPS_PER_BEAT = 2000
BEATS = 12  # the last of which is measured


@dataclass(frozen=True)
class Stroke:
    """Heave h cos(wt), pitch theta cos(wt + lead) about a pivot; all per unit chord and speed.

    `reduced` is k = w c / 2U, `heave` h / c, `pitch` [rad], `pivot` the pivot's place ahead of
    mid-chord over the chord (1/2 is the leading edge), `lead` [rad] of pitch before heave.
    """

    reduced: float
    heave: float
    pitch: float = 0.0
    pivot: float = 0.0
    lead: float = 0.0


def flap(stroke: Stroke, water: Water, slope: float = 1.0) -> tuple[float, float]:
    """Mean thrust and power coefficients, over rho U^2 c / 2 and rho U^3 c / 2, of a unit span.

    `slope` is the lift slope over 2 pi (1: two dimensions). Added mass of a section in two
    dimensions.
    """
    omega = 2 * stroke.reduced  # chord 1, speed 1
    dt = 2 * np.pi / omega / STEPS_PER_BEAT
    time = np.asarray(dt * np.arange(BEATS * STEPS_PER_BEAT), dtype=np.float64)
    heave = _wave(stroke.heave, omega, 0.0, time)
    pitch = _wave(stroke.pitch, omega, stroke.lead, time)
    thrust, power = _led(*heave, *pitch, stroke.pivot, slope, dt, water.row())
    last = slice(-STEPS_PER_BEAT, None)
    scale = 0.5 * water.density
    return float(thrust[last].mean() / scale), float(power[last].mean() / scale)


def _wave(size: float, omega: float, lead: float, time: Array) -> tuple[Array, Array, Array]:
    """Value, rate and acceleration of size * cos(omega t + lead)."""
    angle = omega * time + lead
    return (
        size * np.cos(angle),
        -size * omega * np.sin(angle),
        -size * omega**2 * np.cos(angle),
    )


@njit(cache=True)
def _led(_h, dh, ddh, angle, rate, push, pivot, slope, dt, p):  # type: ignore[no-untyped-def]
    """Thrust and power at every step: a foil of unit chord towed at unit speed towards +x."""
    thrust, power = np.empty_like(dh), np.empty_like(dh)
    state = np.zeros(STATES)
    state[3] = 1.0
    mass = p[0] * np.pi / 4 * p[8] * p[17]
    inertia = p[0] * np.pi / 128 * p[8] * p[17]
    for i in range(dh.size):
        cos, sin = np.cos(angle[i]), np.sin(angle[i])
        u = cos + dh[i] * sin
        w = -sin + dh[i] * cos - pivot * rate[i]
        normal, forward, moment = section(u, w, rate[i], state, 1.0, 1.0, slope, p)
        # acceleration of the centre along n, less what turning the axes adds
        along_n = ddh[i] * cos - pivot * push[i]
        normal -= mass * (along_n - rate[i] * u)
        moment -= inertia * push[i] + mass * u * rate[i] / 4
        advance(u, w, rate[i], state, 1.0, dt, p)
        fx = forward * cos - normal * sin
        fy = forward * sin + normal * cos
        thrust[i] = fx
        power[i] = -(fy * dh[i] + (moment - pivot * normal) * rate[i])
    return thrust, power
