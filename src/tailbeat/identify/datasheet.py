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
from tailbeat.fish.catalogue import profiles, rad_per_s
from tailbeat.identify.servo import PRIORS
from tailbeat.identify.space import Array, Parameter

DOUBT = 0.1  # of ln(value): how far a printed torque or speed is off, chosen
UNLIKE = 0.25  # of ln(value): how far recordings contradict a datasheet, chosen


@dataclass(frozen=True)
class Datasheet:
    """`stall` torque [N m] and `no_load` speed [rad/s], at the supply of the recordings."""

    stall: float
    no_load: float

    @property
    def numbers(self) -> Mapping[str, float]:
        """The parameters of the fit that it tells, SI."""
        return {"force_limit": self.stall, "damping": self.stall / self.no_load}


# Covariance of ln(limit) and ln(damping): torque and speed err apart, and the damping by both.
ERRORS = DOUBT**2 * np.array([[1.0, 1.0], [1.0, 2.0]])
SPREADS = dict(zip(("force_limit", "damping"), np.sqrt(np.diag(ERRORS)).tolist(), strict=True))
TOLD = (*SPREADS, "kv")  # numbers of a fit that a datasheet has a say in


def datasheet(text: str) -> Datasheet:
    """From "N m,rev/min", or a servo of the catalogue at a supply, as "xl330@7.4": torque and speed
    go with the voltage. Raises BadInput for anything else, or what no fit can find."""
    given = _listed(text) if "@" in text else _typed(text)
    if given is None or not (0 < given.stall < math.inf and 0 < given.no_load < math.inf):
        raise BadInput(
            f"--datasheet {text!r}: give the stall torque [N m] and the no-load speed [rev/min], as"
            f" 4.9,75, or a servo of the catalogue with your supply [V], as xl330@7.4"
            f" ({', '.join(profiles())})."
        )
    for name, value in given.numbers.items():
        low, high, unit = PRIORS[name][2:5]
        if not low < value < high:
            raise BadInput(
                f"--datasheet {text!r}: this is a {name} of {value:.3g} {unit}; allowed is {low:g}"
                f" to {high:g}. A kg cm is 0.0981 N m, and 0.133 s for 60 deg are 75 rev/min."
            )
    return given


def _typed(text: str) -> Datasheet | None:
    try:
        stall, rpm = (float(part) for part in text.split(","))
    except ValueError:
        return None
    return Datasheet(stall, rad_per_s(rpm))


def _listed(text: str) -> Datasheet | None:
    name, _, volts = text.partition("@")
    listed = profiles().get(name.strip().lower())
    try:
        by = float(volts) / listed.voltage_v if listed else math.nan
    except ValueError:
        return None
    return Datasheet(listed.stall_nm * by, listed.no_load * by) if listed else None


def known(
    space: tuple[Parameter, ...], sheet: Datasheet, residuals: Array, count: int
) -> tuple[Parameter, ...]:
    """The free numbers with the datasheet as their prior, from the `residuals` (r,) of a fit
    without it, of which `count` are independent.

    Those of a real servo are several of their assumed deviations and would outweigh any prior; so
    its spread shrinks by as much. kv, which a firmware adds to the motor's damping, may be as large
    as that.
    """
    misfit = max(math.sqrt(float(np.square(residuals).sum()) / count), 1.0)
    found = {p.path: p for p in space}
    for name, value in sheet.numbers.items():
        found[name] = replace(found[name], prior=value, spread=SPREADS[name] / misfit)
    wide = max(found["kv"].spread, sheet.numbers["damping"])
    return tuple((found | {"kv": replace(found["kv"], spread=wide)}).values())


def prior(space: tuple[Parameter, ...], sheet: Datasheet | None) -> Array:
    """Covariance (p, p) of the prior's error in z. What a datasheet tells errs by `DOUBT`, however
    narrow the search took it, and its torque is in the damping too."""
    found = np.eye(len(space))
    if sheet is None:
        return found
    place = [[p.path for p in space].index(name) for name in SPREADS]
    spread = np.array([space[i].spread for i in place])
    found[np.ix_(place, place)] = ERRORS / np.outer(spread, spread)
    return found


def disagreements(found: Mapping[str, float], sheet: Datasheet | None) -> Sequence[str]:
    """A sentence for each number of the fit that is far from the datasheet's."""
    return [
        f"the recordings ask for {name} {found[name]:.3g} {PRIORS[name][4]}, the datasheet for"
        f" {value:.3g}: check the supply, the load's mass and arm, and the datasheet's numbers"
        for name, value in (sheet.numbers if sheet else {}).items()
        if abs(math.log(found[name] / value)) > UNLIKE
    ]
