"""From the shaft to the hinges and back: k = r^2 / sum(d_i^2 / k_i) with k_i ~ h_i / L_i.

Paper: the tendon's force F bends hinge i by F d_i / k_i, winds off r theta = sum d_i phi_i, and
turns the shaft with tau = F r. Euler-Bernoulli with one modulus and thickness leaves k_i
proportional to strip height over strip length. Damping is spread in proportion to stiffness.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from tailbeat.fish.description import Fish
from tailbeat.fish.show import moment_arms, shaft_stiffness
from tailbeat.fish.store import with_values
from tailbeat.fish.twin import Options, Twin, compile_twin

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Hinges:
    """Stiffness per hinge [N m/rad] that gives k_eff at the shaft, and whence their pattern.

    `k_compiled` [N m/rad] is the shaft's stiffness read from the compiled twin, a check on the
    formula (it differs where tendons stretch), `i_compiled` [kg m^2] the tail's inertia there.
    """

    stiffness: tuple[float, ...]
    pattern: str
    arms: tuple[float, ...]
    radius: float
    k_compiled: float
    i_compiled: float


def spread(radius: float, arms: Array, pattern: Array, k_eff: float) -> Array:
    """Hinge stiffnesses (n,) in proportion to `pattern` that give `k_eff` at the shaft.

    `radius` of the pulley and moment `arms` (n,) in the same unit.
    """
    return np.asarray(pattern * k_eff * np.sum(arms**2 / pattern) / radius**2)


def hinges_for(fish: Fish, k_eff: float, c_eff: float) -> Hinges:
    """Spread a measured stiffness over a fish's hinges, and read the result back."""
    twin = compile_twin(fish, Options(root="fixed"))
    data = mujoco.MjData(twin.model)
    mujoco.mj_forward(twin.model, data)
    arms, radius = moment_arms(twin, data)
    pattern, whence = _pattern(fish)
    stiffness = spread(radius, arms, pattern, k_eff)
    changed = with_stiffness(fish, stiffness, k_eff, c_eff)
    return Hinges(
        tuple(float(k) for k in stiffness),
        whence,
        tuple(float(abs(d)) for d in arms),
        abs(radius),
        shaft_stiffness(changed),
        tail_inertia(changed),
    )


def _pattern(fish: Fish) -> tuple[Array, str]:
    """h / L of the strips where every link states them, else the described stiffnesses."""
    strips = [(link.strip_height, link.strip_length) for link in fish.tail.links]
    if all(height and length for height, length in strips):
        return np.array([(h or 0.0) / (w or 1.0) for h, w in strips]), "strip height over length"
    return np.array([link.stiffness for link in fish.tail.links]), "the description's stiffnesses"


def tail_values(stiffness: Array, k_eff: float, c_eff: float) -> dict[str, float]:
    """Field -> value of an identified tail."""
    found = {f"tail.links.{i}.stiffness": float(k) for i, k in enumerate(stiffness)}
    damping_time = max(c_eff, 0.0) / k_eff
    return {
        **found,
        "tail.stiffness_scale": 1.0,
        "tail.k_eff": k_eff,
        "tail.damping_time": damping_time,
    }


def with_stiffness(fish: Fish, stiffness: Array, k_eff: float, c_eff: float) -> Fish:
    """The fish with an identified tail."""
    return with_values(fish, tail_values(stiffness, k_eff, c_eff))


def tail_inertia(fish: Fish) -> float:
    """Inertia of the dry tail at the shaft [kg m^2], bending as its springs alone would have it.

    The quasi-static shape phi_i = theta (k / r) d_i / k_i moves the links' mass matrix. The motor's
    own armature is left out. Below the first bending mode this is the I that a sweep finds.
    """
    dry = fish.model_copy(update={"added_inertia": 0.0})
    twin = compile_twin(dry, Options(root="fixed"))
    data = mujoco.MjData(twin.model)
    mujoco.mj_forward(twin.model, data)
    arms, radius = moment_arms(twin, data)
    stiffness = twin.model.jnt_stiffness[twin.model.joint("motor").id + 1 :]
    shape = (arms / stiffness) * radius / np.sum(arms**2 / stiffness)
    moved = np.concatenate([[1.0], shape])
    return float(moved @ _mass_matrix(twin, data) @ moved) - _armature(twin)


def _mass_matrix(twin: Twin, data: mujoco.MjData) -> Array:
    full = np.zeros((twin.model.nv, twin.model.nv))
    mujoco.mj_fullM(twin.model, data, full)
    return full


def _armature(twin: Twin) -> float:
    return float(twin.model.dof_armature[int(twin.model.joint("motor").dofadr[0])])
