"""How much of the tail's motion lies inside the identified band?

The twin is known to hold where it was identified and nowhere else. The certificate is the share of
the tail's velocity power below the band's edge; the edge comes from the identification recordings.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tailbeat.files import BadInput

Array = NDArray[np.float64]
HIGHEST = 12.0  # Hz: beyond three times the paper's edge a servo does not get
SECONDS = 4.0  # of the robot's running estimate
QUIET = 0.05  # rad/s rms: below, there is no beat to judge


@dataclass(frozen=True)
class Spectrum:
    """Power density (k,) of an angle's rate [(rad/s)^2/Hz] over frequency (k,) [Hz]."""

    frequency: Array
    power: Array

    def share_below(self, edge: float) -> float:
        """Share of the power below `edge` [Hz]; NaN where nothing moves."""
        total = self.power.sum()
        return (
            float(self.power[self.frequency <= edge].sum() / total) if total > 0 else float("nan")
        )


def velocity_spectrum(time: Array, angle: Array, highest: float = HIGHEST) -> Spectrum:
    """Spectrum of the rate of an unevenly sampled angle [rad], by windowed sums over the samples.

    Each sample counts for its share of the time, under a Hann window; the angle's lines are
    multiplied by (2 pi f)^2, so counts are not differentiated. Resolution is 1 / duration; the
    highest frequency is what the samples' mean rate allows, or `highest`.
    """
    if time.size < 8 or np.any(np.diff(time) <= 0):
        raise BadInput(f"{time.size} samples; a spectrum needs 8 whose times rise.")
    span = time[-1] - time[0]
    top = min(highest, 0.45 * (time.size - 1) / span)
    frequency = np.arange(1, max(int(top * span), 1) + 1) / span
    phase = 2 * np.pi * (time - time[0]) / span
    window = (1 - np.cos(phase)) / 2 * np.gradient(time)
    trend = np.polynomial.polynomial.polyfit(time - time[0], angle, 1, w=np.sqrt(window + 1e-12))
    still = angle - np.polynomial.polynomial.polyval(time - time[0], trend)
    waves = np.exp(-2j * np.pi * np.outer(frequency, time - time[0]))
    # Not `@`: the robot's loop asks for this, and a library's threads wait 100 ms for each other
    # where another process has a core.
    lines = (waves * (window * still)).sum(axis=1)
    power = 2 * np.square(np.abs(lines) * 2 * np.pi * frequency) / np.square(window).sum()
    return Spectrum(frequency, power * np.median(np.gradient(time)))


def share_below(time: Array, angle: Array, edge: float) -> float:
    """Share of an angle's velocity power below `edge` [Hz]."""
    return velocity_spectrum(time, angle).share_below(edge)


def edge_of(recordings: Sequence[tuple[Array, Array]], share: float = 0.9) -> float:
    """Upper edge [Hz] of the band that recordings (time, angle) cover: the frequency below which
    `share` of each one's velocity power lies, of the one that reaches furthest."""
    edges = []
    for time, angle in recordings:
        spectrum = velocity_spectrum(time, angle)
        below = np.cumsum(spectrum.power) / spectrum.power.sum()
        edges.append(float(spectrum.frequency[np.searchsorted(below, share)]))
    if not edges:
        raise BadInput("no recordings; the band comes from those the twin was identified on.")
    return max(edges)


@dataclass(eq=False)
class Monitor:
    """The running share over the last four seconds, for the robot; `edge` [Hz]."""

    edge: float
    seconds: float = SECONDS
    samples: deque[tuple[float, float]] = field(default_factory=deque)

    def add(self, time: float, angle: float) -> None:
        """Take one sample; what is older than `seconds` is forgotten."""
        self.samples.append((time, angle))
        while self.samples[-1][0] - self.samples[0][0] > self.seconds:
            self.samples.popleft()

    def share(self) -> float | None:
        """Share of velocity power below the edge; None before half the time is full, or at rest."""
        time, angle = np.array(self.samples).reshape(-1, 2).T
        if time.size < 8 or time[-1] - time[0] < self.seconds / 2:
            return None
        if np.std(np.gradient(angle, time)) < QUIET:
            return None
        return share_below(time, angle, self.edge)
