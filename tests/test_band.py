"""How much of the tail's motion lies in the identified band: whole pieces, and the robot's last."""

import numpy as np
import pytest

from tailbeat.control.band import Monitor, share_below, velocity_spectrum
from tailbeat.files import BadInput


def test_two_tones_share_the_power_of_their_speeds():
    rng = np.random.default_rng(0)
    time = (np.arange(400) + rng.uniform(-0.3, 0.3, 400)) * 0.02  # a loop with jitter
    angle = 0.3 * np.sin(2 * np.pi * 2 * time) + 0.1 * np.sin(2 * np.pi * 6 * time + 1) + 0.1 * time
    # speeds 0.3 * 2 and 0.1 * 6: the same power
    assert share_below(time, angle, 4.0) == pytest.approx(0.5, abs=0.03)
    assert share_below(time, angle, 7.0) > 0.97
    total = np.trapezoid(velocity_spectrum(time, angle).power) / 8
    assert total == pytest.approx(2 * 0.5 * (2 * np.pi * 0.6) ** 2, rel=0.15)


def test_the_running_share_follows_the_last_four_seconds():
    monitor = Monitor(4.0)
    assert monitor.share() is None
    for t in np.arange(0, 6, 0.02):
        monitor.add(t, 0.5 * np.sin(2 * np.pi * 1.3 * t))
    calm = monitor.share()
    assert calm is not None and calm > 0.95
    for t in np.arange(6, 11, 0.02):
        monitor.add(t, 0.2 * np.sin(2 * np.pi * 7 * t))
    fast = monitor.share()
    assert fast is not None and fast < 0.1
    assert len(monitor.samples) <= 202
    for t in np.arange(11, 16, 0.02):
        monitor.add(t, 0.0)
    assert monitor.share() is None


@pytest.mark.parametrize(
    ("beat", "side"), [(0.4, "below"), (2.0, "inside"), (3.0, "inside"), (6.0, "above")]
)
def test_a_beat_counts_on_its_side_of_the_band(beat, side):
    time = np.arange(0, 10, 0.02)
    found = velocity_spectrum(time, np.sin(2 * np.pi * beat * time)).shares((1.0, 4.0))
    assert getattr(found, side) > 0.95
    assert found.below + found.inside + found.above == pytest.approx(1.0)


def test_both_edges_lie_inside_and_a_still_tail_has_no_shares():
    time = np.arange(0, 10.001, 0.02)
    angle = np.sin(2 * np.pi * 2 * time)
    found = velocity_spectrum(time, angle)
    band = (float(found.frequency[18]), float(found.frequency[20]))  # the tone's three lines
    assert found.shares(band).inside > 0.999
    assert np.isnan(velocity_spectrum(time, 0 * time).shares(band).inside)
    with pytest.raises(BadInput, match="needs 8"):
        velocity_spectrum(time[:3], angle[:3])


def test_a_piece_too_short_for_the_lower_edge_does_not_say_what_lies_below():
    for seconds, known in ((2.0, False), (4.0, True)):
        time = np.arange(0, seconds, 0.02)
        found = velocity_spectrum(time, np.sin(2 * np.pi * 0.4 * time)).shares((1.0, 4.0))
        assert np.isfinite(found.above) and np.isfinite([found.below, found.inside]).all() == known


def test_the_running_monitor_tells_below_from_inside():
    monitor = Monitor(4.0, floor=1.0)
    assert monitor.shares() is None
    for t in np.arange(0, 6, 0.02):
        monitor.add(t, 0.5 * np.sin(2 * np.pi * 0.4 * t))
    slow, share = monitor.shares(), monitor.share()
    assert slow is not None and slow.below > 0.9
    assert share == pytest.approx(1 - slow.above)


