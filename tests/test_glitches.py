"""Glitches are found by what a shaft can do, and clean recordings keep their samples."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from broken_sensors import KINDS, glitched
from tailbeat.cli.left_out import sentences
from tailbeat.files import BadInput
from tailbeat.fish.store import load_fish
from tailbeat.identify.clean import clean_swim
from tailbeat.identify.fluid import _recorded
from tailbeat.identify.glitch_report import as_rows
from tailbeat.identify.glitches import HEADING, SHAFT, SLOW_PULL, TAIL, SignalLimits, find, judge
from tailbeat.identify.runs import as_run
from tailbeat.identify.servo import as_bench, as_benches
from tailbeat.identify.tail import identify_tail
from tailbeat.importers.fishsim import import_fishsim
from tailbeat.importers.xl330 import import_xl330
from tailbeat.recording import Recording, read_recording

BENCH = Path(__file__).parents[1] / "examples" / "bench"
FISH = load_fish("pulley-fish")
TIME = np.arange(0, 5, 0.01)
SWING = Recording("swing", TIME, {"angle_rad": 0.8 * np.sin(6 * TIME), "command_rad": np.sin(TIME)})


def limits_of(name: str) -> SignalLimits:
    return {"tail-static": SLOW_PULL, "tail-sweep": TAIL, "tail-release": TAIL}.get(name, SHAFT)


def with_angle(rows: slice, values) -> Recording:
    angle = SWING.columns["angle_rad"].copy()
    angle[rows] = values
    return replace(SWING, columns={**SWING.columns, "angle_rad": angle})


def kinds_in(recording: Recording) -> dict[str, int]:
    _, found = find(recording, {"angle_rad": SHAFT})
    return {one.kind: len(one.times) for one in found}


def test_no_sample_of_our_bench_recordings_is_thrown_away():
    for path in BENCH.glob("*.csv"):
        recording = read_recording(path)
        good, _ = find(recording, {"angle_rad": limits_of(path.stem)})
        assert good["angle_rad"].all(), path


def test_no_sample_of_real_servo_logs_is_thrown_away(data):
    for path in (data / "xl330").glob("*.json"):
        good, _ = find(import_xl330(path), {"angle_rad": SHAFT})
        assert good["angle_rad"].all(), path


def test_each_kind_is_found_and_named():
    count = 2 * np.pi / 4096
    ticks = np.round(SWING.columns["angle_rad"][50] / count).astype(int) + 2048
    swapped = ((ticks & 0xFF) << 8 | ticks >> 8) - 2048
    assert kinds_in(SWING) == {}
    assert kinds_in(with_angle(slice(100, 101), -3.14)) == {"jump": 1}
    assert kinds_in(with_angle(slice(100, 105), [2.0, -1.0, 2.5, 1.9, -2.0])) == {"jump": 5}
    assert kinds_in(with_angle(slice(100, 140), -3.0)) == {"stuck": 40}
    assert kinds_in(with_angle(slice(50, 51), swapped * count)) == {"swapped bytes": 1}
    still = with_angle(slice(100, 106), SWING.columns["angle_rad"][99])
    assert kinds_in(still) == {"frozen": 6}
    kept = np.delete(np.arange(TIME.size), [200, 201])
    dropped = Recording("d", TIME[kept], {k: v[kept] for k, v in SWING.columns.items()})
    assert kinds_in(dropped) == {"gap": 1}


def test_a_shaft_at_rest_is_not_frozen_and_a_step_is_no_jump():
    since = np.maximum(TIME - 2, 0) / 0.06  # 280 rad/s^2 at first
    rest = 1 - (1 + since) * np.exp(-since)
    assert kinds_in(with_angle(slice(None), rest)) == {}


def test_a_spike_beside_a_rest_does_not_cost_the_rest():
    angle = np.zeros(TIME.size)
    angle[300] = -3.14
    assert kinds_in(with_angle(slice(None), angle)) == {"jump": 1}


def test_nearly_all_of_two_percent_is_found(data):
    left, lost, clean, bad = 0.0, 0, 0, 0
    for seed, path in enumerate(sorted((data / "xl330").glob("*.json"))):
        true = import_xl330(path)
        broken, where = glitched(true, ["angle_rad"], seed)
        good = find(broken, {"angle_rad": SHAFT})[0]["angle_rad"]
        error = np.abs(broken.columns["angle_rad"] - true.columns["angle_rad"])
        left = max(left, error[good].max())
        lost += int((~good & (error == 0)).sum())
        clean, bad = clean + good.size, bad + int(where["angle_rad"].sum())
    assert bad > 0.015 * clean and len(KINDS) == 5
    assert left < 0.05  # rad: what is not found is as small as a count or a slow shaft's way
    assert lost < 0.001 * clean


def test_a_heading_may_pass_half_a_turn():
    yaw = (2.0 * TIME + np.pi) % (2 * np.pi) - np.pi
    assert (judge(TIME, yaw, HEADING) == "").all()
    yaw[100] += 2.0
    assert np.flatnonzero(judge(TIME, yaw, HEADING) != "").tolist() == [100]


def test_a_column_of_nothing_but_glitches_is_one_sentence():
    noise = np.random.default_rng(0).uniform(-3, 3, TIME.size)
    with pytest.raises(BadInput, match=r"swing: column angle_rad: \d+ % of the samples move"):
        find(with_angle(slice(None), noise), {"angle_rad": SHAFT})


def test_a_report_names_their_times():
    _, found = find(with_angle(slice(100, 101), -3.14), {"angle_rad": SHAFT})
    rows = as_rows(found)
    assert rows == [
        {"recording": "swing", "column": "angle_rad", "kind": "jump", "count": 1, "times": [1.0]}
    ]
    assert sentences(rows) == ["swing: 1 samples of angle_rad left out (jump) at 1.00 s"]


# ---- in a servo's recording ---------------------------------------------------------------------


def test_a_bench_begins_at_the_first_good_sample_and_holds_no_glitch():
    bench = as_bench(with_angle(slice(0, 3), -3.14), FISH)
    assert bench.time[0] == 0 and bench.time.size == TIME.size - 3
    spiked = as_bench(with_angle(slice(100, 101), -3.14), FISH)
    assert np.flatnonzero(~spiked.good).tolist() == [100] and np.isnan(spiked.angle[100])
    assert spiked.glitches[0].times == (1.0,)


def test_a_swapped_count_beyond_a_turn_is_no_degrees():
    assert not as_bench(with_angle(slice(50, 51), 97.0), FISH).good[50]
    with pytest.raises(BadInput, match="looks like degrees"):
        as_bench(with_angle(slice(None), 40 * np.sin(6 * TIME)), FISH)


def test_time_that_starts_anew_makes_a_bench_each():
    twice = {name: np.tile(column, 2) for name, column in SWING.columns.items()}
    labels = {"condition": np.repeat(["slow", "fast"], TIME.size)}
    whole = replace(SWING, time=np.tile(TIME, 2), columns=twice, labels=labels)
    assert [bench.name for bench in as_benches(whole, FISH)] == ["swing, slow", "swing, fast"]


# ---- in a tail's recording and in a swim --------------------------------------------------------


def test_a_tail_keeps_its_numbers_through_two_percent_of_glitches():
    sweep = read_recording(BENCH / "tail-sweep.csv")
    clean = identify_tail([sweep])
    assert not [one for one in clean.glitches if one.kind != "gap"]
    for seed in range(3):
        found = identify_tail([glitched(sweep, ["angle_rad", "torque_nm"], seed)[0]])
        assert sum(len(one.times) for one in found.glitches) > 0.02 * sweep.time.size
        for name in ("k_eff", "i_eff", "c_eff", "coulomb"):
            low, high = getattr(clean, name).interval
            assert low <= getattr(found, name).value <= high, (seed, name)


def swim(seconds: float = 6.0) -> Recording:
    time = np.arange(0, seconds, 1 / 60)
    beat = 2 * np.pi * 1.5 * time
    motor, yaw = 0.5 * np.sin(beat), 0.1 * np.cos(beat)
    tip = 0.05 * np.sin(beat)
    columns = {"x_m": 0.2 * time, "y_m": 0.005 * np.sin(beat), "yaw_rad": yaw}
    marked = {"marker0_x_m": 0.2 * time - 0.3, "marker0_y_m": tip}
    return Recording("swim", time, {**columns, **marked, "motor_angle_rad": motor})


def test_a_swim_loses_wrong_frames_and_unsees_wrong_markers():
    clean, none = clean_swim(swim())
    assert clean.time.size == 360 and not none
    made = {name: column.copy() for name, column in swim().columns.items()}
    made["x_m"][100], made["yaw_rad"][200], made["marker0_y_m"][50] = 3.0, 2.0, 0.9
    found, listed = clean_swim(replace(swim(), columns=made))
    assert np.setdiff1d(swim().time, found.time) == pytest.approx([100 / 60, 200 / 60])
    assert np.flatnonzero(np.isnan(found.columns["marker0_y_m"])).tolist() == [50]
    assert {one.column for one in listed} == {"x_m", "yaw_rad", "marker0_y_m"}
    run = as_run(replace(swim(), columns=made), FISH)
    assert run.gait.speed == pytest.approx(as_run(swim(), FISH).gait.speed, rel=0.01)
    assert run.glitches == listed


def test_a_swim_with_many_dead_readings_loses_them_and_is_no_other_unit():
    """An outside audit: with 13 % of its angles at -3.14 a swim was refused as in another unit."""
    motor = swim().columns["motor_angle_rad"].copy()
    dead = np.random.default_rng(0).random(motor.size) < 0.15
    dead[:3] = False
    motor[dead] = -3.14
    run = as_run(replace(swim(), columns={**swim().columns, "motor_angle_rad": motor}), FISH)
    listed = [one for one in run.glitches if one.column == "motor_angle_rad"]
    assert sum(len(one.times) for one in listed) >= dead.sum()
    degrees = {**swim().columns, "motor_angle_rad": np.degrees(swim().columns["motor_angle_rad"])}
    with pytest.raises(BadInput, match=r"outside motor\.range"):
        as_run(replace(swim(), columns=degrees), FISH)


def test_a_swim_in_milliseconds_is_refused():
    """The audit's: it was swum for minutes, and the exit code was 0."""
    with pytest.raises(BadInput, match=r"samples are 16\.7 s apart; allowed is 0\.5 s"):
        as_run(replace(swim(), time=1000 * swim().time), FISH)


def test_nothing_is_compared_in_a_hole():
    when = np.delete(np.arange(0, 1, 0.02), slice(20, 25))
    times = np.array([0.1, 0.41, 0.45, 0.7])
    assert _recorded(times, when).tolist() == [True, False, False, True]


def test_real_swims_keep_their_frames(data):
    lost, all_of_them = 0, 0
    for path in (data / "fishsim").glob("*.csv"):
        recording = import_fishsim(path)
        found, _ = clean_swim(recording)
        lost += recording.time.size - found.time.size
        all_of_them += recording.time.size
    assert lost <= 0.001 * all_of_them
