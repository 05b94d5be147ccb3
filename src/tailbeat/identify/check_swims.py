"""Swims to measure how far a twin is from real water (`bands.py`). They are never fitted.

Most wander as policies do: frequency, stroke and centre change about every second, as fast as the
servo can, and a centre may be so far aside that half of each stroke is cut off. A twin errs more on
such swims than on steady ones: with sums of sines and slow sweeps, which were taken before, bands
were too narrow for a policy's swims. In other water than the twin's own it may err more on steady
beats, so there are some of these too (docs/experiments/2026-11-what-swims-tell.md).
"""

import numpy as np
from numpy.typing import NDArray

from tailbeat.fish.description import Fish
from tailbeat.identify.manoeuvres import BEGIN, FULL, Beat, fast, played, wandering
from tailbeat.identify.protocol import RATE, ServoLimits
from tailbeat.recording import Recording

Array = NDArray[np.float64]
SECONDS = 10.0
RAMP = 0.5  # s, in which a swim grows from rest
WANDER, STEADY = 10, 5  # swims of each kind
ASIDE = 0.3  # rad: largest centre of a steady beat, so that some turn


def check_swims(fish: Fish, limit: ServoLimits, seed: int = 0) -> dict[str, Recording]:
    """Command recordings by name, `check-01-wander` to `check-15-steady`; another seed gives other
    swims."""
    made = {}
    for number in range(WANDER + STEADY):
        rng = np.random.default_rng([seed, number])
        if number < WANDER:
            kind, begin = "wander", "middle"
            command = wandering(fast(limit, FULL), (0.0, fish.band[1]), SECONDS, rng)
        else:
            kind, begin = "steady", "end"
            command = played(limit, [_beat(fish, rng, number - WANDER)])[0]
        name = f"check-{number + 1:02d}-{kind}"
        meta = {"purpose": kind, "rate_hz": f"{RATE:g}", BEGIN: begin}
        made[name] = _from_rest(name, command, limit, meta)
    return made


def _beat(fish: Fish, rng: np.random.Generator, number: int) -> Beat:
    """One steady beat: each swim has a part of the band, on a logarithmic scale."""
    low, high = fish.band
    frequency = low * (high / low) ** ((number + rng.uniform()) / STEADY)
    return Beat(SECONDS, frequency, rng.uniform(0.5, 1.0), ASIDE * rng.uniform(-1, 1))


def _from_rest(name: str, command: Array, limit: ServoLimits, meta: dict[str, str]) -> Recording:
    time = np.arange(int(SECONDS * RATE)) / RATE
    inside = np.clip(command[: time.size], -limit.angle, limit.angle)
    grown = inside * np.minimum(time / RAMP, 1.0) + limit.centre
    return Recording(name, time, {"command_rad": grown}, meta)
