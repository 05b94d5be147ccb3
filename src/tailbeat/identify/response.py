"""Frequency response of a driven shaft: H = T / Theta of every drive condition of a recording."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from tailbeat.files import BadInput
from tailbeat.recording import Recording, require

Array = NDArray[np.float64]
HARMONICS = 5  # fitted with the beat: Coulomb friction has the odd ones
FEWEST_BEATS = 2.0
STILL = 2e-3  # rad: a smaller stroke is little more than an encoder count, and no drive
HALF_TURN = np.pi  # rad: no tail's shaft turns as far
CLIPPED = 0.03  # fraction of the samples at exactly the same extreme
REST = "rest"  # conditions whose label begins so are skipped


@dataclass(frozen=True)
class Condition:
    """One drive condition: `frequency` [Hz], `amplitude` A [rad], `response` H [N m/rad], the
    standard `deviation` of its real and of its imaginary part (the same), and the number of
    `beats`."""

    recording: str
    label: str
    frequency: float
    amplitude: float
    response: complex
    deviation: float
    beats: float

    @property
    def omega(self) -> float:
        """Angular frequency [rad/s]."""
        return 2 * np.pi * self.frequency


def split(recording: Recording) -> list[tuple[Recording, str]]:
    """The drive conditions of a recording with their labels; those named `REST` are left out."""
    labels = recording.labels.get("condition", np.full(recording.time.size, ""))
    edges = [0, *(np.flatnonzero(labels[1:] != labels[:-1]) + 1), len(labels)]
    return [
        (_rows(recording, slice(first, last)), str(labels[first]))
        for first, last in pairwise(edges)
        if not str(labels[first]).startswith(REST)
    ]


def _rows(recording: Recording, part: slice) -> Recording:
    columns = {name: values[part] for name, values in recording.columns.items()}
    return Recording(recording.name, recording.time[part], columns, recording.meta)


def measure(recording: Recording, label: str = "") -> Condition:
    """Drive frequency and response of one condition, from `angle_rad` and `torque_nm`. Raises
    BadInput if a column is missing, clipped, in degrees or never moves, or for too few beats."""
    name = f"{recording.name}, condition {label}" if label else recording.name
    angle, torque = require(recording, ["angle_rad", "torque_nm"])
    check_angle(name, "angle_rad", angle, HALF_TURN)
    check_clipping(name, "torque_nm", torque)
    frequency = drive_frequency(recording.time, angle)
    beats = frequency * np.ptp(recording.time)
    if beats < FEWEST_BEATS or recording.time.size < 4 * beats:
        raise BadInput(
            f"{name}: {recording.time.size} samples over {beats:.1f} beats of {frequency:.3g} Hz;"
            f" record at least {FEWEST_BEATS:.0f} beats with 4 samples each."
        )
    theta, theta_deviation = project(recording.time, angle, frequency)
    tau, tau_deviation = project(recording.time, torque, frequency)
    response = tau / theta
    relative = np.hypot(tau_deviation / abs(tau), theta_deviation / abs(theta))
    return Condition(
        recording.name,
        label,
        frequency,
        abs(theta),
        response,
        float(abs(response) * relative),
        float(beats),
    )


def check_angle(name: str, column: str, angle: Array, most: float) -> None:
    """Raises BadInput for an angle that never moves, or whose range exceeds `most` [rad]: it is in
    degrees."""
    if np.ptp(angle) < STILL:
        raise BadInput(
            f"{name}: column {column} never moves ({np.ptp(angle):.2g} rad in all); check the"
            f" recording, or label the stretch {REST}."
        )
    if np.abs(angle - np.median(angle)).max() > most:
        raise BadInput(
            f"{name}: column {column} reaches {np.abs(angle).max():.3g}; a shaft turns less than"
            f" {most:.3g} rad here, so it looks like degrees: convert it to radians."
        )


def check_clipping(name: str, column: str, signal: Array) -> None:
    """Raises BadInput for a signal (k,) whose peaks are cut off at one value."""
    resolution = _resolution(signal)
    for extreme in (signal.max(), signal.min()):
        share = float(np.mean(signal == extreme))
        # the largest fraction of its time that a whole sine spends in its last count
        natural = np.arccos(max(1 - 2 * resolution / max(np.ptp(signal), 1e-300), -1.0)) / np.pi
        if signal.size >= 20 and share > max(CLIPPED, 1.1 * natural):
            raise BadInput(
                f"{name}: column {column} is clipped: {100 * share:.0f} % of its samples are"
                f" exactly {extreme:g}; drive less, or use a sensor with a wider range."
            )


def _resolution(signal: Array) -> float:
    """Smallest step between the signal's values: a count, or almost 0."""
    values = np.unique(signal)
    return float(np.diff(values).min()) if values.size > 1 else 0.0


