"""Trailing edge: lift that depends on the direction of the flow along each part.

The engine's Kutta lift is even in the flow along the chord, as if both ends of a plate were
trailing edges. A plate that is launched backward then gets the same thrust backward. The Kutta
condition holds at the trailing edge only. Let u [m/s] be the velocity of a part's centre through
the water along its own nose-ward axis. Every wet part's Kutta coefficient is multiplied by

    w = (1 + r) / 2 + (1 - r) / 2 tanh(u / u_0),

1 ahead and r astern. Thin-aerofoil theory has r = -1: the circulation that keeps the flow smooth
at the rear end follows from the flow across the chord alone. The force rho v x circulation then
keeps its component along the chord when u changes sign, so thrust stays forward. When the rear end
leads, a part of the circulation is lost; r is identified from launched swims.

`u` follows from positions and velocities alone: the law has no memory. `weigh` updates the
coefficients of all fish of a batch once every `HOLD`. The error of this interval is in
docs/experiments/2026-11-steps-and-integrators.md: below 1 % of the path.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco import batch
from numba import njit
from numpy.typing import NDArray

from tailbeat.fish.period import PERIOD

Array = NDArray[np.float64]
NAME = "trailing_edge"  # of the number that a compiled model carries
KUTTA = 4  # column of `geom_fluid`
HOLD = PERIOD  # s between two updates of the coefficients


@dataclass(frozen=True, eq=False)
class Chords:
    """Where the wet parts of a compiled fish are, to compute how each moves.

    `geom` (g,) are geom indices; `link` (g,) is the number of hinges ahead of each (0: head).
    `place` (g, 3) is its centre in the frame of its body [m]. `origin` (links,) is the x of each
    hinge in the frame of the body ahead of it [m]. `root` is the number of the root's velocities
    (3, 6 or 0).
    """

    geom: NDArray[np.int64]
    link: NDArray[np.int64]
    place: Array
    origin: Array
    root: int


def chords(model: mujoco.MjModel) -> Chords:
    """Read a compiled fish's wet parts: the geoms that have fluid coefficients."""
    wet = [g for g in range(model.ngeom) if model.geom_fluid[g, 1:6].any()]
    names = [model.body(int(model.geom_bodyid[g])).name for g in wet]
    links = np.array([int(n.removeprefix("link")) + 1 if n != "head" else 0 for n in names])
    bodies = [model.body(f"link{i}").id for i in range(model.nbody) if _has(model, f"link{i}")]
    return Chords(
        np.array(wet, dtype=np.int64),
        links.astype(np.int64),
        model.geom_pos[wet].copy(),
        model.body_pos[bodies, 0].copy(),
        int(model.joint("motor").dofadr[0]),
    )


def _has(model: mujoco.MjModel, body: str) -> bool:
    return mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, body) >= 0


def blend_of(model: mujoco.MjModel) -> Array | None:
    """Speed u_0 [m/s] and reverse lift r, as (2,), that a model was compiled with. None if it has
    the engine's law."""
    found = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, NAME)
    if found < 0:
        return None
    first = model.numeric_adr[found]
    return np.asarray(model.numeric_data[first : first + 2].copy())


def chord_speeds(where: Chords, qpos: Array, qvel: Array, wind: Array) -> Array:
    """Velocity (n, g) [m/s] of each part's centre through the water along its nose-ward axis.

    `qpos` (n, nq) and `qvel` (n, nv) are the engine's, `wind` (n, 3) [m/s] is the water's velocity.
    """
    root = root_motion(where.root, qpos, qvel, wind)
    first = qpos.shape[1] - len(where.origin)
    rate = qvel.shape[1] - len(where.origin)
    return np.asarray(
        _along(root, qpos[:, first:], qvel[:, rate:], where.origin, where.link, where.place)
    )


def weights(speed: Array, blend: Array) -> Array:
    """Factors w (…, g) for chord speeds (…, g) [m/s]; `blend` (…, 2) as from `blend_of`."""
    blending, reverse = blend[..., :1], blend[..., 1:]
    return np.asarray(0.5 * (1 + reverse + (1 - reverse) * np.tanh(speed / blending)))


