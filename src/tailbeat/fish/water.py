"""What the engine's fluid law lacks, put right once every `HOLD` for one fish or a thousand.

Two corrections, each where a description asks for it: lift that knows its trailing edge (`edge.py`)
and added mass that acts across alone (`surge.py`). Both follow from positions and velocities; the
second remembers one speed and one force from `HOLD` before.
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
    """The fish with every correction on: added mass as inertia, across the parts alone, and lift
    with a trailing edge; explicit Euler, exact and cheap with it (docs/explain/twin.md)."""
    changed = {
        "added_inertia": 1.0,
        "added_along": 0.0,
        "trailing_edge": fish.trailing_edge or TrailingEdge(),
        "simulation": fish.simulation.model_copy(update={"integrator": "Euler"}),
    }
    return Fish.model_validate(fish.model_copy(update=changed).model_dump())


@dataclass(frozen=True, eq=False)
class Water:
    """A batch's corrections; `steps` of the engine between two of them."""

    lift: edge.Lift | None
    relief: surge.Relief | None
    steps: int


def water(models: Sequence[mujoco.MjModel], pool: batch.Batch, wind: Array) -> Water | None:
    """Of a batch whose fish `i` is `models[i]`, all of one layout, in water that moves with `wind`
    (n, 3) [m/s]; None where the engine's law is all that is asked for."""
    root, step = int(models[0].joint("motor").dofadr[0]), models[0].opt.timestep
    blends = [blend for model in models if (blend := edge.blend_of(model)) is not None]
    lift = edge.lift(models[0], pool, wind, np.stack(blends)) if blends else None
    excess = np.array([surge.excess_of(model) for model in models])
    mass = np.array([model.body_mass.sum() for model in models])
    relief = surge.relief(root, pool, excess, mass) if excess.any() and root else None
    if lift is None and relief is None:
        return None
    return Water(lift, relief, max(round(edge.HOLD / step), 1))


def correct(found: Water) -> Array | None:
    """Weigh the lift of the steps to come; the force on each head (n, 3) [N] that goes with them,
    None where there is none."""
    if found.lift is not None:
        edge.weigh(found.lift)
    return None if found.relief is None else surge.relieve(found.relief)
