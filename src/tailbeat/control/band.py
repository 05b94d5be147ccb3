"""How much of the tail's motion lies below, inside and above the identified band?

The twin is identified inside the band only. The measure is the fraction of the tail's velocity
power below, inside and above the band. The band is `band` [Hz] of the fish's description, set by
its author.
"""

from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tailbeat.files import BadInput

Array = NDArray[np.float64]
HIGHEST = 12.0  # Hz: three times the paper's edge; no servo here moves faster
SECONDS = 4.0  # of the robot's running estimate
PERIODS = 3  # of the lower edge that a piece must last; in a shorter one slow motion looks fast
QUIET = 0.05  # rad/s rms: below it the tail counts as at rest


@dataclass(frozen=True)
class Shares:
    """Fractions of the velocity power below, inside and above a band; both edges count as inside.
    They add up to 1. All are NaN if nothing moves. `below` and `inside` are NaN if the piece is too
    short to separate them."""

    below: float
    inside: float
    above: float


@dataclass(frozen=True)
class Spectrum:
    """Power density (k,) of an angle's rate [(rad/s)^2/Hz] over frequency (k,) [Hz]."""

    frequency: Array
    power: Array

    def share_below(self, edge: float) -> float:
        """Fraction of the power at or below `edge` [Hz]; NaN if nothing moves."""
        total = self.power.sum()
        return (
            float(self.power[self.frequency <= edge].sum() / total) if total > 0 else float("nan")
        )

    def shares(self, band: tuple[float, float]) -> Shares:
        """Fractions of the power below, inside and above a band (lower, upper edge) [Hz]."""
        powers = self.powers(band)
        total, unknown = powers.sum(), float("nan")
        if not total > 0:
            return Shares(unknown, unknown, unknown)
        below, inside, above = (powers / total).tolist()
        if not self.resolves(band[0]):
            below = inside = unknown
        return Shares(below, inside, above)

    def resolves(self, edge: float) -> bool:
        """Whether the piece lasts `PERIODS` periods of `edge` [Hz], so that it can show slower
        motion."""
        return edge <= 0 or bool(self.frequency[0] * PERIODS <= edge)

    def powers(self, band: tuple[float, float]) -> Array:
        """Sums (3,) of the power below, inside and above a band (lower, upper edge) [Hz]."""
        under, over = self.frequency < band[0], self.frequency > band[1]
        return np.array([self.power[part].sum() for part in (under, ~under & ~over, over)])


def velocity_spectrum(time: Array, angle: Array, highest: float = HIGHEST) -> Spectrum:
    """Spectrum of the rate of an unevenly sampled angle (n,) [rad] at `time` (n,) [s].

    It is a sum over the samples, each weighted by its time step and a Hann window. The angle's
    spectrum is multiplied by (2 pi f)^2, so encoder counts are not differentiated. Resolution is
    1 / duration. The highest frequency is 0.45 times the mean sampling rate, or `highest` [Hz] if
    that is lower. Raises BadInput for fewer than 8 samples or times that do not rise.
    """
    if time.size < 8 or np.any(np.diff(time) <= 0):
        raise BadInput(f"{time.size} samples; a spectrum needs 8 or more, with rising times.")
    clock = time - time[0]
    span = clock[-1]
    top = min(highest, 0.45 * (time.size - 1) / span)
    frequency = np.arange(1, max(int(top * span), 1) + 1) / span
    phase, steps = 2 * np.pi * clock / span, np.gradient(time)
    window = (1 - np.cos(phase)) / 2 * steps
    # Not `@`: the robot's loop calls this. Threads of a linear algebra library wait up to 100 ms
    # for each other if another process uses a core.
    moved = window * _without_trend(clock, angle, window)
    lines = (_waves(phase, frequency.size) * moved).sum(axis=1)
    power = 2 * np.square(np.abs(lines) * 2 * np.pi * frequency) / np.square(window).sum()
    return Spectrum(frequency, power * np.median(steps))


def _waves(phase: Array, count: int) -> NDArray[np.complex128]:
    """exp(-i k phase) (count, n) for k from 1. Rows are products of earlier rows, because the
    robot's loop has no time for as many exponentials. Relative error below 1e-12 to k = 1000."""
    waves = np.empty((count, phase.size), dtype=complex)
    waves[0] = np.exp(-1j * phase)
    done = 1
    while done < count:
        more = min(done, count - done)
        np.multiply(waves[:more], waves[done - 1], out=waves[done : done + more])
        done += more
    return waves


def _without_trend(clock: Array, angle: Array, weight: Array) -> Array:
    """The angle without its straight line, fitted with weights (n,)."""
    total = weight.sum()
    centred = clock - (weight * clock).sum() / total
    slope = (weight * centred * angle).sum() / (weight * np.square(centred)).sum()
    return np.asarray(angle - (weight * angle).sum() / total - slope * centred)


def share_below(time: Array, angle: Array, edge: float) -> float:
    """Fraction of an angle's velocity power at or below `edge` [Hz]. Raises BadInput as
    `velocity_spectrum` does."""
    return velocity_spectrum(time, angle).share_below(edge)


@dataclass(eq=False)
class Monitor:
    """Fractions of the velocity power over the last `seconds`, for the robot. `edge` and `floor`
    [Hz] are the band's upper and lower edge."""

    edge: float
    seconds: float = SECONDS
    floor: float = 0.0
    samples: deque[tuple[float, float]] = field(default_factory=deque)

    def add(self, time: float, angle: float) -> None:
        """Add a sample, `angle` [rad] at `time` [s], and drop samples older than `seconds`."""
        self.samples.append((time, angle))
        while self.samples[-1][0] - self.samples[0][0] > self.seconds:
            self.samples.popleft()

    def share(self) -> float | None:
        """Fraction of the velocity power at or below the upper edge; None at rest, or before half
        of `seconds` is recorded."""
        found = self.spectrum()
        return None if found is None else found.share_below(self.edge)

    def shares(self) -> Shares | None:
        """Fractions below, inside and above the band; None where `share` is."""
        found = self.spectrum()
        return None if found is None else found.shares((self.floor, self.edge))

    def spectrum(self) -> Spectrum | None:
        """Spectrum of the last `seconds`; None at rest, or before half of them is recorded."""
        time, angle = np.array(self.samples).reshape(-1, 2).T
        if time.size < 8 or time[-1] - time[0] < self.seconds / 2:
            return None
        if np.std(np.gradient(angle, time)) < QUIET:
            return None
        return velocity_spectrum(time, angle)
