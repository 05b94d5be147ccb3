"""From the shaft to the hinges: arms of the tendon, and the tail's stiffness and inertia there.

Paper: k = r^2 / sum(d_i^2 / k_i) with the pulley's radius r and the hinges' arms d_i. Under a slow
pull, hinge i bends by phi_i = theta (k / r) d_i / k_i.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from tailbeat.fish.description import Fish
from tailbeat.fish.twin import Options, Twin, compile_twin

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class AtShaft:
    """A tail seen from the shaft, head held: its `stiffness` [N m/rad] by the formula above, the
    `bend` of its hinges (n,) per rad of the shaft, and its `inertia` [kg m^2] for that bend;
    `rotor` is the motor's own inertia without the armature."""

    stiffness: float
    bend: Array
    inertia: float
    rotor: float


def moment_arms(twin: Twin, data: mujoco.MjData) -> tuple[Array, float]:
    """Arms dL/dq of the left tendon at the hinges (n,), and at the motor, signs included [m]."""
    jacobian = np.zeros((twin.model.ntendon, twin.model.nv))
    mujoco.mju_sparse2dense(
        jacobian,
        data.ten_J.ravel(),
        twin.model.ten_J_rownnz,
        twin.model.ten_J_rowadr,
        twin.model.ten_J_colind.ravel(),
    )
    motor = int(twin.model.joint("motor").dofadr[0])
    row = jacobian[twin.model.tendon("left").id]
    return -row[motor + 1 :], float(row[motor])


def stiffness_of(radius: float, arms: Array, hinges: Array) -> float:
    """Stiffness at the shaft [N m/rad] of hinges of these stiffnesses (n,) [N m/rad]."""
    return float(radius**2 / np.sum(arms**2 / hinges))


def spread(radius: float, arms: Array, pattern: Array, k_eff: float) -> Array:
    """Hinge stiffnesses (n,) [N m/rad] in proportion to `pattern` (n,) that give `k_eff` [N m/rad].

    `radius` of the pulley and moment `arms` (n,) need the same unit.
    """
    return np.asarray(pattern * k_eff * np.sum(arms**2 / pattern) / radius**2)


def mass_matrix(twin: Twin, data: mujoco.MjData) -> Array:
    """Mass matrix (nv, nv) of a compiled fish in SI."""
    full = np.zeros((twin.model.nv, twin.model.nv))
    mujoco.mj_fullM(twin.model, data, full)
    return full


def at_shaft(fish: Fish, added_inertia: float = 0.0) -> AtShaft:
    """The tail at the shaft, with this share of its parts' added mass. Below the first bending mode
    its inertia is the one that a sweep finds."""
    described = fish.model_copy(update={"added_inertia": added_inertia})
    twin = compile_twin(described, Options(root="fixed"))
    data = mujoco.MjData(twin.model)
    mujoco.mj_forward(twin.model, data)
    arms, radius = moment_arms(twin, data)
    joint = twin.model.joint("motor")
    motor, hinges = int(joint.dofadr[0]), twin.model.jnt_stiffness[joint.id + 1 :]
    stiffness = stiffness_of(radius, arms, hinges)
    bend, full = stiffness / radius * arms / hinges, mass_matrix(twin, data)
    return AtShaft(
        stiffness,
        bend,
        float(bend @ full[motor + 1 :, motor + 1 :] @ bend),
        float(full[motor, motor] - twin.model.dof_armature[motor]),
    )


def free_bends(fish: Fish) -> Array:
    """How far each hinge (n,) [rad] may bend until the guides on both sides of it are in line with
    it. There the tendon has no arm left, and beyond it pulls the other way. Infinite for a hinge
    without guides on both sides, and where the tendon crosses the middle."""
    before, found = list(fish.tendons.head_guides), []
    for link in fish.tail.links:
        side = -1.0 if link.crossed else 1.0
        guides = [(x, side * y) for x, y in link.guides]
        near = [(x - link.hinge, y) for x, y in (*before[-1:], *guides[:1])]
        angles = [float(np.arctan2(y, x)) for x, y in near]
        one_side = len(near) == 2 and near[0][1] * near[1][1] > 0
        found.append(abs(angles[1] - angles[0]) if one_side else np.inf)
        before = guides
    return np.array(found)
