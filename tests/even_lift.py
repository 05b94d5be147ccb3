"""A fish driven by the Kutta lift of its fin.

With the engine's even lift, and launched backward, it stays backward.
"""

from tailbeat.fish.description import COEFFICIENTS, Fish
from tailbeat.fish.store import load_fish, with_values

# Identified for the pulley fish on 23 November 2026, when Kutta lift led.
ZONES = {
    "head": (0.075, 0.005, 1.2, 3.3, 2.7),
    "tail": (0.08, 0.01, 1.4, 6.3, 0.17),
    "fin": (0.47, 0.06, 12.0, 2.5, 7.9),
}


def kutta_led(even: bool) -> Fish:
    """The fish with the whole law, or with `even` lift."""
    found = {
        f"zones.{zone}.{name}": value
        for zone, row in ZONES.items()
        for name, value in zip(COEFFICIENTS, row, strict=True)
    }
    fish = with_values(load_fish("pulley-fish-pool"), {**found, "added_along": 0.0})
    return fish.model_copy(update={"trailing_edge": None}) if even else fish
