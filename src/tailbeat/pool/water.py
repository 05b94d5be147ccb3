"""Parameters of the pool's water: textbook values, their sources, an ensemble around them,
ablations.

Nothing here was fitted to the twin or to a result. [R] marks a textbook value that was quoted from
memory and not checked in its source.
"""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Wagner lag (A, b) pairs of R. T. Jones (NACA TR 681) [R]: section, aspect ratio 6, aspect ratio 3.
LAGS: dict[str, tuple[float, float, float, float]] = {
    "section": (0.165, 0.0455, 0.335, 0.300),
    # Own least squares fit to the exact C(k), 0.05 < k < 20, for comparison with linear theory.
    "section, fitted": (0.2478, 0.0746, 0.2522, 0.3859),
    "aspect 6": (0.361, 0.381, 0.0, 0.0),
    "aspect 3": (0.283, 0.540, 0.0, 0.0),
}


@dataclass(frozen=True)
class Water:
    """Parameters of the unsteady strip model; equations in `section.py` and `hydrodynamics.py`.

    Lengths are scaled by the fish; numbers without a unit are dimensionless.
    """

    density: float = 1000.0  # kg/m^3, fresh water
    lag: str = "aspect 3"  # lag of the fin's circulation, aspect ratio 1.2-2.5
    suction: float = 0.6  # eta: 0.9 rounded foil, 0-0.6 thin sharp plate (upper end)
    vortex: float = 1.0  # K_v, Polhamus: lost suction becomes normal force
    fin_drag: float = 1.25  # C_n of a plate of aspect ratio 1.5 across the flow [R]
    fin_friction: float = 0.03  # C_d0, plate of Re 1e4 with its edges [R: 0.02-0.05]
    body_friction: float = 0.05  # C_f with form drag, on 2.2 h dx [R: 0.03-0.08]
    body_drag: float = 1.5  # C_n of body sections across the flow [R: 1.0-2.0]
    along: float = 0.04  # added mass along a strip over that across it [R: 0.03-0.05]
    added_mass: float = 1.0  # scale of all added mass
    lag_pressure: float = 1.7  # T_p, semichords: Leishman-Beddoes, NACA0012 [R]
    lag_separation: float = 3.0  # T_f, semichords: the same
    stall_angle: float = 10.0  # deg: above it, the separation point leaves the trailing edge
    stall_before: float = 3.0  # S_1, deg
    stall_after: float = 2.5  # S_2, deg
    edge_vortices: float = 0.0  # Keulegan-Carpenter term: unvalidated at Re 2e4, a variant only
    with_lag: bool = True  # ablations
    with_stall: bool = True
    with_added_inertia: bool = True


LAG_NAMES = ("a1", "b1", "a2", "b2")
NAMES = (*(f.name for f in fields(Water) if f.name != "lag"), *LAG_NAMES)
ROW = np.dtype([(name, float) for name in NAMES])  # a water as the compiled code takes it

# Values of every number in the ensemble.
ENSEMBLE: dict[str, tuple[float | str, ...]] = {
    "suction": (0.0, 0.3, 0.6, 0.9),
    "body_friction": (0.03, 0.05, 0.08),
    "added_mass": (0.8, 1.0, 1.2),
    "lag": ("section", "aspect 6", "aspect 3"),
    "body_drag": (1.0, 1.5, 2.0),
    "edge_vortices": (0.0, 1.0),
}
STALL_SCALES = (0.5, 1.0, 2.0)  # of both separation times


def ensemble(count: int, seed: int) -> list[Water]:
    """Plausible pools: every number is drawn from its values; the first pool is the default."""
    rng = np.random.default_rng(seed)
    pools = [Water()]
    for _ in range(count - 1):
        drawn: dict[str, Any] = {
            name: options[rng.integers(len(options))] for name, options in ENSEMBLE.items()
        }
        slow = STALL_SCALES[rng.integers(len(STALL_SCALES))]
        pools.append(
            replace(
                Water(),
                **drawn,
                lag_pressure=slow * Water.lag_pressure,
                lag_separation=slow * Water.lag_separation,
            )
        )
    return pools


def ablations() -> dict[str, Water]:
    """The full water, and the water without one piece of physics at a time."""
    return {
        "full": Water(),
        "no lag": replace(Water(), with_lag=False),
        "no stall": replace(Water(), with_stall=False),
        "no added inertia": replace(Water(), with_added_inertia=False),
    }


def fingerprint(pools: Sequence[Water] = ()) -> str:
    """Hash of the parameters (of the default water, its ensemble and lags if none are given)."""
    default: list[object] = [asdict(Water()), ENSEMBLE, STALL_SCALES, LAGS]
    what = list(map(asdict, pools)) or default
    return hashlib.sha256(json.dumps(what, sort_keys=True).encode()).hexdigest()[:12]


def rows(pools: Sequence[Water]) -> NDArray[np.void]:
    """Waters as rows (n,) of `ROW`."""
    return np.array([_row(pool) for pool in pools], dtype=ROW)


def _row(pool: Water) -> tuple[float, ...]:
    values = {**asdict(pool), **dict(zip(LAG_NAMES, LAGS[pool.lag], strict=True))}
    return tuple(float(values[name]) for name in NAMES)
