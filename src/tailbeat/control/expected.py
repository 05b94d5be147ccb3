"""How a policy's swims look to the robot's own sensors: two models, and bounds on the signals.

`train.expect` derives all of it from simulated swims of the policy, and writes it into the policy's
file beside the contract. Needs only numpy.
"""

import json
import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.control.actions import PERIOD
from tailbeat.files import BadInput

Array = NDArray[np.float64]
KEY = "tailbeat-expected"  # of the file's metadata
# What a file may say, lowest and highest: far beyond each fish so far, but no monitor is ever off.
BOUNDS = {
    "turning": (0.0, 1.0), "drifting": (0.0, 1.0), "progress_low": (0.0, 0.1),
    "stroke_low": (-2.0, 1.0), "stroke_high": (1.0, 5.0),
    "recoil_low": (-2.0, 1.0), "recoil_high": (1.0, 5.0),
    "least_angle": (0.0, 0.5), "least_rate": (0.0, 5.0), "seconds": (0.0, 1e9),
    "kp": (1e-9, 1e6), "kv": (0.0, 1e4), "force_limit": (1e-9, 1e4), "friction": (0.0, 1e3),
    "inertia": (1e-12, 1e3), "damping": (0.0, 1e4), "stiffness": (0.0, 1e6),
}  # fmt: skip
WEIGHT = 1e4  # 1/s, the largest weight of a recoil
UNREADABLE = (
    AttributeError, KeyError, OverflowError, RecursionError, TypeError, ValueError,
)  # fmt: skip
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
    except UNREADABLE as error:
        raise BadInput(
            f"{path}: what it says of its swims cannot be read ({error}); write it again with"
            f" `tailbeat policy expect`."
        ) from None
    return found


def bounded(found: Expected) -> Expected:
    """The same with limits and least rms that a file may have."""
    limits = {name: clipped(name, value) for name, value in asdict(found.limits).items()}
    return replace(
        found,
        limits=Limits(**limits),
        least_angle=clipped("least_angle", found.least_angle),
        least_rate=clipped("least_rate", found.least_rate),
    )


def clipped(name: str, value: float) -> float:
    """A number of this name, or the nearest that a file may have."""
    low, high = BOUNDS[name]
    return min(max(value, low), high)


def _check(found: Expected) -> None:
    """Raises ValueError for numbers that no swim gives."""
    numbers: dict[str, Any] = {**asdict(found.shaft), **asdict(found.limits)}
    numbers |= {name: getattr(found, name) for name in ("least_angle", "least_rate", "seconds")}
    delay = numbers.pop("delay")
    if not all(isinstance(one, float | int) for one in [*numbers.values(), delay]):
        raise ValueError("a number is missing")
    for name, value in numbers.items():
        low, high = BOUNDS[name]
        if not low <= value <= high:
            raise ValueError(f"{name} is {value!r:.40}, allowed is {low:g} to {high:g}")
    sane = all(abs(weight) <= WEIGHT for weight in found.recoil)
    if not 2 <= len(found.recoil) <= 100 or not sane:
        raise ValueError("its recoil is not one of a fish")
    if not 0 <= delay <= PERIOD * SUBSTEPS:
        raise ValueError(f"a delay of {delay:g} s")
