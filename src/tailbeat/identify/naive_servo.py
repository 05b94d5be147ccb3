"""Two naive predictors of a shaft's angle. A fit that is not better has not identified the servo.

    lag:      time angle' = command(t - delay) / (1 + yield / r) - angle
    gravity:  time angle' = command(t - delay) - angle - sag / r load sin(angle)

r is the gain register over the middle one, load a pendulum's m g l or a tail's stiffness. There is
no inertia, no force limit and no friction. With torque off, the shaft of the second sinks; the
first ignores it. Both are fitted to the same recordings as the servo, and measured alike.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.optimize import least_squares

from tailbeat.identify.shaft import Bench

Array = NDArray[np.float64]
THINNED = 500  # samples of a recording that are compared, about
SCALE = 0.05  # rad: a larger misfit counts linearly (soft L1), as in a mean absolute error
# Yield [1] or sag [1/(N m)], time and delay [s]: where the fits start, and their ranges.
STARTS = ((0.1, 0.05, 0.01), (1.0, 0.2, 0.05))
LOW, HIGH = (0.0, 1e-3, 0.0), (20.0, 2.0, 0.2)


@dataclass(frozen=True)
class Naive:
    """A fitted predictor: `name` lag or gravity, its three numbers (`first` is yield [1] or sag
    [1/(N m)], `time` and `delay` [s]), and mean absolute angle errors [deg] (None without held-out
    recordings)."""

    name: str
    first: float
    time: float
    delay: float
    fit_mae_deg: float
    validate_mae_deg: float | None

    @property
    def judged_mae_deg(self) -> float:
        """The error on held-out recordings if any, else on the fitted [deg]."""
        return self.fit_mae_deg if self.validate_mae_deg is None else self.validate_mae_deg


def naive_servos(fit: Sequence[Bench], validate: Sequence[Bench]) -> tuple[Naive, ...]:
    """Both predictors, fitted on `fit`, with their errors on `fit` and on `validate`."""
    return tuple(_fitted(name, fit, validate) for name in ("lag", "gravity"))


def _fitted(name: str, fit: Sequence[Bench], validate: Sequence[Bench]) -> Naive:
    register = _register([*fit, *validate])

    def residuals(numbers: Array) -> Array:
        return np.concatenate([_error(name, numbers, b, register)[:: _every(b)] for b in fit])

    tries = [
        least_squares(residuals, s, bounds=(LOW, HIGH), loss="soft_l1", f_scale=SCALE, x_scale=s)
        for s in STARTS
    ]
    best = min(tries, key=lambda one: float(one.cost)).x
    errors = [
        [float(np.degrees(np.abs(_error(name, best, b, register)).mean())) for b in group]
        for group in (fit, validate)
    ]
    held_out = float(np.mean(errors[1])) if validate else None
    first, lag, delay = map(float, best)
    return Naive(name, first, lag, delay, float(np.mean(errors[0])), held_out)


def _register(benches: Sequence[Bench]) -> float:
    """The middle gain register, 1 if none is stated. Sag is per N m at this gain."""
    gains = [bench.gain for bench in benches if bench.gain is not None]
    return float(np.median(gains)) if gains else 1.0


def _every(bench: Bench) -> int:
    return max(bench.time.size // THINNED, 1)


def _error(name: str, numbers: Array, bench: Bench, register: float) -> Array:
    """Angle error (k,) [rad] of the good samples."""
    first, lag, delay = numbers
    stiff = (bench.gain or register) / register
    pull = bench.load.weight or bench.load.stiffness
    gain, sag = (1 / (1 + first / stiff), 0.0) if name == "lag" else (1.0, first * pull / stiff)
    # Linear between samples: the fit needs a derivative with respect to the delay.
    command = np.interp(bench.time - delay, bench.time, bench.command)
    on = np.ones(command.size) if name == "lag" else bench.enabled
    angle = _follow(bench.time, gain * command, on > 0.5, bench.angle[0], lag, sag)
    return np.asarray((angle - bench.angle)[bench.good])


@njit(cache=True)
def _follow(time, command, enabled, start, lag, sag):  # type: ignore[no-untyped-def]
    """The angle (k,) [rad], exact between samples if the command is constant there."""
    angle = np.empty(time.size)
    angle[0] = start
    for i in range(1, time.size):
        keep = np.exp(-(time[i] - time[i - 1]) / lag)
        now = angle[i - 1]
        goal = (command[i - 1] if enabled[i - 1] else now) - sag * np.sin(now)
        angle[i] = goal + (now - goal) * keep
    return angle
