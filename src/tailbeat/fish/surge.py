"""Added mass that acts across a part and not along it.

The engine's body mass is one number. A part's added mass m_A in it resists motion along the chord
as much as across it. Water does not: along the chord only s m_A acts, with s the fish's
`added_along`. Let e = (1 - s) m_A be the excess, u, v the part's velocity along and across, and w
its spin. Kirchhoff's equations of a body with m_A across and s m_A along are the engine's, plus

    along  + e du/dt        across  + e u w        moment  - e u v (Munk).

The last two terms depend on velocities alone. They are the engine's own velocity half with the
virtual mass -e / density along the chord (`virtual_mass`), exact at every step. The first term
cannot be a coefficient. It is a force on the head along its heading, the excess of all parts times
the head's surge acceleration, and is updated at every step of the engine (`relieve`). All parts are
assumed to surge like the head.

The force f of one step follows from the last step, whose acceleration is a = (F + f) / M with F all
other forces and M the mass. The force wanted is e a at f = e F / (M - e), so the change is
(e a - f) M / (M - e). It is exact for a rigid fish. A bent tail follows the head less than a rigid
one; the change is then too small, never too large.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco import batch
from numba import njit
from numpy.typing import NDArray

from tailbeat.fish.description import Fish

Array = NDArray[np.float64]
NAME = "surge_excess"  # of the number that a compiled model carries [kg]


def excess(fish: Fish) -> float:
    """Mass [kg] by which the added mass of all parts is too large along the fish."""
    parts = [part for body in (fish.head, *fish.tail.links) for part in body.parts]
    return fish.added_inertia * (1 - fish.added_along) * sum(part.added_mass for part in parts)


def virtual_mass(fish: Fish, added_mass: float) -> float:
    """Virtual mass along the chord, per density [m^3], of a part that carries `added_mass` [kg]."""
    return -fish.added_inertia * (1 - fish.added_along) * added_mass / fish.medium.density


def excess_of(model: mujoco.MjModel) -> float:
    """The excess [kg] that a model was compiled with."""
    found = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, NAME)
    return float(model.numeric_data[model.numeric_adr[found]]) if found >= 0 else 0.0


@dataclass(frozen=True, eq=False)
class Relief:
    """State of the correction: the `force` (n,) [N] on each head along its heading, the same in
    world axes (n, 3), and `before`, its speed (n,) [m/s] one step ago, NaN if a swim has just
    begun. `inertia` (n,) [kg/s] is the excess over the step, `gain` (n,) is M / (M - e). `qpos` and
    `qvel` are the batch's own arrays, `root` is the number of the root's velocities (3 or 6)."""

    root: int
    qpos: Array
    qvel: Array
    inertia: Array
    gain: Array
    force: Array
    world: Array
    before: Array


def relief(root: int, pool: batch.Batch, excess: Array, mass: Array, step: float) -> Relief:
    """State of a batch at its start. `excess` and `mass` (n,) [kg] are of each model; `mass`
    includes the added mass. `step` [s] is the engine's."""
    n = len(mass)
    moves = pool.bind("qpos"), pool.bind("qvel")
    still, unknown = (np.zeros(n), np.zeros((n, 3))), np.full(n, np.nan)
    return Relief(root, *moves, excess / step, mass / (mass - excess), *still, unknown)


def begin(state: Relief, chosen: NDArray[np.int64]) -> None:
    """Reset the fish `chosen` (indices), which begin a new swim."""
    state.force[chosen], state.before[chosen] = 0.0, np.nan


def relieve(state: Relief) -> Array:
    """Update the force after one step of the engine; returns it in world axes (n, 3) [N]."""
    nose = _planar_nose(state.qpos) if state.root == 3 else _free_nose(state.qpos)
    _follow(nose, state.qvel, state.inertia, state.gain, state.force, state.world, state.before)
    return state.world


@njit(cache=True)
def _planar_nose(qpos):  # type: ignore[no-untyped-def]
    """The head's nose-ward axis in the world (n, 3), of a root with x, y, yaw."""
    found = np.zeros((len(qpos), 3))
    for i in range(len(qpos)):
        found[i, 0], found[i, 1] = np.cos(qpos[i, 2]), np.sin(qpos[i, 2])
    return found


@njit(cache=True)
def _free_nose(qpos):  # type: ignore[no-untyped-def]
    """The same of a free root, with a quaternion from index 3."""
    found = np.empty((len(qpos), 3))
    for i in range(len(qpos)):
        w, x, y, z = qpos[i, 3], qpos[i, 4], qpos[i, 5], qpos[i, 6]
        found[i, 0] = 1 - 2 * (y * y + z * z)
        found[i, 1], found[i, 2] = 2 * (x * y + w * z), 2 * (x * z - w * y)
    return found


@njit(cache=True)
def _follow(nose, qvel, inertia, gain, force, world, before):  # type: ignore[no-untyped-def]
    """A planar root's third velocity is its yaw rate: there the nose has no z, so it adds zero."""
    for i in range(len(force)):
        speed = nose[i, 0] * qvel[i, 0] + nose[i, 1] * qvel[i, 1] + nose[i, 2] * qvel[i, 2]
        if np.isfinite(before[i]):
            force[i] += gain[i] * (inertia[i] * (speed - before[i]) - force[i])
        before[i] = speed
        world[i] = force[i] * nose[i]
