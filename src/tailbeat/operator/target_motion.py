"""How fast the target moves, estimated from the places that the station sends with their times."""

from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from tailbeat.link.clock import SECOND
from tailbeat.link.datagrams import Frame

SPAN = 0.5  # s of places that count
SHORTEST, FEWEST = 0.2, 4  # s from the first of them to the last; places
KEPT = 128  # places: at 60 frames/s more than the span
Velocity = tuple[float, float]


def velocity(times: ArrayLike, places: ArrayLike) -> Velocity | None:
    """The target's velocity x, y [m/s]: slope of the least-squares line through its places (k, 2)
    [m] at rising times (k,) [s] of the last half second. None where they are too few."""
    at, where = np.asarray(times, float), np.asarray(places, float).reshape(-1, 2)
    recent = at > at[-1] - SPAN if len(at) else np.zeros(0, bool)
    at, where = at[recent], where[recent]
    if len(at) < FEWEST or at[-1] - at[0] < SHORTEST:
        return None
    centred = at - at.mean()
    x, y = (centred @ where / (centred @ centred)).tolist()
    return x, y


@dataclass(eq=False)
class Trace:
    """The target's last places with their times; call `add` with every frame that is sent."""

    times: deque[float] = field(default_factory=lambda: deque(maxlen=KEPT))
    places: deque[tuple[float, float]] = field(default_factory=lambda: deque(maxlen=KEPT))

    def add(self, frame: Frame) -> None:
        """Keep a frame's target, once. A clock that was set back begins anew."""
        at = frame.captured / SECOND
        if frame.target is None or (self.times and at == self.times[-1]):
            return
        if self.times and at < self.times[-1]:
            self.times.clear()
            self.places.clear()
        self.times.append(at)
        self.places.append(frame.target)

    def velocity(self, now: float) -> Velocity | None:
        """The velocity [m/s] at `now` [s] of the same clock; None if no place is new."""
        if not self.times or now - self.times[-1] > SPAN:
            return None
        return velocity(self.times, self.places)
