"""Slow averages of what a robot feels: a memory of how it is built.

A weak servo, a bent tail, a tag glued askew or a current shows in what a swim is like on average,
not in three frames. Seven signals each pass two first-order low-passes, one over about a stroke and
one over a few. None of them depends on the target. Tried in
docs/experiments/2026-11-wider-centre.md. Needs only numpy; training and robot run this code.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tailbeat.control.measure import Measure
from tailbeat.control.observation import AVERAGED, Samples, wrapped

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Averages:
    """Time constants of the low-passes. They are in the policy's contract."""

    fast: float = 1.0
    """Of the first [s] (chosen)."""
    slow: float = 4.0
    """Of the second [s] (chosen)."""


def sized(paper: Averages, measure: Measure) -> Averages:
    """Time constants of the paper's fish in another fish's measure."""
    return Averages(paper.fast * measure.time, paper.slow * measure.time)


def begin(count: int) -> Array:
    """The averages (n, 2, 7) of fish at rest: zeros."""
    return np.zeros((count, 2, len(AVERAGED)))


def update(
    constants: Averages, state: Array, samples: Samples, setpoint: Array, elapsed: float
) -> Array:
    """The averages (n, 2, 7), fast and slow, `elapsed` [s] after the last ones. `samples` have
    velocities; `setpoint` (n,) [rad] is the one that the motor has followed since."""
    spans = np.array([constants.fast, constants.slow])
    gain = -np.expm1(-elapsed / spans)[:, None]
    return np.asarray(state + gain * (_felt(samples, setpoint)[:, None] - state))


def _felt(samples: Samples, setpoint: Array) -> Array:
    """The averaged signals (n, 7) in the order of `AVERAGED`."""
    assert samples.motion is not None
    signals = (
        samples.yaw_rate,
        samples.commands[:, 0, 1],
        np.sin(samples.motor_angle),
        *samples.motion[:, 2:].T,
        np.abs(samples.motor_velocity),
        np.abs(wrapped(setpoint - samples.motor_angle)),
    )
    return np.stack(signals, axis=-1)
