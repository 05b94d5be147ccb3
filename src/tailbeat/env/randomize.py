"""Physics drawn for every episode, one function per quantity; draws do not accumulate.

Each function uses the nominal model and writes one fish's row of the batch's field; `set_const`
follows once for all fields that need it. Ranges are the paper's where it gives them, else chosen.
"""

from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np
from mujoco import batch
from numpy.typing import NDArray

from tailbeat.control.measure import Measure
from tailbeat.files import BadInput
from tailbeat.fish.twin import Twin

Array = NDArray[np.float64]


PUSH_STEPS = 10  # control steps that a pulse lasts


@dataclass(frozen=True)
class Randomisation:
    """Half widths of uniform draws, as fractions of the nominal value unless a unit is given."""

    head_mass: float = 0.05  # paper
    head_inertia: float = 0.05  # paper
    head_centre: float = 0.005  # m, paper
    tail_stiffness: float = 0.15  # paper
    tail_damping: float = 0.15  # paper
    fluid: float = 0.20  # of every coefficient, independently: paper
    servo_gain: float = 0.15  # chosen: others measured up to a factor of two between servos
    servo_damping: float = 0.15  # chosen
    servo_limit: float = 0.10  # chosen
    servo_delay: float = 0.004  # s, chosen
    density: float = 0.01  # chosen: temperature, salt
    push: float = 0.3  # N rms, force pulses of a fifth of a second; chosen (paper's extension)
    push_share: float = 0.02  # fraction of control steps at which a pulse starts; chosen
    current: float = 0.03  # m/s rms of a steady current; chosen (paper's extension)


def none() -> Randomisation:
    """No randomisation: the nominal twin in every episode."""
    return replace(Randomisation(), **dict.fromkeys(Randomisation.__annotations__, 0.0))


def sized(ranges: Randomisation, measure: Measure) -> Randomisation:
    """The widths for the paper's fish in another fish's measure."""
    return replace(
        ranges,
        head_centre=ranges.head_centre * measure.size,
        push=ranges.push * measure.push,
        current=ranges.current * measure.speed,
    )


def check(ranges: Randomisation) -> None:
    """Check the widths. Raises BadInput for a width below 0, or a relative width of 1 or more."""
    for name, width in vars(ranges).items():
        absolute = name in ("head_centre", "servo_delay", "push", "current")
        if width < 0 or (not absolute and width >= 1):
            most = "" if absolute else " and less than 1"
            raise BadInput(f"randomisation: {name} = {width:g}; allowed is 0 or more{most}.")


FIELDS = (
    "body_mass",
    "body_inertia",
    "body_ipos",
    "jnt_stiffness",
    "dof_damping",
    "geom_fluid",
    "actuator_gainprm",
    "actuator_biasprm",
    "actuator_forcerange",
    "actuator_delay",
    "opt.density",
    "opt.wind",
    "tendon_invweight0",  # not drawn, computed from the masses
    *(WORSE := ("dof_frictionloss", "qpos_spring")),  # drawn by `hardship.py` alone
)


@dataclass(frozen=True, eq=False)
class Physics:
    """The batch's own fields (n, …), which the engine uses, and their nominal values. `draws`
    (d, zones, 5) are a posterior's coefficients over the nominal ones, None without one. `fins`
    (n,) are the fins' heights over the described ones."""

    twin: Twin
    pool: batch.Batch
    fields: dict[str, Array]
    nominal: dict[str, Array]
    fins: Array
    draws: Array | None = None


def expand(twin: Twin, pool: batch.Batch, draws: Array | None = None) -> Physics:
    """Give every fish its own copy of the fields that are drawn."""
    fields = {name: pool.expand(name) for name in FIELDS}
    nominal = {name: np.array(values[0]) for name, values in fields.items()}
    return Physics(twin, pool, fields, nominal, np.ones(len(fields["body_mass"])), draws)


