"""Measure one swim: beat frequency, speed, stride, Strouhal number and body wave.

The same functions read a recording and a twin's run, so that both are measured alike.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from tailbeat.files import BadInput

Array = NDArray[np.float64]
MINIMUM_BEATS = 2.0
EDGE = 0.03  # a beat driven at the band's edge may be measured a little beyond it
STEADY = 0.5  # fraction of the rate's variance that one sine must explain to be a beat, chosen


@dataclass(frozen=True, eq=False)
class Track:
    """A swim seen from above: `time` (k,) [s], `pose` (k, 3) of the tracked point: x, y [m] and yaw
    [rad], unwrapped.

    `markers` (k, m, 2) [m] are in the world, NaN where unseen, or None. `tip` is the index of the
    marker nearest the fin's rear edge. Without a recorded heading every yaw is NaN.
    """

    time: Array
    pose: Array
    markers: Array | None = None
    tip: int = -1

    @property
    def has_heading(self) -> bool:
        """Whether the yaw was recorded."""
        return bool(np.isfinite(self.pose[0, 2]))

    def cut(self, start: int, stop: int) -> "Track":
        """The samples from index `start` up to, not including, `stop`."""
        part = slice(start, stop)
        markers = None if self.markers is None else self.markers[part]
        return Track(self.time[part], self.pose[part], markers, self.tip)


@dataclass(frozen=True, eq=False)
class Gait:
    """Numbers of one steady swim.

    `frequency` [Hz] is the beat's. `speed` is the mean over whole beats of the tracked point's
    velocity along the heading [m/s]. `tail_amplitude` is the fin tip's sideways stroke in the head
    frame, peak to peak [m]. `yaw_wave` [rad] and `wave` (m,) [m] are the complex amplitudes of
    heading and of each marker's sideways motion in the head frame at the beat frequency. Phases are
    relative to the tip's.

    Without a steady beat all are NaN except `speed`, which is then the mean over the whole track.
    Without a heading `speed` is the speed over ground, and what needs the head frame is NaN.
    """

    frequency: float
    speed: float
    beats: float
    yaw_wave: complex
    wave: NDArray[np.complex128] | None
    tail_amplitude: float

    @property
    def stride(self) -> float:
        """Distance per beat [m]."""
        return self.speed / self.frequency

    @property
    def strouhal(self) -> float:
        """Beat frequency times stroke over speed."""
        if self.speed == 0:
            return float("nan")
        return self.frequency * self.tail_amplitude / self.speed


def head_frame(track: Track) -> Array:
    """Markers relative to the tracked point, x along the heading, y to the left (k, m, 2) [m]."""
    assert track.markers is not None
    offset = track.markers - track.pose[:, None, :2]
    cos, sin = np.cos(track.pose[:, 2])[:, None], np.sin(track.pose[:, 2])[:, None]
    x = offset[..., 0] * cos + offset[..., 1] * sin
    y = offset[..., 1] * cos - offset[..., 0] * sin
    return np.stack([x, y], axis=-1)


def surge(track: Track) -> Array:
    """Velocity along the heading (k,) [m/s]."""
    rate = np.gradient(track.pose[:, :2], track.time, axis=0)
    return rate[:, 0] * np.cos(track.pose[:, 2]) + rate[:, 1] * np.sin(track.pose[:, 2])


def distance(track: Track) -> Array:
    """Path length along the heading since the start (k,) [m]; backward motion counts negative."""
    steps = np.diff(track.pose[:, :2], axis=0)
    yaw = track.pose[1:, 2]
    along = steps[:, 0] * np.cos(yaw) + steps[:, 1] * np.sin(yaw)
    return np.concatenate([[0.0], np.cumsum(along)])


def ground_distance(track: Track) -> Array:
    """Path length since the start (k,) [m], between mean positions of about a second each.

    The averages keep a camera's noise and the head's sway from adding to the path length.
    """
    pieces = max(int(track.time[-1] - track.time[0]), 1)
    piece = np.minimum(np.linspace(0, pieces, track.time.size).astype(int), pieces - 1)
    count = np.maximum(np.bincount(piece, minlength=pieces), 1)
    columns = np.column_stack([track.time, track.pose[:, :2]])
    means = np.stack([np.bincount(piece, c, pieces) / count for c in columns.T], axis=1)
    marks = np.concatenate([columns[:1], means, columns[-1:]])
    steps = np.linalg.norm(np.diff(marks[:, 1:], axis=0), axis=1)
    return np.interp(track.time, marks[:, 0], np.concatenate([[0.0], np.cumsum(steps)]))


def way(track: Track) -> float:
    """Path length of a swim [m]: along the heading, or over ground if no heading was recorded."""
    return float(np.abs((distance if track.has_heading else ground_distance)(track)[-1]))


def last_seconds(track: Track, seconds: float) -> Track:
    """The last `seconds` [s] of a track."""
    first = int(np.searchsorted(track.time, track.time[-1] - seconds))
    return track.cut(first, track.time.size)


def phase_shift(
    time: Array, signal: Array, other_time: Array, other: Array, frequency: float
) -> float:
    """Time [s] to add to `other_time` so that the beat of `other` is in phase with that of
    `signal`; at most half a period of `frequency` [Hz]."""
    lead = amplitude(other_time, other, frequency) / amplitude(time, signal, frequency)
    return float(np.angle(lead) / (2 * np.pi * frequency))


def beat_signal(track: Track) -> Array:
    """The signal of the beat (k,): the tip's sideways motion in the head frame [m]; without
    markers the heading [rad]."""
    if track.markers is None:
        return track.pose[:, 2]
    return head_frame(track)[:, track.tip, 1]


def _basis(time: Array, frequency: float, harmonics: int) -> Array:
    """Columns 1, t, t^2, then cos and sin of each harmonic; the powers absorb slow drift."""
    centred = time - time.mean()
    angles = 2 * np.pi * frequency * np.outer(time, np.arange(1, harmonics + 1))
    powers = np.stack([np.ones_like(time), centred, centred**2], axis=1)
    return np.concatenate([powers, np.cos(angles), np.sin(angles)], axis=1)


def amplitude(time: Array, signal: Array, frequency: float) -> complex:
    """Complex amplitude c, in the unit of `signal` (k,), of a beat at `frequency` f [Hz]: signal ~
    Re(c exp(2 pi i f t)). NaN if over half of the samples are unseen (NaN)."""
    seen = np.isfinite(signal)
    if seen.mean() < 0.5:
        return complex("nan")
    fit, *_ = np.linalg.lstsq(_basis(time[seen], frequency, 2), signal[seen], rcond=None)
    return complex(fit[3], -fit[5])


def beat_frequency(time: Array, signal: Array, band: tuple[float, float], name: str) -> float:
    """Beat frequency [Hz] by least squares of one sine on a slow drift, over uneven samples.

    Raises BadInput, which begins with `name`, if the strongest beat is outside the `band` (lowest,
    highest [Hz]) or the recording has fewer than two beats.
    """
    seen = np.isfinite(signal)
    time, signal = time[seen], signal[seen]
    found = _strongest(time, signal, 0.5 * band[0], 2.0 * band[1])
    _check_frequency(found, np.ptp(time), band, name)
    return found


def steady_beat(time: Array, signal: Array, band: tuple[float, float]) -> float:
    """Beat frequency [Hz] of `signal` (k,), up to twice the band's upper edge; NaN without one.

    Steady means: there are two beats or more, and one sine on a slow drift explains half of the
    variance of the signal's rate. The rate is used because in the signal one large turn of the
    motor outweighs many small beats.
    """
    low, high = 0.5 * band[0], 2.0 * band[1]
    found = [_strongest(time, signal, *span) for span in ((low, high), (0.0, low))]
    found = [frequency for frequency in found if frequency * np.ptp(time) >= MINIMUM_BEATS]
    rate = np.gradient(signal, time)
    misfits = [_misfit(frequency, time, rate) for frequency in found]
    limit = (1 - STEADY) * _misfit(0.0, time, rate, harmonics=0)
    steady = found and min(misfits) < limit
    return found[int(np.argmin(misfits))] if steady else float("nan")


def _strongest(time: Array, signal: Array, low: float, high: float) -> float:
    """Frequency [Hz] of the sine that fits best; NaN if the recording is too short."""
    span = np.ptp(time)
    grid = np.arange(max(low, 0.8 / span), high, 0.1 / span)
    if grid.size < 2:
        return float("nan")
    costs = [_misfit(f, time, signal) for f in grid]
    best, step = grid[int(np.argmin(costs))], grid[1] - grid[0]
    found = minimize_scalar(
        _misfit, bounds=(best - step, best + step), args=(time, signal), method="bounded"
    )
    return float(found.x)


def _misfit(frequency: float, time: Array, signal: Array, harmonics: int = 1) -> float:
    basis = _basis(time, frequency, harmonics)
    fit, *_ = np.linalg.lstsq(basis, signal, rcond=None)
    return float(np.square(signal - basis @ fit).mean())


def _check_frequency(
    frequency: float, duration: float, band: tuple[float, float], name: str
) -> None:
    if np.isnan(frequency):
        raise BadInput(
            f"{name}: {duration:.2f} s is too short for a beat of the band; record at least"
            f" {MINIMUM_BEATS:.0f} beats."
        )
    if frequency * duration < MINIMUM_BEATS:
        raise BadInput(
            f"{name}: {duration:.2f} s holds {frequency * duration:.1f} beats of"
            f" {frequency:.2f} Hz; record at least {MINIMUM_BEATS:.0f} beats."
        )
    if not band[0] * (1 - EDGE) <= frequency <= band[1] * (1 + EDGE):
        raise BadInput(
            f"{name}: beat frequency {frequency:.2f} Hz is outside the description's band"
            f" {band[0]:g}-{band[1]:g} Hz; check the recording, or widen band in the fish."
        )


def measure_gait(track: Track, frequency: float) -> Gait:
    """The gait over the largest whole number of beats of `frequency` [Hz] from the start. If it is
    NaN, only the mean speed over the whole track."""
    nan = float("nan")
    if not np.isfinite(frequency):
        return Gait(nan, mean_speed(track), nan, complex(nan), None, nan)
    period = float(np.median(np.diff(track.time)))
    beats = int(frequency * (track.time[-1] - track.time[0]) + 0.02)
    last = track.time[0] + beats / frequency + period / 2  # frames may be missing
    whole = track.cut(0, int(np.searchsorted(track.time, last, side="right")))
    if not track.has_heading:
        return Gait(frequency, mean_speed(whole), beats, complex(nan), None, nan)
    yaw = amplitude(whole.time, whole.pose[:, 2], frequency)
    if whole.markers is None:
        return Gait(frequency, float(surge(whole).mean()), beats, yaw, None, nan)
    sideways = head_frame(whole)[..., 1]
    wave = np.array([amplitude(whole.time, y, frequency) for y in sideways.T])
    turn = np.exp(-1j * np.angle(wave[whole.tip]))
    stroke = 2 * abs(wave[whole.tip])
    return Gait(
        frequency, float(surge(whole).mean()), beats, yaw * turn, wave * turn, float(stroke)
    )


def mean_speed(track: Track) -> float:
    """Mean over time of the velocity along the heading [m/s]. If no heading was recorded, the mean
    speed over ground, which is never below 0."""
    span = track.time[-1] - track.time[0]
    if track.has_heading:
        return float(np.trapezoid(surge(track), track.time) / span)
    return float(ground_distance(track)[-1] / span)