def test_a_tone_has_the_power_of_its_speed_at_its_frequency():
    time = np.arange(0, 10.001, 0.02)
    found = velocity_spectrum(time, 0.3 * np.sin(2 * np.pi * 2 * time))
    assert found.frequency[np.argmax(found.power)] == pytest.approx(2.0)
    width = found.frequency[1] - found.frequency[0]
    assert found.power.sum() * width == pytest.approx((2 * np.pi * 2 * 0.3) ** 2 / 2, rel=0.01)
    assert found.frequency[0] == pytest.approx(width) and found.frequency[-1] == pytest.approx(12)


def test_an_angle_far_from_zero_that_drifts_has_no_power_from_it():
    time = np.arange(0, 10.001, 0.02)
    tone = 0.001 * np.sin(2 * np.pi * 2 * time)
    for drift in (5.0, 0.3 * time, 5.0 - 0.3 * time):
        found = velocity_spectrum(time + 100.0, tone + drift).shares((1.5, 2.5))
        assert found.inside > 0.99


def test_a_band_without_a_floor_has_nothing_below_it():
    monitor = Monitor(4.0)
    for k in range(200):
        monitor.add(0.02 * k, float(np.sin(2 * np.pi * 0.5 * 0.02 * k)))
    found = monitor.shares()
    assert found is not None and found.below == 0.0 and found.inside > 0.99


def test_frequencies_end_where_the_samples_rate_ends():
    time = np.linspace(0, 10, 101)  # ten a second: just below five can be told
    assert velocity_spectrum(time, np.sin(time)).frequency[-1] == pytest.approx(4.5)
    short = np.linspace(0, 7e-3, 8)
    assert velocity_spectrum(short, np.sin(short)).frequency == pytest.approx([1 / 7e-3])


def test_a_spectrum_needs_eight_samples_whose_times_rise():
    time = np.linspace(0, 0.7, 8)
    assert velocity_spectrum(time, np.sin(time)).power.size == 3
    for bad in (time[:7], np.append(time, time[-1]), np.append(time, 0.6)):
        with pytest.raises(BadInput, match=f"{bad.size} samples; .* 8 or more"):
            velocity_spectrum(bad, np.sin(bad))


def test_the_smallest_motion_has_a_share_and_none_has_none():
    time = np.arange(0, 10.001, 0.02)
    small, still = (velocity_spectrum(time, x * np.sin(12 * time)) for x in (1e-5, 0.0))
    assert small.share_below(4.0) > 0.99 and small.shares((1.0, 4.0)).inside > 0.99
    assert np.isnan(still.share_below(4.0))


def test_three_periods_of_the_lower_edge_tell_slow_motion_from_fast():
    time = np.linspace(0, 3, 151)
    found = velocity_spectrum(time, np.sin(2 * np.pi * 2 * time))
    assert found.resolves(1.0) and not found.resolves(0.99)
    assert found.resolves(0.0) and found.shares((0.0, 4.0)).below == 0  # nothing lies below 0


def test_the_monitor_keeps_four_seconds_and_speaks_from_the_second_on():
    monitor = Monitor(4.0)
    for k in range(200):
        monitor.add(k / 16, 0.5 * np.sin(k))
        if k in (31, 32, 199):
            assert (monitor.share() is not None) == (k >= 32)
        assert monitor.samples[0][0] == max(0.0, k / 16 - 4.0)


def test_eight_samples_are_enough_for_the_monitor_and_seven_are_not():
    monitor = Monitor(4.0)
    for k in range(7):
        monitor.add(k * 0.5, 0.5 * (-1) ** k)
    assert monitor.share() is None
    monitor.add(3.5, -0.5)
    assert monitor.share() is not None


@pytest.mark.parametrize(("speed", "known"), [(0.045, False), (0.055, True)])
def test_a_tail_slower_than_a_twentieth_of_a_radian_a_second_has_no_beat(speed, known):
    monitor = Monitor(4.0)
    for t in np.arange(0, 4, 0.02):  # rms speed
        monitor.add(t, speed * np.sqrt(2) / (2 * np.pi) * np.sin(2 * np.pi * t))
    assert (monitor.share() is not None) == known
