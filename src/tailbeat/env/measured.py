"""The measure of a fish from its twin: how long it is, how fast it swims, how tightly it turns."""

import math

from tailbeat.control.measure import Measure, measure
from tailbeat.files import BadInput
from tailbeat.fish.buoyancy import buoyancy
from tailbeat.fish.description import Fish, length_of
from tailbeat.fish.quick_swims import quick_swims

SLOWEST = 0.03  # lengths per second; below it a policy has nothing to steer with (chosen)


def measure_of(fish: Fish) -> Measure:
    """The measure of a fish from quick swims of its twin: best speed and tightest circle over its
    band. Raises BadInput for a fish that hardly swims or never turns."""
    length = length_of(fish)
    swims = quick_swims(fish, length)
    speeds = [one.speed for one in swims if math.isfinite(one.speed)]
    circles = [abs(one.circle) for one in swims if math.isfinite(one.circle)]
    best = max(speeds, default=0.0)
    if best < SLOWEST * length:
        raise BadInput(
            f"{fish.name}: its twin swims {best:.2g} m/s at best, {best / length:.2g} lengths a"
            f" second, and a policy needs {SLOWEST:g}; look at `tailbeat show`: a stronger servo, a"
            f" softer tail or a fin may be missing."
        )
    if not circles:
        raise BadInput(
            f"{fish.name}: its twin never turns, whatever the motor does, so it cannot be steered"
            f" to a target; look at the motor's range in the description."
        )
    return measure(length, best, min(circles), buoyancy(fish).mass)
