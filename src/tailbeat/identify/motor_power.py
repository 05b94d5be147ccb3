"""The spectrum of the motor's motion: how much of its power is in which band."""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.signal import periodogram

Array = NDArray[np.float64]
Spectrum = tuple[Array, Array]  # frequencies [Hz], energy [rad^2/s] at each
CENTRAL = 0.9  # fraction of a recording's motor power; its range of frequencies counts as covered
HIGHEST = 12.0  # Hz; above it is noise
QUIET = 0.05  # rad/s rms: below it the motor counts as at rest


def spectra(rates: Iterable[Array], period: float) -> Iterator[Spectrum]:
    """Frequencies [Hz] up to 12 and the energy [rad^2/s] of motor rates (k,) [rad/s] at each.

    `period` [s] is the time between samples. A motor at rest is left out.
    """
    for rate in rates:
        if np.std(rate) < QUIET:
            continue
        frequency, density = periodogram(rate, 1 / period, window=("tukey", 0.25))
        kept = frequency < HIGHEST
        # Lines lie 1/T apart: power per Hz, summed as it is, is power times the time T.
        yield frequency[kept], density[kept]


def central(frequency: Array, energy: Array) -> tuple[float, float]:
    """Lowest and highest frequency [Hz] of the central fraction `CENTRAL` of the energy (k,), wider
    by half a spectral line at both ends."""
    below = np.cumsum(energy) / energy.sum()
    first, last = np.searchsorted(below, [(1 - CENTRAL) / 2, (1 + CENTRAL) / 2])
    half = (frequency[1] - frequency[0]) / 2
    return float(frequency[first] - half), float(frequency[last] + half)


def share(spectra: Sequence[Spectrum], low: float, high: float) -> float:
    """Fraction of the energy of all spectra from `low` to below `high` [Hz]; 0 if nothing moves."""
    inside = sum(float(e[(f >= low) & (f < high)].sum()) for f, e in spectra)
    return inside / max(sum(float(e.sum()) for _, e in spectra), 1e-12)
