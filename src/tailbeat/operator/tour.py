"""One target after the other, as the station sees it: which is next, and what became of the others.

Decisions alone: the caller gives the poses that the camera saw and sends the target. A
target is reached when the tag comes within the arrival's distance of it, and given up after a time.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tailbeat.files import BadInput
from tailbeat.link.places import POOL

ARRIVAL = 0.05  # m (paper)
PATIENCE = 30.0  # s for one target
APART = 0.8  # m between one target and the next
MARGIN = 0.65  # m that targets keep from the walls: room for the fish to turn behind them
TRIES = 2000  # draws for one target
Place = tuple[float, float]
Pose = tuple[float, float, float]


def draw_targets(count: int, seed: int, pool: tuple[float, float] = POOL) -> NDArray[np.float64]:
    """Places (count, 2) inside a pool of this length and width [m], each well apart from the one
    before. Raises BadInput."""
    if min(pool) <= 2 * MARGIN:
        raise BadInput(f"--tour: the pool of {pool[0]:g} by {pool[1]:g} m has no room to turn.")
    rng, room = np.random.default_rng(seed), np.array(pool) / 2 - MARGIN
    places = [np.zeros(2)]
    for _ in range(TRIES * count):
        place = rng.uniform(-room, room)
        if np.hypot(*(place - places[-1])) > APART:
            places.append(place)
        if len(places) > count:
            return np.array(places[1:])
    raise BadInput(f"{count} targets do not fit into the pool; ask for fewer.")


@dataclass(frozen=True)
class TargetResult:
    """What became of a target, numbered from 1: its place [m], whether the fish reached it, the
    closest approach [m], and the time [s] it took or was given."""

    target: int
    x: float
    y: float
    reached: bool
    closest: float
    seconds: float


@dataclass(eq=False)
class Tour:
    """`targets` [m] in their order; `rows` of those that are over."""

    targets: Sequence[Place]
    patience: float = PATIENCE
    arrival: float = ARRIVAL
    began: float | None = None  # when the present target was first swum to [s]
    nearest: float = math.inf
    rows: list[TargetResult] = field(default_factory=list)

    @property
    def target(self) -> Place | None:
        """Where to swim now; None when all are over."""
        return self.targets[len(self.rows)] if len(self.rows) < len(self.targets) else None

    def see(self, pose: Pose, now: float) -> None:
        """Take a pose of a fish that swims, seen at `now` [s]; the next target follows an arrival
        or the end of patience."""
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
