"""A naive model to compare the twin with: five numbers that give a path from the motor's angle.

It has no body and no water. The smoothed power of the shaft's rate gives the speed; the smoothed
angle gives the turn rate. A twin that is not better than this model has not identified the fish.

    speed = gain (smooth_1(rate^2))^exponent,  turn rate = turn smooth_2(angle)
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares
from scipy.signal import lfilter

from tailbeat.files import BadInput
from tailbeat.identify.gait import Track
from tailbeat.identify.predict import PathErrors, Prediction, marker_error, path_errors
from tailbeat.identify.runs import Run

Array = NDArray[np.float64]
STEP = 0.02  # s
YAW = 0.7  # m/rad: a heading error of 0.014 rad counts as 0.01 m, as in the twin's fit
GUESS = (0.1, 0.5, 0.5, -0.5, 0.5)
LOW, HIGH = (0.0, 0.05, 0.02, -10.0, 0.02), (2.0, 2.0, 20.0, 10.0, 5.0)


@dataclass(frozen=True)
class Kinematic:
    """The five numbers: speed `gain` [m/s at 1 rad^2/s^2], `exponent` and `speed_lag` [s]; turn
    rate per angle, `turn` [1/s], and `turn_lag` [s]."""

    gain: float
    exponent: float
    speed_lag: float
    turn: float
    turn_lag: float


def fit_kinematic(runs: Sequence[Run]) -> Kinematic:
    """Fit the five numbers by least squares to the poses of the runs that are `replayable`. At
    least one must be (not checked)."""
    made = [_resampled(run) for run in runs if replayable(run)]

    def residuals(numbers: Array) -> Array:
        model = Kinematic(*numbers)
        return np.concatenate([_errors(model, *one).ravel() for one in made])

    found = least_squares(residuals, GUESS, bounds=(LOW, HIGH), loss="soft_l1", f_scale=0.1)
    return Kinematic(*map(float, found.x))


def _resampled(run: Run) -> tuple[Array, Array]:
    """Motor angle (k,) and pose (k, 3) every `STEP`."""
    assert run.motor is not None
    time = run.track.time - run.track.time[0]
    when = np.arange(0, time[-1], STEP)
    return CubicSpline(time, run.motor)(when), CubicSpline(time, run.track.pose)(when)


def _errors(model: Kinematic, angle: Array, pose: Array) -> Array:
    scale = np.array([1.0, 1.0, YAW]) / np.sqrt(len(angle))
    return np.asarray(np.nan_to_num((path(model, angle, pose[0]) - pose) * scale, nan=10.0))


def path(model: Kinematic, angle: Array, start: Array) -> Array:
    """Poses (k, 3) x, y [m], yaw [rad] from motor angles (k,) [rad] every `STEP`, and the first
    pose `start` (3,)."""
    rate = np.gradient(angle, STEP)
    power = _smooth(np.square(rate), model.speed_lag)
    speed = model.gain * np.maximum(power, 1e-12) ** model.exponent
    turned = np.cumsum(model.turn * _smooth(angle, model.turn_lag)) * STEP
    yaw = start[2] + np.concatenate([[0.0], turned[:-1]])
    moved = np.stack([speed * np.cos(yaw), speed * np.sin(yaw)], axis=1) * STEP
    place = start[:2] + np.concatenate([np.zeros((1, 2)), np.cumsum(moved, axis=0)[:-1]])
    return np.concatenate([place, yaw[:, None]], axis=1)


def _smooth(values: Array, lag: float) -> Array:
    """First-order low pass from rest."""
    keep = np.exp(-STEP / lag)
    return np.asarray(lfilter([1 - keep], [1, -keep], values))


def predict_kinematic(model: Kinematic, runs: Sequence[Run]) -> list[Prediction]:
    """Predict the runs that are `replayable`, in the same form as `predict` for a twin."""
    return [_predicted(model, run) for run in runs if replayable(run)]


def replayable(run: Run) -> bool:
    """Whether a run has what the naive model needs: a motor angle and a heading."""
    return run.motor is not None and run.track.has_heading


def _predicted(model: Kinematic, run: Run) -> Prediction:
    angle, pose = _resampled(run)
    time = np.asarray(STEP * np.arange(len(angle)), dtype=np.float64)
    track = Track(time, path(model, angle, pose[0]))
    gait = replace(run.gait, speed=float("nan"))
    return Prediction(run, gait, track, marker_error(run, gait, track), True)


def errors_row(prediction: Prediction) -> dict[str, Any]:
    """The JSON of the model's errors on one swim."""
    return {"recording": prediction.run.name, **asdict(path_errors(prediction))}


@dataclass(frozen=True, eq=False)
class Rival:
    """The naive model's predictions of the runs that are `replayable`. Medians over these runs, of
    the twin and of the naive model: position error as a fraction of the path length, and size of
    the heading error [deg]. `twin_better_share`: fraction of the runs on which the twin's position
    error is smaller."""

    naive: tuple[Prediction, ...]
    median_position_error_share: float
    median_heading_error_deg: float
    naive_median_position_error_share: float
    naive_median_heading_error_deg: float
    twin_better_share: float


def beside(twin: Sequence[Prediction], fitted_on: Sequence[Run]) -> Rival:
    """Compare the twin's predictions with the naive model, fitted on `fitted_on`.

    Raises BadInput if no run has both a motor angle and a heading.
    """
    known = [one for one in twin if replayable(one.run)]
    if not any(map(replayable, fitted_on)) or not known:
        raise BadInput(
            "--fitted-on: the naive model needs swims with motor_angle_rad and yaw_rad, to fit and"
            " to predict; give such recordings."
        )
    naive = predict_kinematic(fit_kinematic(fitted_on), [one.run for one in known])
    ours, theirs = ([path_errors(one) for one in group] for group in (known, naive))
    better = [
        a.position_error_share < b.position_error_share for a, b in zip(ours, theirs, strict=True)
    ]
    return Rival(tuple(naive), *_medians(ours), *_medians(theirs), float(np.mean(better)))


def _medians(errors: Sequence[PathErrors]) -> tuple[float, float]:
    shares = [abs(one.position_error_share) for one in errors]
    return float(np.median(shares)), float(
        np.median([abs(one.heading_error_deg) for one in errors])
    )


def as_json(rival: Rival) -> dict[str, Any]:
    """What `tailbeat predict --fitted-on` adds to its result."""
    medians = {name: value for name, value in vars(rival).items() if name != "naive"}
    return {"naive": [errors_row(one) for one in rival.naive], **medians}
