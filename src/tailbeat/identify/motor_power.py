"""The motor's power over frequency: how much of its motion lies in which band."""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.signal import periodogram

Array = NDArray[np.float64]
Spectrum = tuple[Array, Array]  # frequencies [Hz], energy [rad^2/s] at each
CENTRAL = 0.9  # of each recording's motor power, between whose frequencies it counts as covered
HIGHEST = 12.0  # Hz; beyond is noise
QUIET = 0.05  # rad/s rms: below, there is no motion to take frequencies from


def spectra(rates: Iterable[Array], period: float) -> Iterator[Spectrum]:
    """Frequencies [Hz] up to 12 and the energy [rad^2/s] of motor rates (k,) [rad/s] at each.

    `period` [s] lies between samples; a motor that stands still is left out.
    """
    for rate in rates:
        if np.std(rate) < QUIET:
            continue
        frequency, density = periodogram(rate, 1 / period, window=("tukey", 0.25))
        kept = frequency < HIGHEST
        # Lines lie 1/T apart: power per Hz, summed as it is, is power times the time T.
        yield frequency[kept], density[kept]


def central(frequency: Array, energy: Array) -> tuple[float, float]:
    """Frequencies [Hz] between which `CENTRAL` of the energy lies, half a spectral line added."""
    below = np.cumsum(energy) / energy.sum()
    first, last = np.searchsorted(below, [(1 - CENTRAL) / 2, (1 + CENTRAL) / 2])
    half = (frequency[1] - frequency[0]) / 2
    return float(frequency[first] - half), float(frequency[last] + half)


def share(spectra: Sequence[Spectrum], low: float, high: float) -> float:
    """Share of the energy of all spectra from `low` to below `high` [Hz]; 0 where nothing moves."""
    inside = sum(float(e[(f >= low) & (f < high)].sum()) for f, e in spectra)
    return inside / max(sum(float(e.sum()) for _, e in spectra), 1e-12)
