"""A tour of targets as the station sees it: which one is next, and the results of the others.

The caller gives the camera's poses and sends the target. A target is reached when the tag comes
within the arrival's distance of it. It is given up after a time.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tailbeat.control.measure import ARRIVAL, PAPER, PATIENCE, Measure
from tailbeat.files import BadInput
from tailbeat.link.places import POOL

# Of the paper's fish:
APART = 0.8  # m, least distance of successive targets
MARGIN = 0.65  # m, least distance of targets from the walls: the fish must be able to turn
TRIES = 2000  # most draws per target
Place = tuple[float, float]
Pose = tuple[float, float, float]


def draw_targets(
    count: int, seed: int, pool: tuple[float, float] = POOL, measure: Measure = PAPER
) -> NDArray[np.float64]:
    """Draw positions (count, 2) inside a pool of this length and width [m], each far enough from
    the last; a small fish stays about the pool's middle. Raises BadInput."""
    margin, apart = MARGIN * measure.reach, APART * measure.reach
    if min(pool) <= 2 * margin:
        raise BadInput(f"--tour: the pool of {pool[0]:g} by {pool[1]:g} m is too small to turn in.")
    used = np.minimum(pool, np.array(POOL) * measure.reach)
    rng, room = np.random.default_rng(seed), used / 2 - margin
    places = [np.zeros(2)]
    for _ in range(TRIES * count):
        place = rng.uniform(-room, room)
        if np.hypot(*(place - places[-1])) > apart:
            places.append(place)
        if len(places) > count:
            return np.array(places[1:])
    raise BadInput(f"{count} targets do not fit into the pool; give a smaller number.")


@dataclass(frozen=True)
class TargetResult:
    """Result of a target, numbered from 1: its position [m], whether the fish reached it, the
    closest approach [m], and the time [s] it took."""

    target: int
    x: float
    y: float
    reached: bool
    closest: float
    seconds: float


@dataclass(eq=False)
class Tour:
    """A tour: `targets` [m] in order, and `rows` of those that are over."""

    targets: Sequence[Place]
    patience: float = PATIENCE
    arrival: float = ARRIVAL
    began: float | None = None  # s, when the fish began to swim to the present target
    nearest: float = math.inf
    rows: list[TargetResult] = field(default_factory=list)

    @property
    def target(self) -> Place | None:
        """Where to swim now; None when all are over."""
        return self.targets[len(self.rows)] if len(self.rows) < len(self.targets) else None

    def see(self, pose: Pose, now: float) -> None:
        """Take a pose of a swimming fish, seen at `now` [s]. The next target follows an arrival, or
        after `patience`."""
        if self.target is None:
            return
        self.began = now if self.began is None else self.began
        away = math.dist(pose[:2], self.target)
        self.nearest = min(self.nearest, away)
        if away < self.arrival or now - self.began >= self.patience:
            self._next(now, away < self.arrival)

    def _next(self, now: float, reached: bool) -> None:
        assert self.target is not None and self.began is not None
        number, took = len(self.rows) + 1, now - self.began
        self.rows.append(TargetResult(number, *self.target, reached, self.nearest, took))
        self.began, self.nearest = now, math.inf
