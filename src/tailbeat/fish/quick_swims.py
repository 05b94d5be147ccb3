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
# A crank steers by its speed within the turn: by how much it varies, and at which angles [rad] it
# is highest (half a turn more turns to the other side).
DEPTH, FASTEST = 0.8, tuple(np.radians((0.0, 45.0, 90.0, 135.0)).tolist())
SLOW = 0.05  # lengths per second


@dataclass(frozen=True)
class Quick:
    """A quick swim at a beat [Hz]: speed [m/s], peak-to-peak excursion of the tail's tip [m],
    Strouhal and Reynolds number; radius of the circle when the beat is centred at half the range
    [m], negative to the right, infinite if it does not turn. A crank's is the tightest of those
    that its speed within the turn gives. NaN where the swim diverged."""

    frequency: float
    speed: float
    excursion: float
    strouhal: float
    reynolds: float
    circle: float


def quick_swims(fish: Fish, length: float) -> tuple[Quick, ...]:
    """Three beats over the band at full stroke, straight and turning, in one batch."""
    beats = np.geomspace(max(fish.band[0], 0.2), fish.band[1], 3).tolist()
    twin, step = compile_twin(fish), fish.simulation.step
    time = np.asarray(np.arange(round(SECONDS / step)) * step, float)
    commands = [row for beat in beats for row in _commands(fish, beat, time)]
    every = max(round(SAMPLE / step), 1)
    done = swim([twin] * len(commands), [Start.at_rest()] * len(commands), commands, every)
    each = len(commands) // len(beats)
    parts = [done[i * each : (i + 1) * each] for i in range(len(beats))]
    return tuple(
        _quick(fish, length, beat, p[0], p[1:]) for beat, p in zip(beats, parts, strict=True)
    )


def _commands(fish: Fish, beat: float, time: Array) -> list[Array]:
    """A beat straight ahead, then turning: about a centre within the range; of a crank, with each
    phase of its fast half."""
    if fish.motor.range is None:
        even = 2 * np.pi * beat * time
        return [even, *(_uneven(even, fastest) for fastest in FASTEST)]
    low, high = fish.motor.range
    half, wave = (high - low) / 2, np.sin(2 * np.pi * beat * time)
    return [(low + high) / 2 + half * (turn + (1 - turn) * wave) for turn in (0.0, TURN)]


def _uneven(even: Array, fastest: float) -> Array:
    """Angles of a crank that makes as many turns as the angle `even`, with the speed w (1 + DEPTH
    cos(angle - fastest)), in closed form."""
    turns = np.floor(even / (2 * np.pi) + 0.5)
    rest = even - 2 * np.pi * turns  # within half a turn
    ratio = math.sqrt((1 + DEPTH) / (1 - DEPTH))
    return np.asarray(fastest + 2 * np.pi * turns + 2 * np.arctan(ratio * np.tan(rest / 2)))


def _quick(fish: Fish, length: float, beat: float, along: Swim, turns: Sequence[Swim]) -> Quick:
    if along.diverged or any(turn.diverged for turn in turns):
        return Quick(beat, *[float("nan")] * 5)
    speed, _ = _pace(along)
    excursion = float(np.ptp(tip_offset(along)[along.time > SETTLED]))
    circles = [_circle(turn) for turn in turns]
    viscosity = max(fish.medium.viscosity, 1e-9)
    return Quick(
        beat,
        speed,
        excursion,
        beat * excursion / abs(speed) if speed else float("inf"),
        abs(speed) * length * fish.medium.density / viscosity,
        min(circles, key=abs),
    )


def _circle(turn: Swim) -> float:
    """Radius of the circle that a swim makes [m]."""
    surge, rate = _pace(turn)
    return surge / rate if abs(rate) > 1e-3 else float("inf")


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