@dataclass(frozen=True, eq=False)
class Lift:
    """A batch's lift. `qpos`, `qvel` and `fluid` (`geom_fluid`, (n, ngeom, 12)) are the batch's own
    arrays. `wind` (n, 3) [m/s], the unscaled Kutta coefficients `nominal` (n, g), `blend` (n, 2).
    """

    where: Chords
    qpos: Array
    qvel: Array
    wind: Array
    fluid: Array
    nominal: Array
    blend: Array


def lift(model: mujoco.MjModel, pool: batch.Batch, wind: Array, blend: Array) -> Lift:
    """The lift of a batch at its start. Its coefficients must still be those of its models, and all
    models have the layout of `model` (not checked)."""
    where, fluid = chords(model), pool.expand("geom_fluid")
    return Lift(
        where,
        pool.bind("qpos"),
        pool.bind("qvel"),
        wind,
        fluid,
        fluid[:, where.geom, KUTTA].copy(),
        blend,
    )


def weigh(lift: Lift) -> None:
    """Multiply the Kutta coefficients by w for the present motion, in the batch's own field."""
    speed = chord_speeds(lift.where, lift.qpos, lift.qvel, lift.wind)
    lift.fluid[:, lift.where.geom, KUTTA] = lift.nominal * weights(speed, lift.blend)


def root_motion(root: int, qpos: Array, qvel: Array, wind: Array) -> Array:
    """Velocity through the water [m/s] and spin [rad/s] (n, 6) of the head's frame, in its own
    axes; `root` is its number of velocities."""
    found = np.zeros((len(qpos), 6))
    if root == 3:
        cos, sin = np.cos(qpos[:, 2]), np.sin(qpos[:, 2])
        x, y = qvel[:, 0] - wind[:, 0], qvel[:, 1] - wind[:, 1]
        found[:, 0], found[:, 1], found[:, 5] = cos * x + sin * y, cos * y - sin * x, qvel[:, 2]
    elif root == 6:
        through = qvel[:, :3] - wind
        for i, turn in enumerate(qpos[:, 3:7]):
            back = np.empty(4)
            mujoco.mju_negQuat(back, turn)
            mujoco.mju_rotVecQuat(found[i, :3], through[i], back)
        found[:, 3:] = qvel[:, 3:6]
    else:
        found[:, :3] = -wind  # a fixed head points along x
    return found


@njit(cache=True)
def _along(root, angle, rate, origin, link, place):  # type: ignore[no-untyped-def]
    """Walk down the tail: every hinge turns by minus its angle about z."""
    n, links = angle.shape
    found = np.empty((n, len(link)))
    axis, spin = np.zeros((links + 1, 2)), np.zeros(links + 1)
    at, moves = np.zeros((links + 1, 2)), np.zeros((links + 1, 2))
    for i in range(n):
        axis[0, 0], turned, turning = 1.0, 0.0, 0.0
        for k in range(links):
            out = origin[k] * axis[k]
            at[k + 1] = at[k] + out
            moves[k + 1, 0] = moves[k, 0] - spin[k] * out[1]
            moves[k + 1, 1] = moves[k, 1] + spin[k] * out[0]
            turned -= angle[i, k]
            turning -= rate[i, k]
            axis[k + 1, 0], axis[k + 1, 1], spin[k + 1] = np.cos(turned), np.sin(turned), turning
        v, w = root[i, :3], root[i, 3:]
        for g in range(len(link)):
            k = link[g]
            dx = place[g, 0] * axis[k, 0] - place[g, 1] * axis[k, 1]
            dy = place[g, 0] * axis[k, 1] + place[g, 1] * axis[k, 0]
            x, y, z = at[k, 0] + dx, at[k, 1] + dy, place[g, 2]
            vx = v[0] + w[1] * z - w[2] * y + moves[k, 0] - spin[k] * dy
            vy = v[1] + w[2] * x - w[0] * z + moves[k, 1] + spin[k] * dx
            found[i, g] = vx * axis[k, 0] + vy * axis[k, 1]
    return found
