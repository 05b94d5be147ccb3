"""A fish's action space by its name."""

from dataclasses import replace
from typing import Literal

import numpy as np

from tailbeat.control.actions import ActionSpace, Direct, Filtered, Turning, generator
from tailbeat.files import BadInput
from tailbeat.fish.description import Fish

ACTIONS = ("generator", "direct", "filtered", "turning")


def action_space(
    kind: str | None,
    fish: Fish,
    binds: str = "fundamental",
    floor: float = 0.0,
    centre: float | None = None,
) -> ActionSpace:
    """A fish's action space by name; None is the motor's own: the generator of a pulley, turning of
    a crank. The ceiling is the band's upper edge; `binds` is what stays below it, fundamental or
    signal; `floor` [Hz] is the lowest fundamental; `centre` [rad] the largest centre, None for that
    of the paper's fish in proportion to the range. Raises BadInput."""
    crank = fish.motor.range is None
    kind = kind or ("turning" if crank else "generator")
    allowed = ACTIONS[3:] if crank else ACTIONS[:3]
    if kind not in allowed:
        raise BadInput(
            f"--actions {kind}: {fish.name}'s motor is a {fish.motor.kind}; allowed are"
            f" {', '.join(allowed)}."
        )
    if floor and kind not in ("generator", "turning"):
        raise BadInput(f"--floor {floor:g}: {kind} actions have no floor; omit it.")
    if centre is not None and not (kind == "generator" and 0 < centre <= np.pi):
        raise BadInput(f"--centre {centre:g}: above 0 to 3.14 rad, and only of generator actions.")
    if kind == "turning":
        return Turning(fish.band[1], floor)
    low, high = fish.motor.range or (-np.pi, np.pi)
    if kind == "direct":
        return Direct(low, high)
    if kind == "filtered":
        return Filtered(low, high)
    if binds not in ("fundamental", "signal"):
        raise BadInput(f"--binds {binds}: allowed are fundamental, signal.")
    bound: Literal["fundamental", "signal"] = "signal" if binds == "signal" else "fundamental"
    found = generator(low, high, fish.band[1], bound, floor)
    return found if centre is None else replace(found, offset=centre)
