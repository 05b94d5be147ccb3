"""How far a fish's step and integrator are from a fine step, at the largest commands there are.

A full stroke at the band's top, at its middle and at its foot, from rest, to both sides: more than
the generator commands in water, for the servo saturates. A crank turns steadily at these beats.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tailbeat.fish.description import Fish, Simulation
from tailbeat.fish.rollout import Start, replay_command, swim
from tailbeat.fish.twin import Options, compile_twin

Array = NDArray[np.float64]
OURS = "chosen by a convergence run"  # begins the source of a step that no user chose
FINE = Simulation(step=2.5e-4, integrator="Euler")
SECONDS = 4.0
SAMPLE = 0.02  # s
SHARES = (0.0, 0.5, 1.0)  # of the band
ALLOWED = 0.05  # of the way swum, chosen: what a twin errs anyway; shorter steps train longer
WORTH = 2.0  # a shorter step that errs above `ALLOWED` must err so many times less (chosen)
# From the cheapest on. Every step divides the robot's period of 20 ms.
CHOICES = tuple(
    Simulation(step=step, integrator=integrator)
    for step, integrator in (
        (4e-3, "Euler"), (4e-3, "implicit"), (2e-3, "Euler"), (2e-3, "implicit"), (1e-3, "Euler"),
        (1e-3, "implicit"), (5e-4, "Euler"),
    )
)  # fmt: skip


@dataclass(frozen=True)
class Deviation:
    """How far a step errs: the largest distance between its tag and the fine step's, over the way
    that the fish swam. `error` is infinite where a swim diverged."""

    simulation: Simulation
    error: float


def deviation(fish: Fish, simulation: Simulation | None = None) -> Deviation:
    """How far a step errs (the description's own by default)."""
    own = simulation or fish.simulation
    return Deviation(own, _error(swims(fish, own), swims(fish, FINE)))


def choose(fish: Fish, choices: Sequence[Simulation] = CHOICES) -> Deviation:
    """The cheapest of `choices` that errs by less than `ALLOWED`; if none does, the cheapest that
    errs at most `WORTH` times as much as the best.

    A fish whose guides meet (`linkage.free_bends`) errs at any step. A shorter one then costs much
    and gains little.
    """
    fine, found = swims(fish, FINE), []
    for simulation in choices:
        found.append(Deviation(simulation, _error(swims(fish, simulation), fine)))
        if found[-1].error < ALLOWED:
            return found[-1]
    best = min(found, key=lambda one: one.error)
    return next(one for one in found if one.error <= WORTH * best.error)


def swims(fish: Fish, simulation: Simulation) -> list[Array | None]:
    """Poses (k, 3) of the head at every 20 ms of each swim; None where it diverged."""
    described = fish.model_copy(update={"simulation": simulation})
    crank = fish.motor.kind == "crank"
    twin = compile_twin(described, Options(replayed=crank))
    angles = [_turning(described, s) if crank else _beat(described, s) for s in SHARES]
    starts = [Start(np.zeros(3), np.zeros(3), 0.0, _first_speed(a, simulation)) for a in angles]
    commands = [replay_command(twin, a) for a in angles] if crank else angles
    begin = starts if crank else [Start.at_rest()] * len(SHARES)
    done = swim([twin] * len(SHARES), begin, commands, round(SAMPLE / simulation.step))
    return [None if one.diverged else one.qpos[:, :3] for one in done]


def _frequency(fish: Fish, share: float) -> float:
    """A beat within the band: its foot at 0, its top at 1 [Hz]."""
    low, top = fish.band
    return float(max(low, 0.2) ** (1 - share) * top**share)


def _times(fish: Fish) -> Array:
    step = fish.simulation.step
    return np.asarray(np.arange(round(SECONDS / step)) * step, dtype=np.float64)


def _beat(fish: Fish, share: float) -> Array:
    """A sine of the whole range, held for 20 ms as the robot's loop commands it."""
    low, high = fish.motor.range or (-np.pi, np.pi)
    held = np.floor(_times(fish) / SAMPLE + 1e-9) * SAMPLE
    wave = np.sin(2 * np.pi * _frequency(fish, share) * held)
    return np.asarray((low + high) / 2 + (high - low) / 2 * wave)


def _turning(fish: Fish, share: float) -> Array:
    """The angles of a crank that turns steadily."""
    return np.asarray(2 * np.pi * _frequency(fish, share) * _times(fish))


def _first_speed(angle: Array, simulation: Simulation) -> float:
    return float((angle[1] - angle[0]) / simulation.step)


def _error(found: Sequence[Array | None], fine: Sequence[Array | None]) -> float:
    return max(_apart(one, other) for one, other in zip(found, fine, strict=True))


def _apart(found: Array | None, fine: Array | None) -> float:
    if found is None or fine is None:
        return float("inf")
    way = sum(float(np.hypot(*(b - a)[:2])) for a, b in pairwise(fine))
    return float(np.hypot(*(found - fine)[:, :2].T).max() / max(way, 1e-9))
