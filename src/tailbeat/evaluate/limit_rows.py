"""What follows from the swims of a grid of commands: the tables of `tailbeat limits`.

Each number is computed in every water by itself. A `Spread` then has the default water's, and the
lowest and highest of all.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tailbeat.evaluate.gaits import Gait
from tailbeat.evaluate.stopping import Stops

Array = NDArray[np.float64]
SPEEDS = (0.0, 0.02, 0.04, 0.06, 0.09, 0.12, 0.18, 0.24, 0.36)  # m/s, of the paper's fish
INSIDE, BELOW = "in the band", "below the band"


@dataclass(frozen=True)
class Spread:
    """A number in the default water, and the lowest and highest of all waters. Infinite, which JSON
    writes as null, where there is none."""

    default: float
    low: float
    high: float


@dataclass(frozen=True)
class SlowestRow:
    """The slowest beat `where` (pool or twin), among `beats` in the identified band or below it.

    `steerable`: least speed straight ahead [m/s] of a beat that some centre turns both ways, fast
    enough and in a tight enough circle; the speed `in_turn` [m/s] and the `circle`'s radius [m];
    frequency [Hz], amplitude and centre [rad] in the default water. `straight`: the slowest swim
    straight ahead of any beat [m/s].
    """

    where: str
    beats: str
    steerable: Spread
    in_turn: Spread
    circle: Spread
    frequency: float | None
    amplitude: float | None
    centre: float | None
    straight: Spread


@dataclass(frozen=True)
class CircleRow:
    """The tightest circle's radius [m] of commands with a speed from `above` to `below` [m/s]: of
    beats in the identified `band`, and of `all` beats."""

    where: str
    above: float
    below: float
    band: Spread
    all: Spread


@dataclass(frozen=True)
class StopRow:
    """A stop with a `tail` that is straight or bent: speed at the start [m/s]; distance [m] and
    time [s] until a tenth of it."""

    where: str
    tail: str
    start: Spread
    distance: Spread
    seconds: Spread


@dataclass(frozen=True)
class BurstRow:
    """Full beats for `burst` [s], then `rest` [s]: mean speed straight ahead [m/s]; the tightest
    `circle` both ways [m], and the mean speed in it [m/s]."""

    where: str
    burst: float
    rest: float
    straight: Spread
    circle: Spread
    in_turn: Spread


def spread(values: Iterable[float]) -> Spread:
    """The spread of a number (waters,) over the waters; the first is the default."""
    each = [value if np.isfinite(value) else np.inf for value in values]
    return Spread(each[0], min(each), max(each))


def in_band(gait: Gait, band: tuple[float, float]) -> bool:
    """Whether a gait's frequency is not below the band's lower edge."""
    return gait.command.frequency >= band[0] * (1 - 1e-9)


# ---- the slowest that can be steered ------------------------------------------------------------


def slowest(
    where: str, gaits: Sequence[Gait], band: tuple[float, float], radius: float, rate: float
) -> tuple[SlowestRow, ...]:
    """The slowest steerable beats in the band and below it. They turn both ways in a circle of at
    most `radius` [m], at `rate` [rad/s] or faster."""
    parts = {
        INSIDE: [one for one in gaits if in_band(one, band)],
        BELOW: [one for one in gaits if not in_band(one, band)],
    }
    return tuple(_slowest(where, name, own, radius, rate) for name, own in parts.items() if own)


def _slowest(
    where: str, beats: str, gaits: Sequence[Gait], radius: float, rate: float
) -> SlowestRow:
    ahead = {_beat(one): one for one in gaits if one.command.centre == 0}
    found = [_steerable(gaits, ahead, water, radius, rate) for water in range(len(gaits[0].speed))]
    first = found[0][1]
    command = first.command if first else None
    turns = [(one.speed[w], one.radius[w]) if one else (np.inf,) * 2
             for w, (_, one) in enumerate(found)]  # fmt: skip
    swims = [[v for one in ahead.values() if (v := one.speed[w]) > 0] for w in range(len(found))]
    return SlowestRow(
        where=where,
        beats=beats,
        steerable=spread(speed for speed, _ in found),
        in_turn=spread(speed for speed, _ in turns),
        circle=spread(circle for _, circle in turns),
        frequency=command.frequency if command else None,
        amplitude=command.amplitude if command else None,
        centre=command.centre if command else None,
        straight=spread(min(speeds, default=np.inf) for speeds in swims),
    )


def _beat(gait: Gait) -> tuple[float, float]:
    return gait.command.frequency, gait.command.amplitude


def _steerable(
    gaits: Sequence[Gait],
    ahead: dict[tuple[float, float], Gait],
    water: int,
    radius: float,
    rate: float,
) -> tuple[float, Gait | None]:
    """Speed straight ahead of the slowest steerable beat in a water, and its tightest turn."""
    turns = [one for one in gaits if one.radius[water] <= radius and one.rate[water] >= rate]
    speeds = {beat: one.speed[water] for beat, one in ahead.items() if one.speed[water] > 0}
    best = min((speeds[_beat(one)] for one in turns if _beat(one) in speeds), default=np.inf)
    own = [one for one in turns if speeds.get(_beat(one)) == best]
    return best, min(own, key=lambda one: one.radius[water], default=None)


# ---- circles ------------------------------------------------------------------------------------


def circles(
    where: str, gaits: Sequence[Gait], band: tuple[float, float], unit: float
) -> tuple[CircleRow, ...]:
    """The tightest circles by speed, in steps that are `unit` times the paper's fish's."""
    edges = [unit * speed for speed in SPEEDS]
    known = [one for one in gaits if in_band(one, band)]
    return tuple(
        CircleRow(where, low, high, _tightest(known, low, high), _tightest(gaits, low, high))
        for low, high in pairwise(edges)
    )


def _tightest(gaits: Sequence[Gait], low: float, high: float) -> Spread:
    return spread(
        min((one.radius[w] for one in gaits if low <= one.speed[w] < high), default=np.inf)
        for w in range(_waters(gaits))
    )


def _waters(gaits: Sequence[Gait]) -> int:
    return len(gaits[0].speed)


def front(gaits: Sequence[Gait]) -> Array:
    """Speed [m/s] and radius [m] (k, 2) in the default water, of the gaits of which no slower one
    has a tighter circle: the limit of what `allowed` takes."""
    pairs = sorted((one.speed[0], one.radius[0]) for one in gaits if np.isfinite(one.radius[0]))
    found: list[tuple[float, float]] = []
    for speed, radius in pairs:
        if not found or radius < found[-1][1]:
            found.append((speed, radius))
    return np.array(found).reshape(-1, 2)


# ---- stops and bursts ---------------------------------------------------------------------------


def stop_rows(where: str, tail: str, found: Stops) -> tuple[StopRow, ...]:
    """A row for every beat that was stopped."""
    each = zip(found.start.T, found.distance.T, found.seconds.T, strict=True)
    return tuple(StopRow(where, tail, *map(spread, numbers)) for numbers in each)


def burst_rows(where: str, gaits: Sequence[Gait]) -> tuple[BurstRow, ...]:
    """A row for every length of the pauses."""
    pauses = list(dict.fromkeys((one.command.burst, one.command.rest) for one in gaits))
    return tuple(
        _burst_row(where, *pause, [g for g in gaits if (g.command.burst, g.command.rest) == pause])
        for pause in pauses
    )


def _burst_row(where: str, burst: float, rest: float, gaits: Sequence[Gait]) -> BurstRow:
    (ahead,) = (one for one in gaits if one.command.centre == 0)
    best = [min(gaits, key=lambda one: one.radius[w]) for w in range(_waters(gaits))]
    turns = [(one.radius[w], one.speed[w]) for w, one in enumerate(best)]
    return BurstRow(
        where=where,
        burst=burst,
        rest=rest,
        straight=spread(ahead.speed),
        circle=spread(radius for radius, _ in turns),
        in_turn=spread(speed if np.isfinite(radius) else np.inf for radius, speed in turns),
    )
