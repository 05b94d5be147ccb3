"""Quick swims of a described fish: how fast, with which Strouhal number, in how tight a circle."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tailbeat.fish.convergence import SAMPLE
from tailbeat.fish.description import Fish
from tailbeat.fish.outline import outline
from tailbeat.fish.rollout import Start, Swim, swim
from tailbeat.fish.twin import compile_twin

Array = NDArray[np.float64]
SECONDS, SETTLED = 12.0, 6.0  # s of a swim, and from when on it is measured
TURN = 0.5  # of the range: centre of the beat in a turn
SLOW = 0.05  # lengths per second


@dataclass(frozen=True)
class Quick:
    """A quick swim at a beat [Hz]: speed [m/s], peak-to-peak excursion of the tail's tip [m],
    Strouhal and Reynolds number; radius of the circle when the beat is centred at half the range
    [m], negative to the right, infinite if it does not turn. NaN where the swim diverged."""

    frequency: float
    speed: float
    excursion: float
    strouhal: float
    reynolds: float
    circle: float


def quick_swims(fish: Fish, length: float) -> tuple[Quick, ...]:
    """Three beats over the band at full stroke, straight and turning, in one batch."""
    beats = np.geomspace(max(fish.band[0], 0.2), fish.band[1], 3).tolist()
    twin = compile_twin(fish)
    commands = [_command(fish, beat, turn) for turn in (0.0, TURN) for beat in beats]
    every = max(round(SAMPLE / fish.simulation.step), 1)
    done = swim([twin] * len(commands), [Start.at_rest()] * len(commands), commands, every)
    pairs = zip(beats, done[:3], done[3:], strict=True)
    return tuple(_quick(fish, length, beat, along, turn) for beat, along, turn in pairs)


def _command(fish: Fish, beat: float, turn: float) -> Array:
    """A beat about a centre (share of the half range), within the range."""
    low, high = fish.motor.range or (-math.pi, math.pi)
    half, step = (high - low) / 2, fish.simulation.step
    time = np.arange(round(SECONDS / step)) * step
    wave = (1 - turn) * np.sin(2 * np.pi * beat * time)
    return np.asarray((low + high) / 2 + half * (turn + wave))


def _quick(fish: Fish, length: float, beat: float, along: Swim, turn: Swim) -> Quick:
    if along.diverged or turn.diverged:
        return Quick(beat, *[float("nan")] * 5)
    speed, _ = _pace(along)
    excursion = float(np.ptp(tip_offset(along)[along.time > SETTLED]))
    circling, rate = _pace(turn)
    viscosity = max(fish.medium.viscosity, 1e-9)
    return Quick(
        beat,
        speed,
        excursion,
        beat * excursion / abs(speed) if speed else float("inf"),
        abs(speed) * length * fish.medium.density / viscosity,
        circling / rate if abs(rate) > 1e-3 else float("inf"),
    )


def _pace(done: Swim) -> tuple[float, float]:
    """Mean surge [m/s] and yaw rate [rad/s] from `SETTLED` on."""
    late = done.time > SETTLED
    pose, time = done.qpos[late, :3], done.time[late]
    velocity = np.gradient(pose[:, :2], time, axis=0)
    surge = velocity[:, 0] * np.cos(pose[:, 2]) + velocity[:, 1] * np.sin(pose[:, 2])
    return float(surge.mean()), float((pose[-1, 2] - pose[0, 2]) / (time[-1] - time[0]))


def tip_offset(done: Swim) -> Array:
    """Sideways place of the rearmost point in the head's frame (k,) [m]."""
    tips = np.array([outline(done.twin.fish, row)[-1] for row in done.qpos]) - done.qpos[:, :2]
    yaw = done.qpos[:, 2]
    return np.asarray(np.cos(yaw) * tips[:, 1] - np.sin(yaw) * tips[:, 0])


def swim_warnings(swims: Sequence[Quick], length: float) -> list[str]:
    """What is wrong with how a fish of a `length` [m] swims."""
    said = []
    for one in swims:
        if math.isnan(one.speed):
            said.append(f"the swim at {one.frequency:.2g} Hz diverges: take a shorter step")
        elif one.speed < -SLOW * length:
            said.append(f"it swims backward at {one.frequency:.2g} Hz ({one.speed:.2g} m/s)")
    fast = max((one.speed for one in swims if not math.isnan(one.speed)), default=1.0)
    if 0 <= fast < SLOW * length:
        said.append(
            f"it hardly swims: {fast:.2g} m/s at best, {fast / length:.2g} lengths a second"
        )
    return said