def randomize(physics: Physics, ranges: Randomisation, fish: int, rng: np.random.Generator) -> None:
    """Draw one fish's physics from the nominal ones. Call `refresh` when all are drawn."""
    model = physics.twin.model
    head, motor = model.body("head").id, int(model.joint("motor").dofadr[0])
    _scale(physics, "body_mass", fish, head, _factor(ranges.head_mass, rng))
    _scale(physics, "body_inertia", fish, head, _factor(ranges.head_inertia, rng))
    centre = physics.nominal["body_ipos"][head] + ranges.head_centre * rng.uniform(-1, 1) * AXIS
    physics.fields["body_ipos"][fish, head] = centre
    hinges = slice(motor + 1, None)
    _scale(physics, "jnt_stiffness", fish, hinges, _factor(ranges.tail_stiffness, rng))
    _scale(physics, "dof_damping", fish, hinges, _factor(ranges.tail_damping, rng))
    _scale(physics, "dof_damping", fish, motor, _factor(ranges.servo_damping, rng))
    _fluid(physics, ranges.fluid, fish, rng)
    _servo(physics, ranges, fish, rng)
    _scale(physics, "opt.density", fish, (), _factor(ranges.density, rng))
    flow = ranges.current * rng.normal(size=2)
    physics.fields["opt.wind"][fish] = [*flow, 0.0]
    physics.fins[fish] = 1.0
    for name in WORSE:
        physics.fields[name][fish] = physics.nominal[name]


NO_FORWARD = int(mujoco.mjtStage.mjSTAGE_NONE)  # a reset needs no forward pass
AXIS = np.array([1.0, 0.0, 0.0])


def _factor(width: float, rng: np.random.Generator) -> float:
    return float(1 + width * rng.uniform(-1, 1))


def _scale(physics: Physics, name: str, fish: int, part: Any, factor: float) -> None:
    """One part of a fish's field, from the nominal value: never from the last draw."""
    if part == ():
        physics.fields[name][fish] = physics.nominal[name] * factor
    else:
        physics.fields[name][fish, part] = physics.nominal[name][part] * factor


def _fluid(physics: Physics, width: float, fish: int, rng: np.random.Generator) -> None:
    """Scale every zone's five coefficients independently; parts of one zone keep the same
    factors. With draws of a posterior, take one of them instead, as far from the nominal fish as
    `width` is of its default."""
    coefficients = physics.nominal["geom_fluid"][:, 1:6]
    if physics.draws is not None:
        row = physics.draws[rng.integers(len(physics.draws))] - 1
        drawn = np.where(physics.twin.zones[:, None] < 0, 0.0, row[physics.twin.zones])
        share = width / Randomisation.fluid
        physics.fields["geom_fluid"][fish, :, 1:6] = coefficients * (1 + share * drawn)
        return
    labelled = np.column_stack([coefficients, physics.twin.zones])
    kinds, zone = np.unique(labelled, axis=0, return_inverse=True)
    factors = 1 + width * rng.uniform(-1, 1, (len(kinds), 5))
    physics.fields["geom_fluid"][fish, :, 1:6] = coefficients * factors[zone.ravel()]


def _servo(physics: Physics, ranges: Randomisation, fish: int, rng: np.random.Generator) -> None:
    set_servo(physics, fish, _factor(ranges.servo_gain, rng), _factor(ranges.servo_limit, rng))
    delay = physics.nominal["actuator_delay"]
    if delay[0] > 0:
        # the engine's buffer holds one step more than the nominal delay
        longest = delay + physics.twin.model.opt.timestep
        drawn = delay + ranges.servo_delay * rng.uniform(-1, 1)
        physics.fields["actuator_delay"][fish] = np.clip(drawn, 1e-4, longest)


def set_servo(physics: Physics, fish: int, gain: float, limit: float) -> None:
    """One fish's servo, with factors on its gain (and damping) and on its torque limit."""
    for name in ("actuator_gainprm", "actuator_biasprm"):
        physics.fields[name][fish] = physics.nominal[name] * gain
    physics.fields["actuator_forcerange"][fish] = physics.nominal["actuator_forcerange"] * limit


def refresh(physics: Physics, fish: NDArray[np.int64]) -> None:
    """Recompute what the engine derives from masses, for the fish that were drawn."""
    physics.pool.set_const(fish)
    # the engine overwrites what `compile_twin` had changed
    physics.fields["geom_fluid"][fish, :, 6:] = physics.nominal["geom_fluid"][:, 6:]
    physics.fields["tendon_invweight0"][fish] *= physics.twin.taut_share


def pulses(ranges: Randomisation, steps: int, rng: np.random.Generator) -> Array:
    """Force pulses (steps, 2) [N] on the head, for an episode."""
    begins = rng.uniform(size=steps) < ranges.push_share
    force = np.zeros((steps, 2))
    for first in np.flatnonzero(begins):
        force[first : first + PUSH_STEPS] = ranges.push * rng.normal(size=2)
    return force