def drive_frequency(time: Array, angle: Array) -> float:
    """Frequency [Hz] of the strongest line in a windowed angle (k,), over uneven times (k,) [s]."""
    span = np.ptp(time)
    even = np.linspace(time[0], time[-1], time.size)
    spectrum = np.abs(np.fft.rfft(np.hanning(time.size) * _detrended(even, time, angle)))
    coarse = (1 + int(np.argmax(spectrum[1:]))) / span
    window = _window(time)
    signal = angle - np.polyval(np.polyfit(time, angle, 1), time)

    def weakness(frequency: float) -> float:
        return -abs(np.sum(window * signal * np.exp(-2j * np.pi * frequency * time)))

    edges = (max(coarse - 1 / span, 0.3 / span), coarse + 1 / span)
    return float(minimize_scalar(weakness, bounds=edges, method="bounded").x)


def _detrended(even: Array, time: Array, signal: Array) -> Array:
    return np.interp(even, time, signal) - np.polyval(np.polyfit(time, signal, 1), even)


def _window(time: Array) -> Array:
    """Hann window times each sample's time step, so that uneven samples have the right weight."""
    phase = 2 * np.pi * (time - time[0]) / np.ptp(time)
    return np.asarray((1 - np.cos(phase)) / 2 * np.gradient(time))


def project(time: Array, signal: Array, frequency: float) -> tuple[complex, float]:
    """Complex amplitude c at a frequency [Hz], signal ~ Re(c exp(2 pi i f t)), and the standard
    deviation of each of its parts.

    Windowed least squares on drift (1, t, t^2) and the beat's harmonics. It is exact for uneven
    times and any number of beats; a plain projection would leak.
    """
    basis = _basis(time, frequency)
    root = np.sqrt(_window(time))[:, None]
    inverse = np.linalg.pinv(root * basis)
    fit = inverse @ (root[:, 0] * signal)
    weight = inverse * root.T  # the coefficients as sums over the signal's own samples
    noise = _noise_near(time, signal - basis @ fit, frequency)
    deviation = noise * np.sqrt(np.square(weight[3:5]).sum(axis=1).mean())
    return complex(fit[3], -fit[4]), float(deviation)


def _basis(time: Array, frequency: float) -> Array:
    """Columns 1, t, t^2, then cos, sin of the beat, then of its harmonics below Nyquist."""
    span = np.ptp(time)
    place = 2 * (time - time[0]) / span - 1
    highest = 0.4 * (time.size - 1) / span
    columns = [np.ones_like(time), place, place**2]
    for harmonic in range(1, HARMONICS + 1):
        if harmonic == 1 or harmonic * frequency < highest:
            angle = 2 * np.pi * harmonic * frequency * time
            columns += [np.cos(angle), np.sin(angle)]
    return np.stack(columns, axis=1)


def _noise_near(time: Array, rest: Array, frequency: float) -> float:
    """Standard deviation per sample of the residuals: near the beat, or over all, if larger.

    The noise of bearings and a load cell's drift is not white. The noise in the beat's bin is read
    from the bins beside it, outside the Hann window's main lobe.
    """
    window = _window(time)
    beside = frequency + np.array([-4.5, -3.5, -2.5, 2.5, 3.5, 4.5]) / np.ptp(time)
    lines = np.exp(-2j * np.pi * np.outer(beside[beside > 0.4 * frequency], time))
    power = np.square(np.abs(lines @ (window * rest))) / np.square(window).sum()
    freedom = max(time.size - 3 - 2 * HARMONICS, 1)
    return float(np.sqrt(max(power.mean(), np.square(rest).sum() / freedom)))
