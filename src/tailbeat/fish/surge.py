"""Added mass that acts across a part and not along it.

The engine's body mass is one number. A part's added mass m_A in it resists motion along the chord
as much as across it. Water does not: along the chord only s m_A acts, with s the fish's
`added_along`. Let e = (1 - s) m_A be the excess, u, v the part's velocity along and across, and w
its spin. Kirchhoff's equations of a body with m_A across and s m_A along are the engine's, plus

    along  + e du/dt        across  + e u w        moment  - e u v (Munk).

The last two terms depend on velocities alone. They are the engine's own velocity half with the
virtual mass -e / density along the chord (`virtual_mass`), exact at every step. The first term
cannot be a coefficient. It is a force on the head along its heading: the excess of all parts times
the head's surge acceleration over the last `HOLD`, under-relaxed so that it converges (`relieve`).
All parts are assumed to surge like the head.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco import batch
from numpy.typing import NDArray

from tailbeat.fish import edge
from tailbeat.fish.description import Fish

Array = NDArray[np.float64]
NAME = "surge_excess"  # of the number that a compiled model carries [kg]
GAIN = 0.5  # of the step that is exact for a rigid fish; below 1, to damp the tail's oscillation


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


@dataclass(eq=False)
class Relief:
    """State of the correction: the `force` (n,) [N] on each head along its heading, and `before`,
    its speed (n,) [m/s] one `HOLD` ago, NaN if a swim has just begun. `excess` (n,) [kg] and `gain`
    (n,) are constants; `qpos` and `qvel` are the batch's own arrays."""

    root: int
    qpos: Array
    qvel: Array
    excess: Array
    gain: Array
    force: Array
    before: Array


def relief(root: int, pool: batch.Batch, excess: Array, mass: Array) -> Relief:
    """State of a batch at its start. `excess` and `mass` (n,) [kg] are of each model; `mass`
    includes the added mass."""
    gain = np.maximum(GAIN * mass / (mass - excess), 1.0)
    still, unknown = np.zeros(len(mass)), np.full(len(mass), np.nan)
    return Relief(root, pool.bind("qpos"), pool.bind("qvel"), excess, gain, still, unknown)


def begin(state: Relief, chosen: NDArray[np.int64]) -> None:
    """Reset the fish `chosen` (indices), which begin a new swim."""
    state.force[chosen], state.before[chosen] = 0.0, np.nan


def relieve(state: Relief) -> Array:
    """Update the force after one `HOLD`; returns it in world axes (n, 3) [N]."""
    speed = edge.root_motion(state.root, state.qpos, state.qvel, np.zeros((len(state.force), 3)))[
        :, 0
    ]
    wanted = state.excess * np.nan_to_num((speed - state.before) / edge.HOLD)
    state.force += state.gain * (wanted - state.force) * np.isfinite(state.before)
    state.before = speed
    return state.force[:, None] * heading(state.root, state.qpos)


def heading(root: int, qpos: Array) -> Array:
    """The head's nose-ward axis in the world (n, 3)."""
    if root == 3:
        yaw = qpos[:, 2]
        return np.stack([np.cos(yaw), np.sin(yaw), 0 * yaw], axis=1)
    w, x, y, z = qpos[:, 3:7].T
    return np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)], axis=1)
