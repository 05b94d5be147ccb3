"""How a policy's swims look to the robot's own sensors: two models, and bounds on the signals.

`train.expect` derives all of it from simulated swims of the policy, and writes it into the policy's
file beside the contract. Needs only numpy.
"""

import json
import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.control.actions import PERIOD
from tailbeat.files import BadInput

Array = NDArray[np.float64]
KEY = "tailbeat-expected"  # of the file's metadata
SUBSTEPS = 10  # of a control period, 2 ms each
SMOOTH = 0.02  # rad/s over which dry friction changes sign


@dataclass(frozen=True)
class ShaftModel:
    """The servo with its tail as one inertia: what angle follows from the setpoints that were sent.

    The servo's numbers are the fish's: `kp` [N m/rad], `kv` [N m s/rad], `force_limit` [N m],
    `delay` [s], `friction` [N m]. The load's are fitted to the policy's swims: `inertia` [kg m^2],
    `damping` [N m s/rad], `stiffness` [N m/rad].
    """

    kp: float
    kv: float
    force_limit: float
    delay: float
    friction: float
    inertia: float
    damping: float
    stiffness: float


@dataclass(frozen=True)
class Limits:
    """Bounds on `consistency.Signs`, by their names; `drifting` and `turning` on their sizes."""

    turning: float
    drifting: float
    stroke_low: float
    stroke_high: float
    recoil_low: float
    recoil_high: float
    progress_low: float


@dataclass(frozen=True)
class Expected:
    """What to expect of a policy's swims.

    The `shaft`; `recoil`, weights [1/s] of the last motor angles, newest first, that give the yaw
    rate; the `limits`; the rms of the predicted angle [rad] and yaw rate [rad/s] below which no
    gain is taken; and from how many `seconds` of swims all this comes.
    """

    shaft: ShaftModel
    recoil: tuple[float, ...]
    limits: Limits
    least_angle: float
    least_rate: float
    seconds: float


@dataclass(frozen=True)
class ShaftState:
    """The modelled shaft: angle [rad], velocity [rad/s], and the last setpoints [rad], newest
    first."""

    angle: float
    velocity: float
    sent: tuple[float, ...]


def held(model: ShaftModel, angle: float) -> ShaftState:
    """A shaft at rest that is held at an angle [rad]."""
    return ShaftState(angle, 0.0, (angle,) * (split(model)[0] + 2))


def split(model: ShaftModel) -> tuple[int, int]:
    """The servo's delay in whole periods, and in substeps of the next."""
    return divmod(round(model.delay / PERIOD * SUBSTEPS), SUBSTEPS)


def turn(model: ShaftModel, state: ShaftState, setpoint: float) -> ShaftState:
    """The shaft one control period after a setpoint [rad] was sent."""
    whole, rest = split(model)
    sent = (setpoint, *state.sent[:-1])
    figures = (model.kp, model.kv, model.force_limit, model.friction)
    load = (model.inertia, model.damping, model.stiffness)
    moved = advance(state.angle, state.velocity, sent[whole + 1], sent[whole], rest, figures, load)
    return ShaftState(*moved, sent)


def advance(
    angle: float,
    velocity: float,
    older: float,
    newer: float,
    rest: int,
    servo: tuple[float, float, float, float],
    load: tuple[float, float, float],
) -> tuple[float, float]:
    """Angle and velocity after one control period: the servo holds the setpoint `older` for `rest`
    substeps, then `newer`. Damping and springs are implicit, so that no load diverges. Scalars
    alone, so that it can be compiled for a fit."""
    kp, kv, limit, friction = servo
    inertia, damping, stiffness = load
    dt = PERIOD / SUBSTEPS
    whole = inertia + dt * (kv + damping) + dt * dt * (kp + stiffness)
    for k in range(SUBSTEPS):
        wanted = kp * ((older if k < rest else newer) - angle) - kv * velocity
        torque = min(max(wanted, -limit), limit)
        dry = friction * velocity / math.sqrt(velocity * velocity + SMOOTH * SMOOTH)
        velocity += dt * (torque - stiffness * angle - damping * velocity - dry) / whole
        angle += dt * velocity
    return angle, velocity


# ---- in the file --------------------------------------------------------------------------------


def as_text(expected: Expected) -> str:
    """JSON, as the policy's file carries it."""
    return json.dumps(asdict(expected), sort_keys=True, allow_nan=False)


def read(path: Path, text: str | None) -> Expected | None:
    """What a policy's file says; None where it says nothing. Raises BadInput."""
    if text is None:
        return None
    try:
        content = json.loads(text)
        shaft, limits = ShaftModel(**content.pop("shaft")), Limits(**content.pop("limits"))
        recoil = tuple(map(float, content.pop("recoil")))
        found = Expected(shaft=shaft, limits=limits, recoil=recoil, **content)
        _check(found)
    except (AttributeError, KeyError, TypeError, ValueError, RecursionError) as error:
        raise BadInput(
            f"{path}: what it says of its swims cannot be read ({error}); write it again with"
            f" `tailbeat policy expect`."
        ) from None
    return found


def _check(found: Expected) -> None:
    """Raises ValueError for numbers that no swim gives."""
    numbers: list[Any] = [*asdict(found.shaft).values(), *asdict(found.limits).values()]
    numbers += [*found.recoil, found.least_angle, found.least_rate, found.seconds]
    if not all(isinstance(one, float | int) and math.isfinite(one) for one in numbers):
        raise ValueError("a number is missing or not finite")
    if not 2 <= len(found.recoil) <= 100 or found.shaft.inertia <= 0:
        raise ValueError("its recoil or its shaft is not one of a fish")
    if not 0 <= found.shaft.delay <= PERIOD * SUBSTEPS:
        raise ValueError(f"a delay of {found.shaft.delay:g} s")
