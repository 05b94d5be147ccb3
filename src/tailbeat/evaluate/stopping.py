"""How far a fish goes on when its tail stops: straight, or held bent."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tailbeat.control.actions import PERIOD, Generator
from tailbeat.evaluate.steady_swims import Command, Swimmer, played, poses, scripted, steady
from tailbeat.evaluate.trial import Progress

Array = NDArray[np.float64]
STOPPED = 0.1  # of the speed at the start


@dataclass(frozen=True, eq=False)
class Stops:
    """Swims (waters, n) that stop: speed before it [m/s]; distance along the path [m] and time [s]
    until the speed is below a tenth, infinite where it never was."""

    start: Array
    distance: Array
    seconds: Array


def stops(
    swimmer: Swimmer,
    space: Generator,
    beats: Sequence[Command],
    rest: Command,
    times: tuple[float, float],
    progress: Progress,
) -> Stops:
    """Swim each beat for the first of `times` [s], then command `rest` for the second."""
    swum = scripted(space, beats, times[0])
    coast = scripted(space, [rest] * len(beats), times[1])
    pose = poses(swimmer, played(space, np.concatenate([swum, coast], axis=1)), progress)
    cut = swum.shape[1]
    periods = [beat.period for beat in beats]
    start = np.array([steady(one[:, : cut + 1], periods).speed for one in pose])
    found = [
        [_stop(path, cut, abs(v), period) for path, v, period in zip(*one, strict=True)]
        for one in zip(pose, start.tolist(), [periods] * len(pose), strict=True)
    ]
    distance, seconds = np.moveaxis(np.array(found), -1, 0)
    return Stops(start, distance, seconds)


def _stop(pose: Array, cut: int, speed: float, period: float) -> tuple[float, float]:
    """Distance [m] and time [s] from sample `cut` of poses (k, 3) until a fish is slower than a
    tenth of `speed` [m/s] and stays so; infinite if it never is. Positions are averaged over a
    beat's `period` [s] about each sample, so that recoil counts little."""
    width = max(round(period / PERIOD), 1)
    kernel = np.ones(width) / width
    after = pose[max(cut - width // 2, 0) :]
    x, y = (np.convolve(column, kernel, mode="valid") for column in after[:, :2].T)
    way = np.hypot(np.diff(x), np.diff(y))
    fast = np.flatnonzero(~(way / PERIOD < STOPPED * speed))  # NaN counts as fast
    last = int(fast[-1]) + 1 if len(fast) else 0
    if last >= len(way):
        return np.inf, np.inf
    return float(way[:last].sum()), PERIOD * last
