"""95 % bands of what a twin predicts: speed, distance, heading and turn rate of a swim.

Two things make a band wide. The draws of a posterior say what the recordings leave open. The
discrepancy says how far the twin is from real water in its own way, whatever its numbers: it is
measured on swims that were not fitted, best on swims unlike the fitted ones.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
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
# The size of a swim, to which what is left of its error is in proportion (`size`). Of speed and
# distance it is at least this, of heading and turn rate the spread of their draws plus this. All
# chosen. A fish that should swim straight turns a little, whichever way, and where small changes of
# the numbers turn a swim, so does what the law lacks.
LEAST = {"speed": 0.02, "distance": 0.1, "heading": 1.0, "turn_rate": 0.2}
FACTOR = 0.3  # standard deviation of the factor from 1, before any swim (chosen)
# How far the factor of one kind of swim is from that of another, by quantity: what makes each of
# twelve counts in six waters hold in 88 % (docs/experiments/2026-11-what-swims-tell.md).
TRANSFER = {"speed": 0.02, "distance": 0.02, "heading": 0.06, "turn_rate": 0.06}
AHEAD = np.arange(len(UNITS)) < 2  # speed and distance
AT_ONCE = 512  # swims in one batch, of all fish: about 0.2 GB of samples
MOST = 100.0  # largest error that is looked for, in sizes of a swim


@dataclass(frozen=True)
class Deviation:
    """How far one quantity of the twin is from `swims` swims: by a `factor` with its standard
    `error`, and beyond it and the draws by `left`, a standard deviation in sizes of a swim
    (`size`). `own` is the part of the draws' spread that counts (`own_share`). NaN where no swim
    tells."""

    factor: float
    error: float
    left: float
    swims: int
    own: float = 1.0


@dataclass(frozen=True)
class Discrepancy:
    """How far the twin is from `swims` held-out swims beyond its posterior. In other water than
    that of its recordings nearly all of it is one factor, about the same for every swim. `usual` is
    the median speed that the twin predicts of them [m/s]."""

    speed: Deviation
    distance: Deviation
    heading: Deviation
    turn_rate: Deviation
    swims: int
    usual: float

    @property
    def all(self) -> tuple[Deviation, ...]:
        """The deviations in the order of `UNITS`."""
        return self.speed, self.distance, self.heading, self.turn_rate


@dataclass(frozen=True)
class Band:
    """One quantity of one swim, in `unit`: `measured`, what was `predicted` (by the fish, times the
    factor of the discrepancy), and the 95 % band from `low` to `high`."""

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
    def centre(self) -> Array:
        """Prediction (4,) of the fish, or of the first draw that did not diverge; NaN without one.
        The draws' median is no better: many numbers lie at an end of their range, and all their
        draws on one side."""
        return self.swum[0] if len(self.swum) else np.full(len(UNITS), np.nan)

    @property
    def spread(self) -> Array:
        """Standard deviation (4,) of the draws about their median, from the nearest 68 %; infinite
        if over half of the draws diverged. How far the median is from the centre does not count: it
        is nearly one factor for all swims (docs/experiments/2026-11-what-swims-tell.md)."""
        if 2 * len(self.swum) < len(self.predicted):
            return np.full(len(UNITS), np.inf)
        middle = np.median(self.swum, axis=0)
        return np.asarray(np.quantile(np.abs(self.swum - middle), 0.68, axis=0))


def size(swim: Drawn, usual: float) -> Array:
    """The size of the swim in each quantity (4,), to which what is left is in proportion.

    Of heading and turn rate it is the spread of the draws. Errors of the speed are neither in
    proportion to it nor the same for all swims: a slow swim that turns errs more for its speed. So
    its size lies between its own speed and the `usual` one [m/s], and the distance is that long.
    """
    least = np.array(list(LEAST.values()))
    own = np.maximum(np.abs(swim.centre), least)
    between = float(np.hypot(own[0], usual) / np.sqrt(2))
    return np.where(AHEAD, own * between / own[0], swim.spread + least)


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
    """The discrepancy with which swims and draws agree. Each quantity is measured over predicted
    by least squares, with `FACTOR` as its prior; then the mean square of the errors, each over its
    variance, is 1. Nothing is left where the draws alone explain the errors."""
    usual = float(np.median([one.centre[0] for one in swims if np.isfinite(one.centre[0])] or [0]))
    sizes = np.array([size(one, usual) for one in swims])
    centre, measured, spread = (
        np.array([getattr(one, name) for one in swims]) for name in ("centre", "measured", "spread")
    )
    finite = np.where(np.isfinite(spread), sizes, np.nan)  # most draws diverged: it tells nothing
    drawn = np.moveaxis(np.array([one.predicted for one in swims]), 2, 0) / finite.T[:, :, None]
    own = np.array([own_share(one) if AHEAD[q] else 1.0 for q, one in enumerate(drawn)])
    columns = zip(centre.T, measured.T, (own * spread).T, sizes.T, own, strict=True)
    speed, distance, heading, turn_rate = (_deviation(*one) for one in columns)
    return Discrepancy(speed, distance, heading, turn_rate, len(swims), usual)


def own_share(drawn: Array) -> float:
    """Part of the draws' spread in what each draw predicts of each swim (s, n) that is left when
    every draw has its own factor: a draw that is 2 % slow is so in nearly every swim, and the
    factor of the check swims takes that away. A draw's factor for a swim is taken from the other
    swims, so one swim tells nothing."""
    drawn = drawn[~np.isnan(drawn).all(axis=1)]
    drawn = drawn[:, np.isfinite(drawn).all(axis=0)]
    if min(drawn.shape) < 2:
        return 1.0
    agree, square = drawn * drawn[:, :1], drawn**2
    factor = (agree.sum(axis=0) - agree) / (square.sum(axis=0) - square + 1e-18)
    left, before = (
        np.quantile(np.abs(one - np.median(one, axis=1, keepdims=True)), 0.68, axis=1)
        for one in (factor * drawn, drawn)
    )
    return float(min(np.median(left / (before + 1e-18)), 1.0))


def _deviation(own: Array, measured: Array, spread: Array, size: Array, share: float) -> Deviation:
    known = np.isfinite(own) & np.isfinite(measured) & np.isfinite(spread)
    if not known.any():
        return Deviation(np.nan, np.nan, np.nan, 0, float(share))
    own, measured, spread, size = (one[known] for one in (own, measured, spread, size))

    def fitted(left: float) -> tuple[float, float, float]:
        """The factor, its error, and the mean square of the errors in deviations, less 1."""
        weight = 1 / (spread**2 + (left * size) ** 2 + 1e-18)
        told, prior = float(weight @ own**2), FACTOR**-2
        factor = float((weight * own) @ measured + prior) / (told + prior)
        freedom = max(own.size - told / (told + prior), 0.5)
        surplus = float(weight @ (measured - factor * own) ** 2) / freedom - 1
        return factor, (told + prior) ** -0.5, surplus

    def surplus(left: float) -> float:
        return fitted(left)[2]

    left = 0.0
    if surplus(0.0) > 0:
        left = MOST if surplus(MOST) > 0 else float(brentq(surplus, 0.0, MOST))
    return Deviation(*fitted(left)[:2], left, own.size, float(share))


def bands(swim: Drawn, known: Discrepancy | None, share: float = 0.95) -> list[Band]:
    """The bands of one swim: Student's t, with as many degrees of freedom as swims told the
    quantity, less one. Left out are quantities that the recording does not tell, and those that no
    held-out swim told: the draws alone are too sure. Without anything `known` bands are of these
    alone."""
    factor, error, _, told, own = _columns(known)
    middle = factor * swim.centre
    whole = np.where(AHEAD, size(swim, known.usual if known else 0.0), swim.centre)
    apart = np.hypot(error, list(TRANSFER.values()) if known else 0.0) * whole
    deviation = np.sqrt((factor * own * swim.spread) ** 2 + noise(swim, known) ** 2 + apart**2)
    half = stats.t.ppf(0.5 + share / 2, np.maximum(told - 1, 1)) * deviation
    rows = (swim.measured, middle, middle - half, middle + half)
    return [
        Band(swim.run.name, name, unit, *row)
        for (name, unit), row in zip(UNITS.items(), np.array(rows).T.tolist(), strict=True)
        if np.isfinite(row[:2]).all()
    ]


def _columns(known: Discrepancy | None) -> Array:
    """Factors, their errors, what is left, numbers of swims, and shares of the draws (5, 4)."""
    if known is None:
        return np.outer([1.0, 0.0, 0.0, np.inf, 1.0], np.ones(len(UNITS)))
    return np.array([list(asdict(one).values()) for one in known.all]).T


def left_out(swims: Sequence[Drawn]) -> list[Band]:
    """The bands of held-out swims, each with the discrepancy of the others."""
    return [
        band
        for i, one in enumerate(swims)
        if len(swims) > 1
        for band in bands(one, discrepancy([*swims[:i], *swims[i + 1 :]]))
    ]


def noise(swim: Drawn, known: Discrepancy | None) -> Array:
    """Standard deviation (4,) of a swim about its draws; 0 where nothing is known or left."""
    left, sizes = _columns(known)[2], size(swim, known.usual if known else 0.0)
    return np.asarray(np.multiply(left, sizes, out=np.zeros(len(UNITS)), where=left > 0))


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
