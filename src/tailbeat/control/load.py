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
LEAST = 0.1  # of the torque limit: rms over a window of a pull that can be compared (chosen)
STRAINED = 0.15  # of the torque limit: rms of a torque that says which setpoints were obeyed
# Of what a tendon should pull: 0.45 was the least in 24 everyday minutes, and cut ones have 0.2.
PULL = 0.25
# The same of a tendon that holds a bend, where friction and a tail that stays bent pull too: 0.44
# was the least in 48 everyday labs, and 0.37 the most of cut ones.
HELD_PULL = 0.4
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
    motor lead to; NaN where a tendon has little to pull. A slack one's is near 0."""
    velocity, acceleration = rates(window)
    tail = (max(shaft.inertia - motor.inertia, 0.0), max(shaft.damping - motor.damping, 0.0))
    wanted = tail[0] * acceleration + tail[1] * velocity + shaft.stiffness * window[:, ANGLE]
    seen = motor.per_ampere * window[:, CURRENT] - motor.inertia * acceleration
    least = len(window) * (LEAST * shaft.force_limit) ** 2
    return _pull(seen, np.maximum(wanted, 0.0), least), _pull(seen, np.minimum(wanted, 0.0), least)


def held_pull(window: Array, shaft: ShaftModel, motor: Motor) -> float:
    """The same of the tendon that holds the tail bent, over a window at rest."""
    wanted = shaft.stiffness * window[:, ANGLE]
    least = len(window) * (LEAST * shaft.force_limit) ** 2
    return _pull(motor.per_ampere * window[:, CURRENT], wanted, least)


def _pull(seen: Array, wanted: Array, least: float) -> float:
    """Least-squares factor of a pull (k,) [N m] where it acts; NaN if its power is below `least`,
    or if a torque is not known."""
    power = float(wanted @ wanted)
    return float(seen @ wanted) / power if power > least else float("nan")


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
