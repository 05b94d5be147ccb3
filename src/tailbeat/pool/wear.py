"""How one built fish differs from its description: wear, assembly and a tired servo.

All numbers are constant over a swim, except the servo's fading. `mess.py` has everyday sizes.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from tailbeat.files import BadInput
from tailbeat.pool.chain import Chain, fin_factors
from tailbeat.pool.compiled import compiled

Rows = NDArray[np.void]


@dataclass(frozen=True)
class Wear:
    """Differences of one fish; factors are relative to its description.

    Angles are positive where they bend the tail tip to the left. `bend` is the sum over all hinges
    at which the loose tail rests. `slack` is the turn of the shaft, to either side, that pulls no
    tendon: slack tendons and backlash of the gears. Friction in the hinges can hold the loose tail
    bent by `sticking`: hysteresis of plastic.
    """

    bend: float = 0.0  # rad
    slack: float = 0.0  # rad at the shaft
    sticking: float = 0.0  # rad, over all hinges
    stiffness: float = 1.0  # factor, of all hinges
    damping: float = 1.0  # factor, of all hinges
    mass: float = 1.0  # factor, of mass and inertia of all bodies
    centre: float = 0.0  # m, by which the head's centre of mass is ahead
    fin: float = 1.0  # factor, on the height of all fins
    gain: float = 1.0  # factor, of the servo's gains kp and kv
    limit: float = 1.0  # factor, of the servo's largest torque
    delay: float = 0.0  # s, added to the servo's delay
    friction: float = 0.0  # N m, added at the shaft
    fade: float = 0.0  # fraction of gain and limit that heat and supply take (`dynamics.fading`)


NAMES = tuple(field.name for field in fields(Wear))
ROW = np.dtype([(name, float) for name in NAMES])
FACTORS = ("stiffness", "damping", "mass", "fin", "gain", "limit")


def check(wear: Wear) -> None:
    """Raises BadInput for a factor of 0 or less, a negative slack, sticking, friction or delay, or
    a fade of 1 or more."""
    for name in NAMES:
        value = float(getattr(wear, name))
        low = -np.inf if name in ("bend", "centre") else 0.0
        bad = value <= 0 if name in FACTORS else value < low
        if bad or not np.isfinite(value) or (name == "fade" and value >= 1):
            allowed = "above 0" if name in FACTORS else "0 or more"
            allowed = "0 to below 1" if name == "fade" else allowed
            allowed = "a finite number" if np.isinf(low) else allowed
            raise BadInput(f"wear: {name} = {value:g}; allowed is {allowed}.")


def rows(each: Sequence[Wear]) -> Rows:
    """Rows (n,) of `ROW`. Raises BadInput."""
    for wear in set(each):
        check(wear)
    return np.array([tuple(getattr(wear, name) for name in NAMES) for wear in each], ROW)


def worn(chain: Chain, wear: Rows) -> Chain:
    """n chains (every array with a leading axis n) of one description with their own wear (n,)."""
    n = len(wear)
    own = Chain._make(np.repeat(np.asarray(values)[None], n, axis=0) for values in chain)
    links, each = own.hinges.shape[1], wear[:, None]
    own.bodies["mass"] *= each["mass"]
    own.bodies["inertia"] *= each["mass"]
    own.bodies["centre"][:, 0] += wear["centre"]
    own.hinges["stiffness"] *= each["stiffness"]
    own.hinges["damping"] *= each["damping"]
    own.hinges["rest"] += each["bend"] / links
    own.hinges["dry"] += own.hinges["stiffness"] * each["sticking"] / links
    own.tendon["slack"] += own.motor["radius"] * each["slack"]
    _fins(own.fins, each["fin"])
    return own


@compiled
def alone(i, chains):  # type: ignore[no-untyped-def]
    """Chain of fish i of n."""
    return Chain(
        chains.bodies[i],
        chains.strips[i],
        chains.fins[i],
        chains.hinges[i],
        chains.guides[i],
        chains.motor[i],
        chains.tendon[i],
        chains.neutral[i],
        chains.nose[i],
        chains.rear[i],
    )


def _fins(fins: Rows, factor: NDArray[np.float64]) -> None:
    """Other heights of the fins (n, f), and what follows from the aspect ratio."""
    fins["height"] *= factor
    for name, value in zip(
        ("slope", "heave", "pitch"), fin_factors(fins["chord"], fins["height"]), strict=True
    ):
        fins[name] = value


def worn_servos(servo: Rows, wear: Rows) -> Rows:
    """Servos (n,) with their own wear (n,)."""
    own = servo.copy()
    own["kp"] *= wear["gain"]
    own["kv"] *= wear["gain"]
    own["force_limit"] *= wear["limit"]
    own["delay"] += wear["delay"]
    own["friction"] += wear["friction"]
    own["fade"] = wear["fade"]
    return own
