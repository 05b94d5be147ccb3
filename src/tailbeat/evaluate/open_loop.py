"""A fish that swims open-loop, without a policy."""

from dataclasses import dataclass

import numpy as np

from tailbeat.fish.description import Fish
from tailbeat.fish.rollout import Start, Swim, replay_command, swim
from tailbeat.fish.twin import Options, Twin, compile_twin

SECONDS = 8.0


def beat(fish: Fish, frequency: float) -> tuple[Swim, Twin]:
    """Swim from rest: a pulley swings by 0.6 rad through its servo, a crank turns steadily."""
    crank = fish.motor.kind == "crank"
    twin = compile_twin(fish, Options(replayed=crank, looks=True))
    step = twin.model.opt.timestep
    phase = 2 * np.pi * frequency * np.arange(0, SECONDS + step, step)
    if crank:
        start = Start(np.zeros(3), np.zeros(3), 0.0, 2 * np.pi * frequency)
        return swim([twin], [start], [replay_command(twin, phase)], round(0.02 / step))[0], twin
    command = 0.6 * np.sin(phase)
    return swim([twin], [Start.at_rest()], [command], max(round(0.02 / step), 1))[0], twin


@dataclass(frozen=True)
class OpenLoop:
    """An open-loop swim: its time [s], distance from the start [m], and speed over the last half
    [m/s]."""

    seconds: float
    distance_m: float
    speed_m_s: float


def summary(done: Swim) -> OpenLoop:
    """How far the fish got, and how fast."""
    half = done.time.size // 2
    path = done.qpos[half:, :2]
    return OpenLoop(
        seconds=float(done.time[-1]),
        distance_m=float(np.linalg.norm(done.qpos[-1, :2] - done.qpos[0, :2])),
        speed_m_s=float(np.linalg.norm(path[-1] - path[0]) / (done.time[-1] - done.time[half])),
    )
