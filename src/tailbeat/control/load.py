"""What a servo's current says: how hard each tendon pulls, and which setpoints the servo obeys.

A motor's torque is its current's. Less what turns its own rotor, it is the tail's pull; and of the
setpoints, only those that the servo obeys explain it. Pure functions of a window of the robot's
last seconds (see `consistency.COLUMNS`). Needs only numpy.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tailbeat.control.consistency import ANGLE, CURRENT, SENT, SHORT, SPAN, TIME, since
from tailbeat.control.expected import ShaftModel, split

Array = NDArray[np.float64]
NAMES = ("left", "right", "obeyed")
# Of the torque limit: rms over a window of a pull that can be compared. With 0.1 a bent tail and a
# turned horn of an everyday lab took up to 87 % off the pull of a fish that turned to one side.
LEAST = 0.15
LITTLE = 0.05  # the same in the sign test, where friction is left out (chosen)
TURNING = 0.15  # rad/s of a shaft that turns: of a slower one friction may have either sign
STRAINED = 0.15  # of the torque limit: rms of a torque that says which setpoints were obeyed
# Of what a tendon should pull: 0.34 was the least in six everyday minutes of a fish that turns
# tightly, and cut ones have 0.04 to 0.2.
PULL = 0.25
TEST_PULL = 0.3  # in the sign test: 0.35 was the least of 100 everyday labs
OBEYED = 0.775  # of the setpoints: 0.8 was the least there; nine of ten halved ones have less
ASTRAY = 2.0  # factor by which a servo's gain or the unit of its current may be off (chosen)
DOUBT = 0.01  # of the torque's power, which explains a share as well as the best (chosen)
SHARES = np.linspace(0.2, 1.5, 27)


@dataclass(frozen=True)
class Motor:
    """The motor: its torque at the shaft per ampere [N m/A], the inertia of its rotor at the shaft
    [kg m^2], and its back EMF as a damping of the shaft [N m s/rad]."""

    per_ampere: float
    inertia: float
    damping: float


def sign(name: str, window: Array, shaft: ShaftModel, motor: Motor) -> float:
    """`left`, `right` (see `pulls`) of the last 2 s of a window (k, 13), or `obeyed` of the last
    second."""
    if name == "obeyed":
        return obeyed(since(window, SHORT), shaft, motor)
    return pulls(since(window, SPAN), shaft, motor)[NAMES.index(name)]


def pulls(window: Array, shaft: ShaftModel, motor: Motor) -> tuple[float, float]:
    """How hard the left and the right tendon pull on the tail, each over what the angles of the
    motor lead to; a slack one's is near 0. NaN for a tendon that has little to pull, or if a torque
    is not known. Where the shaft rests it is left out: the friction of the gears holds a part."""
    left, right, _, seen = _parts(window, shaft, motor)
    enough = len(window) * (LEAST * shaft.force_limit) ** 2
    factors = [
        float(side @ seen) / power if (power := float(side @ side)) > enough else float("nan")
        for side in (left, right)
    ]
    return factors[0], factors[1]


def bent_pulls(window: Array, shaft: ShaftModel, motor: Motor) -> tuple[float, float]:
    """The same of a tail that is bent to both sides, as in the sign test, where little else pulls:
    a friction of any size and a tail that rests bent are fitted, and left out."""
    *sides, turned, seen = _parts(window, shaft, motor)
    columns = np.stack([*sides, turned, np.ones(len(seen))], axis=1)
    enough = len(window) * (LITTLE * shaft.force_limit) ** 2
    known = np.square(columns).sum(axis=0) > [enough, enough, 0.0, 0.0]
    factors = np.full(4, np.nan)
    if np.isfinite(seen).all() and seen.size > 4:
        factors[known] = np.linalg.lstsq(columns[:, known], seen, rcond=None)[0]
    return float(factors[0]), float(factors[1])


def _parts(window: Array, shaft: ShaftModel, motor: Motor) -> tuple[Array, Array, Array, Array]:
    """Of the periods (k,) in which the shaft turns: what the left and the right tendon should pull
    [N m], the direction of turning, and what the current shows of the pull."""
    velocity, acceleration = rates(window)
    wanted = (
        max(shaft.inertia - motor.inertia, 0.0) * acceleration
        + max(shaft.damping - motor.damping, 0.0) * velocity
        + shaft.stiffness * window[:, ANGLE]
    )
    seen = motor.per_ampere * window[:, CURRENT] - motor.inertia * acceleration
    turning = np.abs(velocity) > TURNING
    wanted, seen = wanted[turning], seen[turning]
    return np.maximum(wanted, 0.0), np.minimum(wanted, 0.0), np.sign(velocity[turning]), seen


def obeyed(window: Array, shaft: ShaftModel, motor: Motor) -> float:
    """The share of its setpoints that the servo obeys: of those that explain its torque, up to a
    factor of `ASTRAY`, the one nearest to 1. NaN while the servo is hardly strained, or where its
    torque is not known."""
    velocity, _ = rates(window)
    torque = motor.per_ampere * window[:, CURRENT] + motor.damping * velocity
    if not np.sqrt(np.mean(torque * torque)) > STRAINED * shaft.force_limit:
        return float("nan")
    late, limit = split(shaft)[0], shaft.force_limit
    sent, own = window[: len(window) - late, SENT], slice(late, None)
    back = shaft.kp * window[own, ANGLE] + shaft.kv * velocity[own]
    made = np.clip(shaft.kp * SHARES[:, None] * sent - back, -limit, limit)
    power, match = np.square(made).sum(axis=1), made @ torque[own]
    factor = np.clip(match / np.maximum(power, 1e-12), 1 / ASTRAY, ASTRAY)
    unexplained = factor * (factor * power - 2 * match)
    well = unexplained <= unexplained.min() + DOUBT * (torque[own] @ torque[own])
    return float(SHARES[well][np.argmin(np.abs(SHARES[well] - 1))])


def rates(window: Array) -> tuple[Array, Array]:
    """Velocity [rad/s] and acceleration [rad/s^2] of the motor's angle."""
    velocity = np.gradient(window[:, ANGLE], window[:, TIME])
    return velocity, np.asarray(np.gradient(velocity, window[:, TIME]))
