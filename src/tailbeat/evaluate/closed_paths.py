"""Which closed paths a fish can follow behind a target at a fixed speed, whatever the policy is.

This is necessary, and not enough. It compares mean speeds and circles of constant commands, and
knows nothing of what a policy sees, of currents, or of the time to change from one command to
another. A fish that may leave the path can do more: cut corners, swim loops or zigzags.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tailbeat.control.measure import Measure
from tailbeat.evaluate.gaits import Gait
from tailbeat.evaluate.limit_rows import Spread, in_band, spread
from tailbeat.evaluate.track import TARGET_PATHS
from tailbeat.operator.paths import PATHS, even, lap_length

Array = NDArray[np.float64]
POINTS, APART = 720, 3  # of a path, and how many of them apart its curvature is measured


@dataclass(frozen=True)
class PathRow:
    """A closed path at a fixed `speed` [m/s], and its least `radius` of curvature [m].

    Beats in the identified band: the least speed [m/s] with so tight a circle, `slowest`, and the
    `tightest` circle [m] at no more than the path's speed. In how many of the `waters` the path is
    allowed: to beats in the `band`, to `all` beats, and to beats in the band or `bursts` of them.
    """

    where: str
    path: str
    radius: float
    speed: float
    slowest: Spread
    tightest: Spread
    band: int
    all: int
    bursts: int
    waters: int


def path_rows(
    where: str,
    gaits: Sequence[Gait],
    bursts: Sequence[Gait],
    band: tuple[float, float],
    size: Measure,
) -> tuple[PathRow, ...]:
    """The closed paths of the trial `track` whose targets do not wait for the fish, in a fish's
    measure."""
    known = [one for one in gaits if in_band(one, band)]
    found = []
    for one in (path for path in TARGET_PATHS if np.isinf(path.lead) and path.path in PATHS):
        way = PATHS[one.path]
        speed, radius = size.speed * lap_length(way) / one.lap, size.reach * least_radius(way)
        found.append(
            PathRow(
                where=where,
                path=one.name,
                radius=radius,
                speed=speed,
                slowest=_slowest(known, radius),
                tightest=_tightest(known, speed),
                band=waters_allowing(known, speed, radius),
                all=waters_allowing(gaits, speed, radius),
                bursts=waters_allowing([*known, *bursts], speed, radius),
                waters=len(known[0].speed),
            )
        )
    return tuple(found)


def _slowest(gaits: Sequence[Gait], radius: float) -> Spread:
    """The least speed of gaits that turn within `radius`, in each water."""
    waters = range(len(gaits[0].speed))
    turns = ([one.speed[w] for one in gaits if one.radius[w] <= radius] for w in waters)
    return spread(min(speeds, default=np.inf) for speeds in turns)


def _tightest(gaits: Sequence[Gait], speed: float) -> Spread:
    """The least radius of gaits that are not faster than `speed`, in each water."""
    waters = range(len(gaits[0].speed))
    slow = ([one.radius[w] for one in gaits if one.speed[w] <= speed] for w in waters)
    return spread(min(radii, default=np.inf) for radii in slow)


def waters_allowing(gaits: Sequence[Gait], speed: float, radius: float) -> int:
    """In how many waters a fish with these gaits can follow a target at `speed` [m/s] round a
    curve of `radius` [m] without loops: one gait is as slow and turns as tightly, to both sides,
    and one is as fast."""
    waters = range(len(gaits[0].speed) if gaits else 0)
    slow = [any(g.speed[w] <= speed and g.radius[w] <= radius for g in gaits) for w in waters]
    fast = [any(g.speed[w] >= speed for g in gaits) for w in waters]
    return sum(a and b for a, b in zip(slow, fast, strict=True))


def least_radius(path: Callable[[Array], Array]) -> float:
    """Least radius of curvature of a closed path [m], from the circle through points 1 % of a lap
    apart."""
    here = even(path, POINTS)
    before, after = np.roll(here, APART, axis=0), np.roll(here, -APART, axis=0)
    one, two, three = after - here, here - before, after - before
    area = np.abs(two[:, 0] * one[:, 1] - two[:, 1] * one[:, 0]) / 2
    sides = np.prod([np.hypot(*side.T) for side in (one, two, three)], axis=0)
    return float((sides / np.maximum(4 * area, 1e-12)).min())
