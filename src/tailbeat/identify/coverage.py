"""Do the recordings of an identification cover what a policy does?

A twin is validated only where it was recorded. Each quantity of the swims is compared with the
range of the recordings; what lies outside should be recorded next. The fraction of the recordings
outside their own range is subtracted, so recordings always cover themselves.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tailbeat.files import BadInput
from tailbeat.fish.description import Fish
from tailbeat.fish.period import PERIOD
from tailbeat.identify.clean import clean_swim
from tailbeat.identify.gait import Track, distance
from tailbeat.identify.glitches import Glitch
from tailbeat.identify.motor_power import HIGHEST, Spectrum, central, share, spectra
from tailbeat.identify.runs import check_motor
from tailbeat.recording import Recording, uniform

Array = NDArray[np.float64]
AVERAGE = 1.0  # s over which speed and yaw rate are averaged, to remove the sway of a beat
PERCENTILES = (0.5, 99.5)  # between them lies the recorded range
BANDS = (0.0, 0.5, 1.0, 2.0, 3.0, 4.0, 6.0, HIGHEST)  # Hz, edges of the table
BINS = 40  # of the histograms that are overlapped
LIMIT = 0.05  # fraction outside above which a quantity is not covered


@dataclass(frozen=True)
class Term:
    """A quantity's name and unit, and what to record if swims exceed either end of the range. In
    these texts `edge` is that end and `swims` the fraction beyond it."""

    name: str
    unit: str
    below: str
    above: str


POWER = Term(
    "motor power",
    "Hz",
    "swims below {edge:.2g} Hz: {swims} of the motor's power is there",
    "swims above {edge:.2g} Hz: {swims} of the motor's power is there",
)
SPEED = Term(
    "speed",
    "m/s",
    "slower or backward swims: {swims} of the time the speed is below {edge:.3f} m/s",
    "faster swims: {swims} of the time the speed is above {edge:.3f} m/s",
)
YAW_RATE = Term(
    "yaw rate",
    "rad/s",
    "turns to the right: {swims} of the time the yaw rate is below {edge:.2f} rad/s",
    "turns to the left: {swims} of the time the yaw rate is above {edge:.2f} rad/s",
)
ANGLE = Term(
    "motor angle",
    "rad",
    "larger motor angles to the right: {swims} of the time the angle is below {edge:.2f} rad",
    "larger motor angles to the left: {swims} of the time the angle is above {edge:.2f} rad",
)
RATE = Term(
    "motor rate",
    "rad/s",
    "faster strokes to the right: {swims} of the time the motor's rate is below {edge:.1f} rad/s",
    "faster strokes to the left: {swims} of the time the motor's rate is above {edge:.1f} rad/s",
)


@dataclass(frozen=True)
class Quantity:
    """One quantity's recorded range [its unit], and the fractions of time beyond either end. Of
    the motor's power they are fractions of power.

    `below` and `above` are of the swims, `own_below` and `own_above` of the recordings. `overlap`
    is the common area of the two normalised histograms, 1 if they are equal.
    """

    term: Term
    low: float
    high: float
    below: float
    above: float
    own_below: float
    own_above: float
    overlap: float

    @property
    def outside(self) -> float:
        """Fraction of the swims outside the range, less the recordings' own."""
        return max(self.below - self.own_below, 0.0) + max(self.above - self.own_above, 0.0)

    @property
    def covered(self) -> bool:
        """Whether at most `LIMIT` lies outside."""
        return self.outside <= LIMIT


@dataclass(frozen=True)
class Band:
    """Fractions of the motor's power between two frequencies [Hz]."""

    low: float
    high: float
    swims: float
    recordings: float


@dataclass(frozen=True)
class Coverage:
    """The compared quantities; `missing` says which could not be compared, and why; `glitches` of
    swims and recordings were left out."""

    quantities: tuple[Quantity, ...]
    bands: tuple[Band, ...]
    missing: tuple[str, ...]
    glitches: tuple[Glitch, ...] = ()

    @property
    def covered(self) -> bool:
        """Whether the recordings cover every compared quantity."""
        return all(one.covered for one in self.quantities)

    @property
    def advice(self) -> list[str]:
        """What to record next, one sentence each; empty if everything is covered."""
        return [line for one in self.quantities if not one.covered for line in _advice(one)]


def _advice(one: Quantity) -> Iterator[str]:
    """What to record for one quantity, the less covered end first."""
    ends = (
        (one.term.below, one.low, one.below, one.own_below),
        (one.term.above, one.high, one.above, one.own_above),
    )
    for text, edge, swims, own in sorted(ends, key=lambda end: end[3] - end[2]):
        if swims - own > LIMIT / 2:
            said = text.format(edge=edge, swims=_percent(swims))
            yield f"record {said}, the recordings have {_percent(own)}"


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def coverage(swims: Sequence[Recording], recordings: Sequence[Recording], fish: Fish) -> Coverage:
    """Compare a policy's swims with the recordings that a fish was identified on.

    Both need `motor_angle_rad`. Yaw rate needs `yaw_rad`; speed also needs `x_m` and `y_m`. Without
    their glitches, since one jump of an angle is a motor rate that nothing swims. Raises BadInput
    for a recording that lacks the motor's angle, is too short, or exceeds the motor's range, and if
    the motor never moves.
    """
    for one in (*swims, *recordings):
        _check(one)
    for one in recordings:  # angles in degrees would make every swim look covered
        check_motor(one, fish, one.columns["motor_angle_rad"], most=0.1)
    cleaned = [clean_swim(one) for one in (*swims, *recordings)]
    for one, _ in cleaned[len(swims) :]:
        check_motor(one, fish, one.columns["motor_angle_rad"])
    kept = [uniform(one, PERIOD) for one, _ in cleaned]
    played, recorded = kept[: len(swims)], kept[len(swims) :]
    found, missing = [_power(played, recorded, fish)], []
    for term, measure in MEASURES:
        a, b = _pooled(played, measure, fish), _pooled(recorded, measure, fish)
        if a is None or b is None:
            side = "swims" if a is None else "recordings"
            missing.append(f"{term.name} is not compared: no columns for it in the {side}")
        else:
            found.append(_compared(term, a, b))
    glitches = tuple(glitch for _, some in cleaned for glitch in some)
    return Coverage(tuple(found), _bands(played, recorded, fish), tuple(missing), glitches)


