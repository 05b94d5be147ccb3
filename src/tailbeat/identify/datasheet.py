"""What a servo's datasheet says of torque and speed, as a prior of its fit.

Below the force limit only the sum of kv and damping shows, and the limit not at all. So slow
recordings leave open how the servo swings fast. Stall torque and no-load speed decide both: a
geared DC motor has the damping stall / no-load speed, outside the limit (`fish/catalogue.py`).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tailbeat.files import BadInput
from tailbeat.fish.catalogue import profiles
from tailbeat.identify.space import Array, Parameter

DOUBT = 0.1  # of ln(value): how far a datasheet is off, chosen
UNLIKE = 0.25  # share by which recordings contradict a datasheet, chosen
RPM = 2 * math.pi / 60  # rad/s


@dataclass(frozen=True)
class Datasheet:
    """`stall` torque [N m] and `no_load` speed [rad/s], at the supply of the recordings."""

    stall: float
    no_load: float

    @property
    def numbers(self) -> Mapping[str, float]:
        """The parameters of the fit that it tells, SI."""
        return {"force_limit": self.stall, "damping": self.stall / self.no_load}


def datasheet(text: str) -> Datasheet:
    """From a name in the catalogue, or "N m,rev/min". Raises BadInput for anything else."""
    known = profiles().get(text.strip().lower())
    if known is not None:
        return Datasheet(known.stall_nm, known.no_load)
    try:
        stall, rpm = (float(part) for part in text.split(","))
    except ValueError:
        stall = rpm = math.nan
    if not (0 < stall < math.inf and 0 < rpm < math.inf):
        raise BadInput(
            f"--datasheet {text!r}: give the stall torque [N m] and the no-load speed [rev/min], as"
            f" 4.9,75, or a servo of the catalogue ({', '.join(profiles())})."
        )
    return Datasheet(stall, rpm * RPM)


def known(
    space: tuple[Parameter, ...], sheet: Datasheet, residuals: Array, count: int
) -> tuple[Parameter, ...]:
    """The free numbers with the datasheet as their prior, from the `residuals` (r,) of a fit
    without it, of which `count` are independent.

    Those of a real servo are several of their assumed deviations and would outweigh any prior; so
    its spread shrinks by as much.
    """
    misfit = math.sqrt(float(np.square(residuals).sum()) / count)
    return told(space, sheet, max(misfit, 1.0))


def told(
    space: tuple[Parameter, ...], sheet: Datasheet, misfit: float = 1.0
) -> tuple[Parameter, ...]:
    """The free numbers with the datasheet as their prior, as far as it tells them. kv, which a
    firmware adds to the motor's damping, may then be as large as that."""
    numbers, spread = sheet.numbers, DOUBT / misfit
    found = {p.path: p for p in space}
    for name, value in numbers.items():
        found[name] = replace(found[name], prior=value, spread=spread)
    found["kv"] = replace(found["kv"], spread=max(found["kv"].spread, numbers["damping"]))
    return tuple(found.values())


def deviations(space: tuple[Parameter, ...], sheet: Datasheet | None) -> Array:
    """Standard deviation (p,) of the prior in z: 1, but of what a datasheet tells its doubt."""
    numbers = sheet.numbers if sheet else {}
    return np.array([DOUBT / p.spread if p.path in numbers else 1.0 for p in space])


def disagreements(found: Mapping[str, float], sheet: Datasheet | None) -> Sequence[str]:
    """A sentence for each number of the fit that is far from the datasheet's."""
    units = {"force_limit": "N m", "damping": "N m s/rad"}
    return [
        f"the recordings ask for {name} {found[name]:.3g} {units[name]}, the datasheet for"
        f" {value:.3g}: check the supply, the load's mass and arm, and the datasheet's numbers"
        for name, value in (sheet.numbers if sheet else {}).items()
        if not 1 / (1 + UNLIKE) < found[name] / value < 1 + UNLIKE
    ]
