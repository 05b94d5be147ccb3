"""Speed of twin and plant over frequency and stroke, compared.

Above its band the stateless twin is known to be wrong; the map shows where and by how much. Open
water, a sine with a fade-in of one second, the command held at 50 Hz.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tailbeat.fish.description import Fish
from tailbeat.fish.rollout import Start, swim
from tailbeat.fish.store import load_fish, with_servo
from tailbeat.fish.twin import compile_twin
from tailbeat.pool.plant import at_rest, build_plant, step_plant
from tailbeat.pool.water import Water, fingerprint

Array = NDArray[np.float64]
FREQUENCIES = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 12.0)  # Hz
SHAFT_SPEEDS = (3.0, 6.0, 9.0)  # rad/s, commanded: stroke times angular frequency
SECONDS, JUDGED = 12.0, 4.0


@dataclass(frozen=True)
class SpeedRow:
    """One beat: the `servo`, the shaft's largest commanded speed [rad/s], frequency [Hz] and stroke
    [rad]; speeds [m/s] of `plant` and `twin`, negative backwards, None where the twin diverged."""

    servo: str
    shaft_speed: float
    frequency: float
    stroke: float
    plant: float
    twin: float | None


@dataclass(frozen=True)
class SpeedMap:
    """Speeds of a fish (name) in a water (fingerprint)."""

    fish: str
    water: str
    rows: tuple[SpeedRow, ...]


def speed_map(
    fish: Fish, servos: Sequence[str] = ("identified",), twin: Fish | None = None
) -> SpeedMap:
    """Compute speeds of `twin` (by default the fish's own) and of the pool's plant at every beat.
    `servos` are the twin's; a servo that the fish does not have is its own in the plant."""
    cases = [
        (servo, rate, frequency, min(rate / (2 * np.pi * frequency), 1.0))
        for servo in servos
        for rate in SHAFT_SPEEDS
        for frequency in FREQUENCIES
    ]
    speeds = zip(_plant_speeds(fish, cases), _twin_speeds(twin or fish, cases), strict=True)
    rows = [SpeedRow(*case, *pair) for case, pair in zip(cases, speeds, strict=True)]
    return SpeedMap(fish.name, fingerprint([Water()]), tuple(rows))


def speed_map_of(fish: str, servos: Sequence[str] = ()) -> SpeedMap:
    """Compute speeds of a fish with some of its servos, by default the described one. Raises
    BadInput."""
    described = load_fish(fish)
    chosen = [with_servo(described, name).servo for name in servos or [described.servo]]
    return speed_map(described, chosen)


def _command(frequency: float, stroke: float, step: float) -> Array:
    held = np.floor(np.arange(round(SECONDS / step)) * step * 50 + 1e-9) / 50
    sine = np.sin(2 * np.pi * frequency * held)
    return np.asarray(stroke * np.minimum(held, 1.0) * sine)


def _speed(time: Array, pose: Array) -> float:
    """Net speed along the mean heading over the last seconds [m/s]."""
    late = time >= time[-1] - JUDGED
    way = pose[-1, :2] - pose[late][0, :2]
    heading = pose[late, 2].mean()
    return float(way @ [np.cos(heading), np.sin(heading)]) / JUDGED


def _plant_speeds(fish: Fish, cases: Sequence[tuple[str, float, float, float]]) -> list[float]:
    dt = 0.001
    servos = [fish.servos.get(servo, fish.servos[fish.servo]) for servo, *_ in cases]
    plant = build_plant(fish, [Water()], servos, dt=dt)
    commands = np.stack([_command(frequency, stroke, dt) for *_, frequency, stroke in cases])
    swum = step_plant(plant, at_rest(plant), commands, 20)
    return [_speed(swum.time, pose) for pose in swum.q[:, :, :3]]


def _twin_speeds(
    fish: Fish, cases: Sequence[tuple[str, float, float, float]]
) -> list[float | None]:
    calm = fish.simulation.model_copy(update={"step": 0.001})
    found: list[float | None] = []
    for servo in dict.fromkeys(name for name, *_ in cases):
        own = [case for case in cases if case[0] == servo]
        twin = compile_twin(fish.model_copy(update={"servo": servo, "simulation": calm}))
        commands = [_command(frequency, stroke, 0.001) for *_, frequency, stroke in own]
        done = swim([twin] * len(own), [Start.at_rest()] * len(own), commands, 20)
        speeds = [_speed(swum.time, swum.qpos[:, :3]) for swum in done]
        lost = [swum.diverged for swum in done]
        found += [None if gone else v for v, gone in zip(speeds, lost, strict=True)]
    return found