def _check(recording: Recording) -> None:
    if "motor_angle_rad" not in recording.columns:
        raise BadInput(
            f"{recording.name}: column motor_angle_rad is missing; coverage compares the motor's"
            f" motion, so give recordings of its angle."
        )
    if recording.time[-1] - recording.time[0] < AVERAGE:
        raise BadInput(
            f"{recording.name}: lasts {recording.time[-1] - recording.time[0]:.2f} s; coverage"
            f" needs {AVERAGE:g} s or more. Leave this one out."
        )


# ---- quantities over time -----------------------------------------------------------------------


def _angle(recording: Recording, fish: Fish) -> Array:
    """The motor's angle [rad]; the sine of a crank's, because a crank turns without end."""
    angle = np.asarray(recording.columns["motor_angle_rad"])
    return np.sin(angle) if fish.motor.kind == "crank" else angle


def _rate(recording: Recording, fish: Fish) -> Array:
    return np.asarray(np.diff(_angle(recording, fish)) / PERIOD)


def _yaw_rate(recording: Recording, fish: Fish) -> Array | None:
    yaw = recording.columns.get("yaw_rad")
    return None if yaw is None else _averaged_rate(yaw)


def _speed(recording: Recording, fish: Fish) -> Array | None:
    names = ("x_m", "y_m", "yaw_rad")
    if not recording.columns.keys() >= set(names):
        return None
    pose = np.stack([recording.columns[name] for name in names], axis=1)
    return _averaged_rate(distance(Track(recording.time, pose)))


def _averaged_rate(values: Array) -> Array:
    """Mean rate over every interval of `AVERAGE` seconds."""
    step = min(round(AVERAGE / PERIOD), values.size - 1)
    return np.asarray((values[step:] - values[:-step]) / (step * PERIOD))


Measure = Callable[[Recording, Fish], Array | None]
MEASURES: tuple[tuple[Term, Measure], ...] = (
    (SPEED, _speed),
    (YAW_RATE, _yaw_rate),
    (ANGLE, _angle),
    (RATE, _rate),
)


def _pooled(recordings: Sequence[Recording], measure: Measure, fish: Fish) -> Array | None:
    found = [values for one in recordings if (values := measure(one, fish)) is not None]
    return np.concatenate(found) if found else None


def _compared(term: Term, swims: Array, recorded: Array) -> Quantity:
    low, high = (float(edge) for edge in np.percentile(recorded, PERCENTILES))
    shares = [float(s) for v in (swims, recorded) for s in ((v < low).mean(), (v > high).mean())]
    below, above, own_below, own_above = shares
    edges = np.histogram_bin_edges(np.concatenate([swims, recorded]), BINS)
    a, b = (np.histogram(v, edges)[0] / v.size for v in (swims, recorded))
    return Quantity(term, low, high, below, above, own_below, own_above, _overlap(a, b))


def _overlap(a: Array, b: Array) -> float:
    return float(np.minimum(a, b).sum())


# ---- frequencies --------------------------------------------------------------------------------


def _power(swims: Sequence[Recording], recorded: Sequence[Recording], fish: Fish) -> Quantity:
    """The motor's power. The covered range goes from the lowest to the highest frequency of the
    central 90 % of any recording's power."""
    played, known = _spectra(swims, fish), _spectra(recorded, fish)
    if not known:
        raise BadInput(
            "The motor never moves in any recording; give those the fish was identified on."
        )
    edges = [central(frequency, energy) for frequency, energy in known]
    low, high = min(edge[0] for edge in edges), max(edge[1] for edge in edges)
    shares = [
        share(group, start, stop)
        for group in (played, known)
        for start, stop in ((0.0, low), (high, BANDS[-1]))
    ]
    fine = np.linspace(0, BANDS[-1], BINS + 1)
    a, b = (np.array([share(group, *edge) for edge in pairwise(fine)]) for group in (played, known))
    below, above, own_below, own_above = shares
    return Quantity(POWER, low, high, below, above, own_below, own_above, _overlap(a, b))


def _spectra(recordings: Sequence[Recording], fish: Fish) -> list[Spectrum]:
    return list(spectra((_rate(one, fish) for one in recordings), PERIOD))


def _bands(
    swims: Sequence[Recording], recorded: Sequence[Recording], fish: Fish
) -> tuple[Band, ...]:
    played, known = _spectra(swims, fish), _spectra(recorded, fish)
    return tuple(
        Band(low, high, share(played, low, high), share(known, low, high))
        for low, high in pairwise(BANDS)
    )
