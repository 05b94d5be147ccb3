"""Naive predictors of a swim's speed, path and body wave, to compare the twin with.

Like the twin, they are fitted on the fitted swims and tested on the held-out ones. Speed over the
beat's frequency: a line, a power law, or a constant stride. Path: the naive model of
`kinematic.py`. Body wave of a cruise: the mean of the fitted ones.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tailbeat.identify.predict import Prediction, marker_error, path_errors
from tailbeat.identify.runs import Run

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Compared:
    """One quantity on the held-out swims: the twin's error and each naive predictor's, in `unit`.

    Errors are: of the speed the mean absolute error, of the path the median position error as a
    fraction of its length, of the body wave the mean marker error.
    """

    quantity: str
    unit: str
    error: float
    naive: Mapping[str, float]

    @property
    def best(self) -> str:
        """The naive predictor with the smallest error."""
        return min(self.naive, key=lambda name: self.naive[name])

    @property
    def ratio(self) -> float:
        """The twin's error over the best naive predictor's; above 1 the twin is worse."""
        return self.error / max(self.naive[self.best], 1e-12)


def compare(
    fitted: Sequence[Prediction], held_out: Sequence[Prediction], rival: Sequence[Prediction]
) -> tuple[Compared, ...]:
    """Compare every quantity that these swims have. `rival`: predictions of `kinematic.py`."""
    found = (_speed(fitted, held_out), _path(held_out, rival), _body_wave(fitted, held_out))
    return tuple(one for one in found if one is not None)


def _speed(fitted: Sequence[Prediction], held_out: Sequence[Prediction]) -> Compared | None:
    known = [one.run.gait for one in fitted if np.isfinite(one.run.gait.frequency)]
    judged = [one for one in held_out if np.isfinite(one.run.gait.frequency)]
    if len(known) < 2 or not judged:
        return None
    laws = speed_laws(np.array([(gait.frequency, gait.speed) for gait in known]))
    beat = np.array([one.run.gait.frequency for one in judged])
    true = np.array([one.run.gait.speed for one in judged])
    own = float(np.mean([abs(one.gait.speed - one.run.gait.speed) for one in judged]))
    errors = {name: float(np.abs(law(beat) - true).mean()) for name, law in laws.items()}
    return Compared("speed", "m/s", own, errors)


def speed_laws(points: Array) -> dict[str, Callable[[Array], Array]]:
    """Laws of speed [m/s] over frequency [Hz], fitted to points (k, 2) of both: a constant stride;
    with two frequencies also a line; if all speeds are above 0 also a power law."""
    beat, speed = points.T
    stride = float(speed @ beat / (beat @ beat))
    laws: dict[str, Callable[[Array], Array]] = {"constant stride": lambda f: stride * f}
    if np.ptp(beat) > 1e-3 * beat.mean():
        line = np.polyfit(beat, speed, 1)
        laws["line"] = lambda f: np.asarray(np.polyval(line, f))
        if (speed > 0).all():
            power = np.polyfit(np.log(beat), np.log(speed), 1)
            laws["power law"] = lambda f: np.exp(np.polyval(power, np.log(f)))
    return laws


def _path(held_out: Sequence[Prediction], rival: Sequence[Prediction]) -> Compared | None:
    names = {one.run.name for one in rival}
    own = [path_errors(one).position_error_share for one in held_out if one.run.name in names]
    if not own:
        return None
    theirs = [path_errors(one).position_error_share for one in rival]
    error = float(np.median(np.abs(own)))
    return Compared("path", "1", error, {"five numbers": float(np.median(np.abs(theirs)))})


def _body_wave(fitted: Sequence[Prediction], held_out: Sequence[Prediction]) -> Compared | None:
    waves = [run.gait.wave for run in _cruises(fitted) if run.gait.wave is not None]
    judged = [one for one in held_out if one.run.motor is None and one.run.gait.wave is not None]
    if not waves or not judged:
        return None
    seen = np.isfinite(waves)
    total = np.where(seen, waves, 0).sum(axis=0)
    mean = np.where(seen.any(axis=0), total / np.maximum(seen.sum(axis=0), 1), np.nan)
    errors = [
        float(np.sqrt(np.nanmean(np.abs(mean - one.run.gait.wave) ** 2) / 2)) for one in judged
    ]
    own = float(np.mean([marker_error(one.run, one.gait, one.track) for one in judged]))
    return Compared("body wave", "m", own, {"mean of the fitted": float(np.mean(errors))})


def _cruises(found: Sequence[Prediction]) -> list[Run]:
    return [one.run for one in found if one.run.motor is None]
