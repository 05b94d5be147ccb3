"""Paths of moving targets for training: still, straight, bent, with stops, from place to place,
and figure-eights.

None of them is a path of the trials: no circle is closed, and every figure-eight is smaller than
theirs (a test).
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tailbeat.control.actions import PERIOD

Array = NDArray[np.float64]
# shares of episodes: one still target, still targets one after another, a figure-eight
STILL, PLACES, EIGHTS = 0.25, 0.15, 0.1
STRAIGHT, STOPS = 0.2, 0.3  # shares of the moving targets: straight; with stops
TIGHTEST = 0.5  # of the reach: smallest radius of a bend (chosen: the fish turns in 0.4)
SLOWEST = 0.15  # of the fastest speed
BENDS, STAYS = (2.0, 8.0), (5.0, 15.0)  # s between changes of a bend; that one target stays
PAUSES = (2.0, 8.0)  # s that a target moves, or stands
SMOOTH = 1.0  # s over which bends and stops begin
NEXT = (0.6, 2.0)  # m from one still target to the next
HALF_EIGHT = (0.8, 1.3)  # m along half a figure-eight; that of the trials has 1.6 m
WIDTH = (0.3, 0.5)  # of a figure-eight, over its length


def draw(begin: Array, steps: int, fastest: float, reach: float, rng: np.random.Generator) -> Array:
    """Positions (steps + 1, 2) [m] of a target that begins at `begin` (2,), at control steps; its
    speed is at most `fastest` [m/s], but where it jumps to its next place. Jumps, bends and figures
    are those of the paper's fish, times the `reach` of the fish."""
    kind = rng.uniform()
    if kind < STILL:
        return np.tile(begin, (steps + 1, 1))
    if kind < STILL + PLACES:
        return begin + _places(steps, reach, rng)
    if kind < STILL + PLACES + EIGHTS:
        return begin + _eight(steps, fastest, reach, rng)
    return begin + _way(steps, fastest, reach, rng)


def _places(steps: int, reach: float, rng: np.random.Generator) -> Array:
    """Offsets of targets that stay for some seconds each."""
    found, now = np.zeros((steps + 1, 2)), 0
    while (now := now + round(rng.uniform(*STAYS) / PERIOD)) <= steps:
        away, angle = reach * rng.uniform(*NEXT), rng.uniform(0, 2 * np.pi)
        found[now:] += away * np.array([np.cos(angle), np.sin(angle)])
    return found


def _eight(steps: int, fastest: float, reach: float, rng: np.random.Generator) -> Array:
    """Offsets of a target that goes round a figure-eight at one speed, from anywhere on it and in
    any direction."""
    angle = np.linspace(0, 2 * np.pi, 2001)
    wide = rng.uniform(*WIDTH) * np.sin(2 * angle)
    lap = rng.uniform(*HALF_EIGHT) * reach * (np.sin(angle) + 1j * wide)
    way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(lap)))])
    speed = fastest * rng.uniform(SLOWEST, 1.0) * rng.choice((-1, 1))
    place = rng.uniform(0, way[-1]) + speed * PERIOD * np.arange(steps + 1)
    turned = np.exp(2j * np.pi * rng.uniform()) * np.interp(place, way, lap, period=way[-1])
    return np.stack([turned.real, turned.imag], axis=1) - [turned[0].real, turned[0].imag]


def _way(steps: int, fastest: float, reach: float, rng: np.random.Generator) -> Array:
    """Offsets of a target that moves along bends, with or without stops."""
    speed = np.full(steps, fastest * rng.uniform(SLOWEST, 1.0))
    turn = np.zeros(steps)
    if rng.uniform() > STRAIGHT:
        turn = _smooth(_levels(steps, BENDS, lambda: rng.uniform(-1, 1), rng)) / (TIGHTEST * reach)
    if rng.uniform() < STOPS:
        speed = speed * _smooth(_levels(steps, PAUSES, lambda: float(rng.uniform() < 0.6), rng))
    heading = rng.uniform(0, 2 * np.pi) + np.cumsum(turn * speed) * PERIOD
    step = PERIOD * speed[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    return np.concatenate([np.zeros((1, 2)), np.cumsum(step, axis=0)])


def _levels(
    steps: int,
    span: tuple[float, float],
    level: Callable[[], float],
    rng: np.random.Generator,
) -> Array:
    """A signal (steps,) that keeps each level for a time within `span` [s]."""
    found, now = np.empty(steps), 0
    while now < steps:
        then = now + max(round(rng.uniform(*span) / PERIOD), 1)
        found[now:then], now = level(), then
    return found


def _smooth(signal: Array) -> Array:
    """A moving mean over `SMOOTH`."""
    wide = round(SMOOTH / PERIOD)
    padded = np.concatenate([np.full(wide - 1, signal[0]), signal])
    total = np.cumsum(np.concatenate([[0.0], padded]))
    return np.asarray((total[wide:] - total[:-wide]) / wide)
