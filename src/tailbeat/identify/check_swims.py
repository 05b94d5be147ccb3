"""Swims to measure how far a twin is from real water (`bands.py`). They are never fitted.

They wander as policies do: frequency, stroke and centre change about every second, as fast as the
servo can. A twin errs more on such swims than on steady ones: with sums of sines and slow sweeps,
which were taken before, bands were too narrow for a policy's swims
(docs/experiments/2026-11-what-swims-tell.md).
"""

import numpy as np
from numpy.typing import NDArray

from tailbeat.fish.description import Fish
from tailbeat.identify.manoeuvres import BEGIN, FULL, fast, wandering
from tailbeat.identify.protocol import RATE, ServoLimits
from tailbeat.recording import Recording

Array = NDArray[np.float64]
SECONDS = 10.0
RAMP = 0.5  # s, in which a swim grows from rest


def check_swims(
    fish: Fish, limit: ServoLimits, count: int = 10, seed: int = 0
) -> dict[str, Recording]:
    """Command recordings by name, `check-01-wander` and so on; another seed gives other swims."""
    time, made = np.arange(int(SECONDS * RATE)) / RATE, {}
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        command = wandering(fast(limit, FULL), (0.0, fish.band[1]), SECONDS, rng)[: time.size]
        inside = np.clip(command, -limit.angle, limit.angle) * np.minimum(time / RAMP, 1.0)
        name = f"check-{number + 1:02d}-wander"
        meta = {"purpose": "wander", "rate_hz": f"{RATE:g}", BEGIN: "middle"}
        made[name] = Recording(name, time, {"command_rad": inside + limit.centre}, meta)
    return made
