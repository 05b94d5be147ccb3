"""From the shaft to the hinges and back: k = r^2 / sum(d_i^2 / k_i) with k_i ~ h_i / L_i.

Paper: the tendon's force F bends hinge i by phi_i = F d_i / k_i. The wound length is r theta =
sum d_i phi_i, and the torque on the shaft is tau = F r. With one modulus and one thickness
(Euler-Bernoulli), k_i is proportional to strip height over strip length. Each hinge's damping is in
proportion to its stiffness.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from tailbeat.fish.description import Fish
from tailbeat.fish.linkage import at_shaft, moment_arms, spread
from tailbeat.fish.show import shaft_stiffness
from tailbeat.fish.store import with_values
from tailbeat.fish.twin import Options, compile_twin

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Hinges:
    """Stiffness of each hinge [N m/rad] that gives k_eff at the shaft, and the source of the
    `pattern`. Moment `arms` and motor `radius` [m].

    `k_compiled` [N m/rad] is the stiffness at the shaft, read from the compiled twin. It checks the
    formula, and differs from it if tendons stretch. `i_compiled` [kg m^2] is the tail's inertia at
    the shaft.
    """

    stiffness: tuple[float, ...]
    pattern: str
    arms: tuple[float, ...]
    radius: float
    k_compiled: float
    i_compiled: float


def hinges_for(fish: Fish, k_eff: float, c_eff: float) -> Hinges:
    """Distribute the measured stiffness `k_eff` [N m/rad] and damping `c_eff` [N m s/rad] at the
    shaft over a fish's hinges. The result is read back from the compiled twin."""
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
    """h / L of the strips if every link states both, else the described stiffnesses."""
    strips = [(link.strip_height, link.strip_length) for link in fish.tail.links]
    if all(height and length for height, length in strips):
        return np.array([(h or 0.0) / (w or 1.0) for h, w in strips]), "strip height over length"
    return np.array([link.stiffness for link in fish.tail.links]), "the description's stiffnesses"


def tail_values(stiffness: Array, k_eff: float, c_eff: float) -> dict[str, float]:
    """Field -> value [SI] of an identified tail. A negative `c_eff` becomes 0."""
    found = {f"tail.links.{i}.stiffness": float(k) for i, k in enumerate(stiffness)}
    damping_time = max(c_eff, 0.0) / k_eff
    return {
        **found,
        "tail.stiffness_scale": 1.0,
        "tail.k_eff": k_eff,
        "tail.damping_time": damping_time,
    }


def with_stiffness(fish: Fish, stiffness: Array, k_eff: float, c_eff: float) -> Fish:
    """The fish with hinge stiffnesses (n,) [N m/rad], and `k_eff` [N m/rad] and `c_eff` [N m s/rad]
    at the shaft."""
    return with_values(fish, tail_values(stiffness, k_eff, c_eff))


def tail_inertia(fish: Fish) -> float:
    """Inertia of the dry tail at the shaft [kg m^2], with pulley and without the motor's armature,
    for the quasi-static shape of its springs. Below the first bending mode this is the I that a
    sweep finds."""
    dry = at_shaft(fish)
    return dry.inertia + dry.rotor
