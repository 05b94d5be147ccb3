"""What is constant and wrong on one robot, and known: corrected between its sensors and its policy.

`tailbeat refine` writes these into a policy's contract; the policy's network stays as it is. The
robot's log keeps the readings as they came. Needs only numpy.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
TURNED, AWAY, FAST = math.radians(60), 0.3, 1.5  # rad, m, rad/s: a lab errs by less (chosen)


@dataclass(frozen=True)
class Corrections:
    """Errors of one robot, of which its readings and setpoints are freed.

    Signs are those of `env.errors.Errors`: turns counter-clockwise and to the left are positive.
    """

    askew: float = 0.0
    """Angle at which the tag is glued [rad]; subtracted from headings."""
    left: float = 0.0
    """How far left of the midline the tag is [m]; positions are those of a tag that is on it."""
    shaft: float = 0.0
    """Angle that the servo counts when the fish goes straight [rad]; subtracted from angles."""
    setpoint: float = 0.0
    """Setpoint with which the fish goes straight [rad]; added to setpoints."""
    yaw_rate: float = 0.0
    """Bias of the gyro [rad/s]; subtracted from its rates, not from the camera's."""
    parent: str = ""
    """Digest of the contract of the policy that was corrected."""


LARGEST = {"askew": TURNED, "left": AWAY, "shaft": TURNED, "setpoint": TURNED, "yaw_rate": FAST}


def from_contract(held: Any) -> Corrections | None:
    """The corrections in a contract; None where there are none. Raises TypeError or ValueError."""
    if held is None:
        return None
    found, names = Corrections(**held), [one.name for one in fields(Corrections)]
    if set(held) != set(names) or not isinstance(found.parent, str):
        raise ValueError(f"corrections {held}")
    check(found)
    return found


def check(corrections: Corrections) -> None:
    """Raises ValueError for a correction that is larger than what a lab gets wrong."""
    for name, most in LARGEST.items():
        value = getattr(corrections, name)
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= most:
            raise ValueError(f"correction {name} = {value!r}; allowed is {-most:.3g} to {most:.3g}")


def stacked(each: Sequence[Corrections]) -> Corrections:
    """The corrections of n robots as one record of arrays (n,), for a batch of them."""
    names = [one.name for one in fields(Corrections) if one.name != "parent"]
    arrays: dict[str, Any] = {k: np.array([getattr(one, k) for one in each]) for k in names}
    return Corrections(**arrays)


def zero(corrections: Corrections | None) -> float:
    """Setpoint [rad] with which a robot goes straight, as far as it is known."""
    return 0.0 if corrections is None else corrections.setpoint


def corrected_frames(corrections: Corrections, frames: Array) -> Array:
    """Frames (n, k, 6), see `observation.Samples`, of a tag that is straight and on the midline."""
    found = np.array(frames, dtype=np.float64)
    askew, left = (np.reshape(one, (-1, 1)) for one in (corrections.askew, corrections.left))
    yaw = found[..., 2] - askew  # of one robot, or of each in a batch
    found[..., 0] += left * np.sin(yaw)
    found[..., 1] -= left * np.cos(yaw)
    found[..., 2] = yaw
    return found
