"""What only the critics of a training see: how each robot is built, and what water it meets.

A critic that knows this learns what an action is worth to this robot. The actor then learns what is
best for all robots that it cannot tell apart (asymmetric actor and critic: Pinto et al., RSS 2018).
The policy sees none of it, so its contract does not change.
"""

import numpy as np
from numpy.typing import NDArray

from tailbeat.control.motion import ahead_and_left
from tailbeat.env.hardship import first_hinge
from tailbeat.env.world import World

Array = NDArray[np.float64]
HIDDEN = 20
# Sizes that make the numbers about one (chosen).
TORQUE, SPRING, FIN, RUB, STICK, BEND = 0.5, 0.5, 0.33, 0.065, 0.08, 0.13
FLOW, PULL, SPEED = 0.05, 0.04, 0.3  # m/s, N, m/s, in the fish's measure
WRONG = {
    "horn": 0.15, "askew": 0.15, "encoder": 0.06, "ahead": 0.04, "left": 0.02,
    "yaw_rate_bias": 0.2, "late": 0.04,
}  # fmt: skip
PLACES = ("ahead", "left")  # m, of a fish of the paper's size


def hidden(world: World) -> NDArray[np.float32]:
    """Hidden numbers (n, `HIDDEN`) of every fish of a world with the twin: its torque, gain,
    springs, fins, friction, what sticks and is bent; the current, the steady pull and its own
    velocity, ahead and to the left; what its robot has wrong."""
    m = world.settings.measure
    yaw, simulator = world.pose[:, 2], world.simulator
    ways = (
        (simulator.physics.fields["opt.wind"][:, :2], FLOW * m.speed),
        (world.pull, PULL * m.push),
        (simulator.qvel[:, :2], SPEED * m.speed),
    )
    wrong = [
        world.wrong[name] / (size * (m.size if name in PLACES else 1.0))
        for name, size in WRONG.items()
    ]
    seen = [ahead_and_left(np.asarray(values), yaw) / size for values, size in ways]
    found = np.column_stack([_built(world), *seen, *wrong])  # a diverged fish has no numbers
    return np.nan_to_num(found, nan=0.0, posinf=0.0, neginf=0.0).astype(np.float32)


def _built(world: World) -> Array:
    """The build (n, 7)."""
    physics = world.simulator.physics
    fields, usual = physics.fields, physics.nominal
    joints, dofs, places = first_hinge(physics)
    springs = fields["jnt_stiffness"][:, joints:]
    limit = usual["actuator_forcerange"][0, 1]
    loss = fields["dof_frictionloss"] - usual["dof_frictionloss"]
    bent = fields["qpos_spring"] - usual["qpos_spring"]
    columns = (
        np.log(fields["actuator_forcerange"][:, 0, 1] / limit) / TORQUE,
        fields["actuator_gainprm"][:, 0, 0] / usual["actuator_gainprm"][0, 0] - 1,
        np.log(springs[:, 0] / usual["jnt_stiffness"][joints]) / SPRING,
        np.log(physics.fins) / FIN,
        loss[:, dofs - 1] / (RUB * limit),
        (loss[:, dofs:] / springs).sum(axis=1) / STICK,
        bent[:, places:].sum(axis=1) / BEND,
    )
    return np.column_stack(columns)
