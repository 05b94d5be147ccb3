"""95 % bands of what a twin predicts: speed, distance, heading and turn rate of a swim.

Two things make a band wide. The draws of a posterior say what the recordings leave open. The
discrepancy says how far the twin is from real water in its own way, whatever its numbers: it is
measured on swims that were not fitted, best on swims unlike the fitted ones.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.optimize import brentq

from tailbeat.fish.description import Fish
from tailbeat.fish.rollout import Swim
from tailbeat.identify.predict import LONG
from tailbeat.identify.quantities import UNITS, measure
from tailbeat.identify.runs import Run, camera_track, repeat, twin_gait

Array = NDArray[np.float64]
# The size of a swim, to which a discrepancy is in proportion: of speed and distance their own, but
# at least this; of heading and turn rate their own plus this. All chosen: a fish that should swim
# straight turns a little, whichever way. In proportion to all turns, to and fro, was tried: fewer
# of a policy's headings lay in their bands (34 of 50 instead of 40).
LEAST = {"speed": 0.02, "distance": 0.1, "heading": 10.0, "turn_rate": 1.0}
AT_ONCE = 512  # swims in one batch, of all fish: about 0.2 GB of samples
MOST = 3.0  # largest discrepancy that is looked for, as a fraction of a swim's size
FEWEST = 3  # swims with a steady beat, and without, for a discrepancy of each (chosen)


@dataclass(frozen=True)
class Discrepancy:
    """How far the twin is from `swims` held-out swims beyond its posterior: a standard deviation
    for each quantity, as a fraction of the swim's size (`Drawn.size`). NaN where no swim tells.
    `told` says how many swims tell each; None in a posterior of releases up to 0.2.0: all.

    `steady` is that of swims with a steady beat, where there are enough of both kinds: in other
    water a twin may err more on these than on a policy's swims.
    """

    speed: float
    distance: float
    heading: float
    turn_rate: float
    swims: int
    told: tuple[int, ...] | None = None
    steady: "Discrepancy | None" = None


@dataclass(frozen=True)
class Band:
    """One quantity of one swim, in `unit`: `measured`, what the fish `predicted`, and the 95 % band
    from `low` to `high`."""

    recording: str
    quantity: str
    unit: str
    measured: float
    predicted: float
    low: float
    high: float

    @property
    def inside(self) -> bool:
        """Whether the measured value is in the band."""
        return self.low <= self.measured <= self.high


@dataclass(frozen=True, eq=False)
class Drawn:
    """One swim: `measured` (4,) and each draw's prediction (n, 4), in the order of `UNITS`; NaN
    where the recording does not tell. The first draw is the identified fish."""

    run: Run
    measured: Array
    predicted: Array

    @property
    def swum(self) -> Array:
        """The predictions (m, 4) of the draws that did not diverge."""
        return np.asarray(self.predicted[~np.isinf(self.predicted).any(axis=1)])

    @property
    def steady(self) -> bool:
        """Whether the swim has a steady beat."""
        return bool(np.isfinite(self.run.gait.frequency))

    @property
    def centre(self) -> Array:
        """Prediction (4,) of the fish, or of the first draw that did not diverge; NaN without one.
        The draws' median is no better: many numbers lie at an end of their range, and all their
        draws on one side."""
        return self.swum[0] if len(self.swum) else np.full(len(UNITS), np.nan)

    @property
    def spread(self) -> Array:
        """Standard deviation (4,) of the draws about the centre, from the nearest 68 %; infinite if
        over half of the draws diverged."""
        if 2 * len(self.swum) < len(self.predicted):
            return np.full(len(UNITS), np.inf)
        return np.asarray(np.quantile(np.abs(self.swum - self.centre), 0.68, axis=0))

    @property
    def size(self) -> Array:
        """The size of the swim in each quantity (4,), to which its discrepancy is in proportion."""
        least = np.array(list(LEAST.values()))
        own = np.abs(self.centre)
        return np.where(np.arange(len(least)) < 2, np.maximum(own, least), own + least)


def swim_all(fishes: Sequence[Fish], runs: Sequence[Run]) -> list[Drawn]:
    """Swim every run with every fish, in batches that fit in memory. All fish must be of one
    build."""
    size = max(AT_ONCE // len(fishes), 1)
    parts = [runs[i : i + size] for i in range(0, len(runs), size)]
    return [one for part in parts for one in _swim_together(fishes, part)]


def _swim_together(fishes: Sequence[Fish], runs: Sequence[Run]) -> list[Drawn]:
    done = repeat(fishes, runs, LONG)
    return [
        Drawn(
            run,
            measure(run.track, run, run.gait.speed),
            np.array([_predicted(f, run, s[i]) for f, s in zip(fishes, done, strict=True)]),
        )
        for i, run in enumerate(runs)
    ]


def _predicted(fish: Fish, run: Run, done: Swim) -> Array:
    if done.diverged:
        return np.full(len(UNITS), np.inf)
    speed = twin_gait(fish, run, done, LONG, marked=False).speed
    return measure(camera_track(fish, run, done, marked=False), run, speed)


def discrepancy(swims: Sequence[Drawn]) -> Discrepancy:
    """The discrepancy with which errors and draws agree: the mean square of the errors, each over
    its variance, is 1. It is 0 where the draws alone explain the errors.

    Swims with a steady beat have their own, if there are `FEWEST` with and `FEWEST` without. In no
    quantity is it smaller than that of the others: a few steady beats show no launch and no turn on
    the spot."""
    steady = [one for one in swims if one.steady]
    others = [one for one in swims if not one.steady]
    if min(len(steady), len(others)) < FEWEST:
        return _discrepancy(swims)
    found = replace(_discrepancy(others), swims=len(swims))
    return replace(found, steady=_larger(_discrepancy(steady), found))


def _larger(one: Discrepancy, other: Discrepancy) -> Discrepancy:
    """Of each quantity the larger discrepancy, with the number of swims that told it."""
    assert one.told is not None and other.told is not None
    mine, theirs = _measured(one), _measured(other)
    own = np.isnan(theirs) | (mine >= theirs)
    speed, distance, heading, turn_rate = np.where(own, mine, theirs).tolist()
    told = tuple(np.where(own, one.told, other.told).tolist())
    return Discrepancy(speed, distance, heading, turn_rate, one.swims, told)


def _discrepancy(swims: Sequence[Drawn]) -> Discrepancy:
    """One discrepancy of all these swims."""
    error = np.array([one.measured - one.centre for one in swims])
    spread = np.array([one.spread for one in swims])
    size = np.array([one.size for one in swims])
    speed, distance, heading, turn_rate = (
        _extra(*columns) for columns in zip(error.T, spread.T, size.T, strict=True)
    )
    told = tuple(np.sum(np.isfinite(error) & np.isfinite(spread), axis=0).tolist())
    return Discrepancy(speed, distance, heading, turn_rate, len(swims), told)


def _extra(error: Array, spread: Array, size: Array) -> float:
    known = np.isfinite(error) & np.isfinite(spread)
    if not known.any():
        return float("nan")
    error, spread, size = error[known], spread[known], size[known]

    def surplus(share: float) -> float:
        return float(np.mean(error**2 / (spread**2 + (share * size) ** 2 + 1e-18)) - 1)

    if surplus(0.0) <= 0:
        return 0.0
    return MOST if surplus(MOST) > 0 else float(brentq(surplus, 0.0, MOST))


def bands(swim: Drawn, known: Discrepancy | None, share: float = 0.95) -> list[Band]:
    """The bands of one swim: Student's t, with as many degrees of freedom as swims of its kind gave
    the discrepancy of the quantity. Left out are quantities that the recording does not tell, and
    those that no held-out swim told: the draws alone would be too sure."""
    centre, spread, known = swim.centre, swim.spread, of_kind(known, swim)
    reach = stats.t.ppf(0.5 + share / 2, _freedom(known)) * np.hypot(
        spread, shares(known) * swim.size
    )
    return [
        Band(swim.run.name, name, unit, measured, middle, middle - half, middle + half)
        for (name, unit), measured, middle, half in zip(
            UNITS.items(),
            swim.measured.tolist(),
            centre.tolist(),
            reach.tolist(),
            strict=True,
        )
        if np.isfinite(measured) and not (known and np.isnan(getattr(known, name)))
    ]


def of_kind(known: Discrepancy | None, swim: Drawn) -> Discrepancy | None:
    """The discrepancy of swims of this one's kind."""
    return known.steady if known is not None and known.steady and swim.steady else known


