"""One foil led through the water by the plant's compiled `add_water`, on an imposed motion."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit

from tailbeat.pool import chain as rows
from tailbeat.pool.chain import Chain, dofs
from tailbeat.pool.dynamics import POKE, TETHER, Around, scratch
from tailbeat.pool.hydrodynamics import MODE, add_water, shed
from tailbeat.pool.kinematics import pose
from tailbeat.pool.section import UNDISTURBED
from tailbeat.pool.water import Water
from tailbeat.pool.water import rows as water_rows

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


class Path(NamedTuple):
    """Joints (k, nv), their rates and accelerations, every `dt` [s]."""

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    dt: float


def flap(stroke: Stroke, water: Water, slope: float = 1.0) -> tuple[float, float]:
    """Mean thrust and power coefficients, over rho U^2 c / 2 and rho U^3 c / 2, of a unit span.

    `slope` is the lift slope over 2 pi (1: two dimensions).
    """
    path = led(stroke)
    force = towed(path, foil(stroke.pivot, slope), water)[-STEPS_PER_BEAT:]
    speed = path.v[-STEPS_PER_BEAT:]
    thrust, power = force[:, 0].mean(), -(force[:, 1:3] * speed[:, 1:3]).sum(axis=1).mean()
    scale = 0.5 * water.density
    return float(thrust / scale), float(power / scale)


def led(stroke: Stroke) -> Path:
    """The pivot towed at unit speed towards +x: x, y, yaw, and a motor that stands still."""
    omega = 2 * stroke.reduced  # chord 1, speed 1
    dt = 2 * np.pi / omega / STEPS_PER_BEAT
    time = dt * np.arange(BEATS * STEPS_PER_BEAT)
    nothing = np.zeros_like(time)
    heave = wave(stroke.heave, omega, 0.0, time)
    pitch = wave(stroke.pitch, omega, stroke.lead, time)
    tow = (time, nothing + 1, nothing)
    lanes = (tow, heave, pitch, [nothing] * 3)
    q, v, a = (np.stack(four, axis=1) for four in zip(*lanes, strict=True))
    return Path(q, v, a, dt)


def wave(size: float, omega: float, lead: float, time: np.ndarray) -> tuple[np.ndarray, ...]:
    """Value, rate and acceleration of size * cos(omega t + lead)."""
    angle = omega * time + lead
    return (
        size * np.cos(angle),
        -size * omega * np.sin(angle),
        -size * omega**2 * np.cos(angle),
    )


def foil(pivot: float = 0.0, slope: float = 1.0, arm: float | None = None) -> Chain:
    """A fin of unit chord and span behind its pivot, in two dimensions. With `arm`, the pivot is a
    hinge at that distance behind the root of a body in front."""
    jointed = arm is not None
    bodies = np.zeros(1 + jointed, rows.BODY)
    bodies["origin"][-1] = -(arm or 0.0)
    guides = np.zeros((2, 0), rows.GUIDE)
    return Chain(
        bodies,
        np.zeros(0, rows.STRIP),
        np.array([(int(jointed), -pivot, 1.0, 1.0, slope, 1.0, 1.0)], rows.FIN),
        np.zeros(int(jointed), rows.HINGE),
        guides,
        np.zeros(1, rows.MOTOR),
        np.zeros(1, rows.TENDON),
        np.zeros(2),
        0.0,
        0.0,
    )


def towed(path: Path, chain: Chain, water: Water) -> np.ndarray:
    """Force of the water on the joints (k, nv) [N, N m] along a path."""
    servo, modes, pokes = np.zeros(1, rows.SERVO)[0], np.zeros(0, MODE), np.zeros(0, POKE)
    tether, held = np.zeros(1, TETHER)[0], np.zeros((), bool)
    around = Around(water_rows([water])[0], servo, modes, np.zeros(2), pokes, held, tether)
    wakes = np.full(len(chain.fins), UNDISTURBED)
    work = scratch(dofs(chain), len(chain.bodies), len(chain.fins))
    return _towed(path, chain, around, wakes, work)


@njit(cache=True)
def _towed(path, chain, around, wakes, work):
    found = np.empty_like(path.q)
    for i in range(len(path.q)):
        work.mass[:], work.force[:] = 0.0, 0.0
        pose(path.q[i], path.v[i], chain.bodies, work.frames)
        add_water(chain, around, 0.0, path.dt / 2, wakes, work)
        found[i] = work.force - work.mass @ path.a[i]
        shed(chain, around, path.dt / 2, wakes, work)
    return found
