"""Correct the engine's fluid law while it steps, for any number of fish.

There are two corrections, and a description chooses each: lift that depends on the direction of the
flow (`edge.py`), once every `HOLD`, and added mass that acts less along the parts (`surge.py`), at
every step. Both follow from positions and velocities; the second also keeps one speed and one force
from the step before.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco import batch
from numpy.typing import NDArray

from tailbeat.fish import edge, surge
from tailbeat.fish.description import Fish, TrailingEdge

Array = NDArray[np.float64]


def whole(fish: Fish) -> Fish:
    """The fish with every correction on: added mass as inertia, less of it along the parts, and
    lift with a trailing edge. The integrator is Euler: it is exact and cheap with added mass as
    inertia (docs/explain/twin.md)."""
    changed = {
        "added_inertia": 1.0,
        "added_along": 0.0,
        "trailing_edge": fish.trailing_edge or TrailingEdge(),
        "simulation": fish.simulation.model_copy(update={"integrator": "Euler"}),
    }
    return Fish.model_validate(fish.model_copy(update=changed).model_dump())


@dataclass(frozen=True, eq=False)
class Water:
    """A batch's corrections, and the number of the engine's steps `held` between two updates of
    the lift."""

    lift: edge.Lift | None
    relief: surge.Relief | None
    held: int

    @property
    def block(self) -> int:
        """Most steps of the engine in one call."""
        return self.held if self.relief is None else 1


def water(models: Sequence[mujoco.MjModel], pool: batch.Batch, wind: Array) -> Water | None:
    """The corrections of a batch in which fish `i` is `models[i]`, all of one layout, in water that
    moves with `wind` (n, 3) [m/s]. None if no model has a correction."""
    root, step = int(models[0].joint("motor").dofadr[0]), models[0].opt.timestep
    blends = [blend for model in models if (blend := edge.blend_of(model)) is not None]
    lift = edge.lift(models[0], pool, wind, np.stack(blends)) if blends else None
    excess = np.array([surge.excess_of(model) for model in models])
    mass = np.array([model.body_mass.sum() for model in models])
    relief = surge.relief(root, pool, excess, mass, step) if excess.any() and root else None
    if lift is None and relief is None:
        return None
    return Water(lift, relief, max(round(edge.HOLD / step), 1))


def correct(found: Water, step: int) -> Array | None:
    """Correct before the engine's step number `step` of a swim. Returns the force on each head for
    this step, in world axes (n, 3) [N], None if there is none."""
    if found.lift is not None and step % found.held == 0:
        edge.weigh(found.lift)
    return None if found.relief is None else surge.relieve(found.relief)
