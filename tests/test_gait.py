"""Gait figures of swims that are known in closed form."""

import numpy as np
import pytest

from tailbeat.files import BadInput
from tailbeat.identify.gait import (
    Track,
    beat_frequency,
    beat_signal,
    distance,
    last_seconds,
    measure_gait,
    phase_shift,
)

BAND = (0.2, 4.0)


def known(frequency=1.3, speed=0.2, stroke=0.1, lag=0.7, seconds=5.0, jitter=0.0) -> Track:
    """A fish swimming at 40 degrees; tip and a middle marker beat sideways, head yaws by 0.1."""
    rng = np.random.default_rng(0)
    time = np.arange(0, seconds, 1 / 60) + jitter * rng.uniform(-1, 1, round(seconds * 60))
    beat = 2 * np.pi * frequency * time
    yaw = np.radians(40) + 0.1 * np.sin(beat + lag)
    ahead = np.array([np.cos(np.radians(40)), np.sin(np.radians(40))])
    place = speed * time[:, None] * ahead
    sideways = np.stack([0.3 * stroke * np.sin(beat + 0.4), stroke * np.sin(beat)], axis=1)
    forward = np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
    left = np.stack([-np.sin(yaw), np.cos(yaw)], axis=1)
    tracks = (
        place[:, None]
        + np.array([-0.2, -0.4])[None, :, None] * forward[:, None]
        + sideways[..., None] * left[:, None]
    )
    return Track(time, np.column_stack([place, yaw]), tracks, tip=1)


def test_figures_of_a_known_swim():
    track = known()
    frequency = beat_frequency(track.time, beat_signal(track), BAND, "a")
    gait = measure_gait(track, frequency)
    assert frequency == pytest.approx(1.3, rel=1e-4)
    assert gait.speed == pytest.approx(0.2 * np.sinc(0) * (1 - 0.1**2 / 4), rel=2e-3)
    assert gait.stride == pytest.approx(gait.speed / 1.3, rel=1e-3)
    assert gait.tail_amplitude == pytest.approx(0.2, rel=1e-3)
    assert gait.strouhal == pytest.approx(1.3 * 0.2 / gait.speed, rel=1e-3)
    assert gait.beats == 6
    assert gait.wave is not None
    assert np.angle(gait.wave[0]) == pytest.approx(0.4, abs=1e-3)
    assert gait.yaw_wave == pytest.approx(0.1 * np.exp(0.7j), abs=1e-3)


def test_uneven_clock_and_unseen_frames_do_not_matter():
    track = known(jitter=0.004)
    assert track.markers is not None
    track.markers[30:60, 1] = np.nan
    frequency = beat_frequency(track.time, beat_signal(track), BAND, "a")
    gait = measure_gait(track, frequency)
    assert frequency == pytest.approx(1.3, rel=1e-3)
    assert gait.tail_amplitude == pytest.approx(0.2, rel=5e-3)


def test_a_marker_seen_under_half_the_time_has_no_wave():
    track = known()
    assert track.markers is not None
    track.markers[100:, 0] = np.nan
    gait = measure_gait(track, 1.3)
    assert gait.wave is not None and np.isnan(gait.wave[0]) and np.isfinite(gait.wave[1])


def test_too_few_beats_and_wrong_band_are_refused():
    short = known(frequency=0.5, seconds=3.0)
    with pytest.raises(
        BadInput, match=r"a: 2\.98 s holds 1\.5 beats of 0\.50 Hz; record at least 2"
    ):
        beat_frequency(short.time, beat_signal(short), BAND, "a")
    fast = known(frequency=3.0)
    with pytest.raises(BadInput, match=r"3\.00 Hz is outside the description's band 0\.5-2 Hz"):
        beat_frequency(fast.time, beat_signal(fast), (0.5, 2.0), "a")


def test_distance_and_phase_of_a_known_swim():
    track = known()
    assert distance(track)[-1] == pytest.approx(0.2 * track.time[-1], rel=5e-3)
    late = last_seconds(track, 2.0)
    assert late.time[-1] - late.time[0] == pytest.approx(2.0, abs=1 / 60)
    clock = np.arange(0, 4, 0.02)
    early, later = (np.sin(2 * np.pi * 1.3 * (clock - lag)) for lag in (0.0, 0.1))
    assert phase_shift(clock, later, clock, early, 1.3) == pytest.approx(0.1, abs=1e-6)