def _freedom(known: Discrepancy | None) -> Array:
    """Degrees of freedom (4,) in the order of `UNITS`; infinite without a discrepancy."""
    if known is None:
        return np.full(len(UNITS), np.inf)
    return np.maximum(np.broadcast_to(known.told or known.swims, len(UNITS)), 1)


def left_out(swims: Sequence[Drawn]) -> list[Band]:
    """The bands of held-out swims, each with the discrepancy of the others."""
    return [
        band
        for i, one in enumerate(swims)
        if len(swims) > 1
        for band in bands(one, discrepancy([*swims[:i], *swims[i + 1 :]]))
    ]


def shares(known: Discrepancy | None) -> Array:
    """The discrepancy's fractions (4,) in the order of `UNITS`, 0 where nothing is known."""
    if known is None:
        return np.zeros(len(UNITS))
    return np.nan_to_num(_measured(known))


def _measured(known: Discrepancy) -> Array:
    return np.array([getattr(known, name) for name in UNITS])


@dataclass(frozen=True)
class Count:
    """Of one quantity in `unit`: how many of `swims` are `inside` their bands, and the median half
    width of the bands and size of the errors."""

    quantity: str
    unit: str
    inside: int
    swims: int
    half_width: float
    error: float


def count(found: Sequence[Band]) -> list[Count]:
    """Count the bands that hold, quantity by quantity."""
    return [
        _counted(name, unit, own)
        for name, unit in UNITS.items()
        if (own := [one for one in found if one.quantity == name])
    ]


def _counted(name: str, unit: str, own: Sequence[Band]) -> Count:
    half = np.median([(one.high - one.low) / 2 for one in own])
    error = np.median([abs(one.measured - one.predicted) for one in own])
    return Count(name, unit, sum(b.inside for b in own), len(own), float(half), float(error))


def as_rows(found: Sequence[Band]) -> list[dict[str, Any]]:
    """The JSON of bands."""
    return [{**asdict(one), "inside": one.inside} for one in found]


def as_json(found: Sequence[Band]) -> Mapping[str, Any]:
    """The JSON of bands and of how many hold."""
    return {"bands": as_rows(found), "held": [asdict(one) for one in count(found)]}
