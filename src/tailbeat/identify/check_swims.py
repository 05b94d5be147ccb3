"""Swims unlike the protocol's, to measure how far a twin is from real water (`bands.py`).

They are never fitted. Half are sums of three sines, which no beat of the protocol is; half are
beats whose frequency sweeps up and down about a centre.
"""

import numpy as np
from numpy.typing import NDArray

from tailbeat.fish.description import Fish
from tailbeat.identify.manoeuvres import BEGIN
from tailbeat.identify.protocol import RATE, ServoLimits, largest
from tailbeat.recording import Recording

Array = NDArray[np.float64]
SECONDS = 10.0
RAMP = 0.5  # s, in which a swim grows from rest


def check_swims(
    fish: Fish, limit: ServoLimits, count: int = 10, seed: int = 0
) -> dict[str, Recording]:
    """Command recordings by name, `check-01-mixed` and so on; another seed gives other swims."""
    made = {}
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        kind, swung = ("mixed", _mixed) if number % 2 == 0 else ("sweep", _sweep)
        command = swung(fish, limit, rng) * np.minimum(_time() / RAMP, 1.0)
        name = f"check-{number + 1:02d}-{kind}"
        meta = {"purpose": kind, "rate_hz": f"{RATE:g}", BEGIN: "middle"}
        made[name] = Recording(name, _time(), {"command_rad": command + limit.centre}, meta)
    return made


def _time() -> Array:
    return np.arange(int(SECONDS * RATE)) / RATE


def _mixed(fish: Fish, limit: ServoLimits, rng: np.random.Generator) -> Array:
    """Three sines between half the band's lower and its upper edge, as large as angle and speed
    allow, times 0.5 to 1."""
    omega = 2 * np.pi * rng.uniform(fish.band[0] / 2, fish.band[1], 3)
    phase, size = rng.uniform(0, 2 * np.pi, 3), rng.uniform(0.3, 1.0, 3) / omega
    turns = np.outer(_time(), omega) + phase
    angle, speed = np.sin(turns) @ size, np.cos(turns) @ (size * omega)
    scale = min(limit.angle / np.abs(angle).max(), limit.speed / np.abs(speed).max())
    return np.asarray(scale * rng.uniform(0.5, 1.0) * angle)


def _sweep(fish: Fish, limit: ServoLimits, rng: np.random.Generator) -> Array:
    """A beat that sweeps over a part of the band and back, about any centre that leaves a third of
    the range to the stroke: as tight as a policy turns."""
    first, last = rng.uniform(*fish.band, 2)
    back = 0.5 - 0.5 * np.cos(2 * np.pi * _time() / SECONDS)
    frequency = first + (last - first) * back
    centre = rng.uniform(-1, 1) * limit.angle * 2 / 3
    room = min(largest(limit, float(frequency.max())), limit.angle - abs(centre))
    stroke = rng.uniform(0.5, 1.0) * room
    return np.asarray(centre + stroke * np.sin(2 * np.pi * np.cumsum(frequency) / RATE))
