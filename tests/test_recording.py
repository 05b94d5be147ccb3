"""Recordings come back bit for bit, and bad ones are refused by name."""

from dataclasses import replace

import numpy as np
import polars as pl
import pytest

from tailbeat.files import BadInput
from tailbeat.importers.fishsim import fill_gaps
from tailbeat.recording import (
    Recording,
    crop,
    markers,
    read_recording,
    require,
    resample,
    uniform,
    write_recording,
)


def example() -> Recording:
    rng = np.random.default_rng(0)
    time = np.cumsum(rng.uniform(0.01, 0.03, 50))  # uneven, as a recorder's clock is
    track = rng.normal(size=50)
    track[7] = np.nan
    columns = {"yaw_rad": rng.normal(size=50), "marker0_x_m": track, "marker0_y_m": track + 1}
    return Recording("r", time, columns, {"fish": "a: b", "rate_hz": "60"})


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_round_trip_is_bit_exact(tmp_path, suffix):
    written = example()
    write_recording(written, tmp_path / f"r{suffix}")
    read = read_recording(tmp_path / f"r{suffix}")
    assert np.array_equal(read.time, written.time)
    assert dict(read.meta) == dict(written.meta)
    for name, column in written.columns.items():
        assert np.array_equal(read.columns[name], column, equal_nan=True), name


BAD = {
    "no time": ("a_rad\n1\n2\n", "column time_s is missing"),
    "one row": ("time_s,a_rad\n0,1\n", "1 rows"),
    "nan": ("time_s,a_rad\n0,1\n1,NaN\n", "column a_rad, row 2: 'NaN'"),
    "inf": ("time_s,a_rad\n0,1\n1,inf\n", "column a_rad, row 2: 'inf'"),
    "word": ("time_s,a_rad\n0,one\n1,2\n", "column a_rad, row 1: 'one'"),
    "empty": ("time_s,a_rad\n0,\n1,2\n", "column a_rad, row 1: the cell is empty"),
    "time back": ("time_s,a_rad\n0,1\n2,1\n1,1\n", "row 3: 1.0 does not come after 2.0"),
    "time twice": ("time_s,a_rad\n0,1\n0,1\n", "row 2: 0.0 does not come after 0.0"),
    "time back in a condition": (
        "time_s,condition\n0,a\n1,a\n0,b\n2,b\n1,b\n",
        "row 5: 1.0 does not come after 2.0 within condition 'b'",
    ),
    "unit": ("time_s,angle\n0,1\n1,1\n", "column 'angle' does not end in a unit"),
    "double": ("time_s,a_rad,a_rad\n0,1,1\n1,1,1\n", "column 'a_rad' appears twice"),
    "nothing": ("", "not a table"),
    "short row": ("time_s,marker0_x_m\n0,1\n1\n", "row 2 has 1 cells and the header 2"),
    "long row": ("time_s,a_rad\n0,1\n1,2,3\n", "row 2 has 3 cells and the header 2"),
    "no condition": ("time_s,condition\n0,a\n1,\n", "column condition, row 2: the cell is empty"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_sentence(tmp_path, case):
    text, complaint = BAD[case]
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(BadInput) as caught:
        read_recording(path)
    message = str(caught.value)
    assert complaint in message and str(path) in message
    assert "\n" not in message


def test_unwritable_recordings_leave_no_file(tmp_path):
    good = example()
    for meta in ({"note": "two\nlines"}, {"a: b": "c"}):
        for suffix in (".csv", ".parquet"):
            with pytest.raises(BadInput, match="use one line"):
                write_recording(replace(good, meta=meta), tmp_path / f"r{suffix}")
    lost = replace(good, columns={"angle_rad": np.full(50, np.nan)})
    with pytest.raises(BadInput, match="the cell is empty"):
        write_recording(lost, tmp_path / "r.csv")
    assert list(tmp_path.iterdir()) == []


def test_a_spreadsheets_mark_and_spaces_are_read(tmp_path):
    (tmp_path / "r.csv").write_text("\ufefftime_s, a_rad\n0, 1\n1, 2\n", encoding="utf-8")
    assert read_recording(tmp_path / "r.csv").columns["a_rad"].tolist() == [1.0, 2.0]


@pytest.mark.parametrize("rate", [7.0, 29.97, 50.0, 60.0, 1000.0])
def test_a_uniform_recording_survives_its_own_rate(rate):
    for count in range(2, 400):
        recording = Recording("u", np.arange(count) / rate, {"a_rad": np.zeros(count)})
        assert uniform(recording, 1 / rate).time.size == count


def test_time_may_start_anew_with_a_condition_but_not_in_one_stretch(tmp_path):
    (tmp_path / "r.csv").write_text("time_s,a_rad,condition\n0,1,x\n1,2,x\n0,3,y\n1,4,y\n")
    read = read_recording(tmp_path / "r.csv")
    assert read.time.tolist() == [0.0, 1.0, 0.0, 1.0]
    uses = (
        lambda: require(read, ["a_rad"]),
        lambda: crop(read, 0.0, 1.0),
        lambda: uniform(read, 0.5),
    )
    for use in uses:
        with pytest.raises(BadInput, match="row 3: time starts again"):
            use()


def test_missing_column_names_what_there_is():
    with pytest.raises(BadInput, match=r"angle_rad is missing; the recording has time_s, yaw_rad"):
        require(example(), ["angle_rad"])


def test_a_wrong_parquet_is_refused(tmp_path):
    (tmp_path / "x.parquet").write_bytes(b"not parquet")
    with pytest.raises(BadInput, match="not a Parquet file"):
        read_recording(tmp_path / "x.parquet")


def test_a_damaged_parquet_is_read_or_refused(tmp_path):
    """One byte changed anywhere in the footer; some of these panic in polars."""
    time = np.arange(0.0, 5.0, 0.01)
    whole, damaged = tmp_path / "whole.parquet", tmp_path / "damaged.parquet"
    pl.DataFrame({"time_s": time, "angle_rad": np.sin(time)}).write_parquet(whole)
    refused = 0
    for place in range(1, 600):
        content = bytearray(whole.read_bytes())
        content[-place] = 251
        damaged.write_bytes(content)
        try:
            read_recording(damaged)
        except BadInput:
            refused += 1
    assert 100 < refused < 600


def test_resampling_keeps_a_straight_line_and_unwraps_angles():
    time = np.array([0.0, 1.0, 3.0])
    turning = np.array([3.0, -3.2 + 0.2 - 0.0832, -2.0])  # passes pi between the first two
    line = Recording("l", time, {"x_m": 2 * time, "yaw_rad": turning})
    even = uniform(line, 0.5)
    assert np.allclose(even.columns["x_m"], 2 * even.time)
    assert np.all(np.diff(even.columns["yaw_rad"]) > 0)
    assert crop(line, 0.5, 3.0).time.tolist() == [1.0, 3.0]
    with pytest.raises(BadInput, match="choose times within 0-3 s"):
        resample(line, np.array([-1.0, 1.0]))
    with pytest.raises(BadInput, match="has 1 samples"):
        crop(line, 0.5, 2.0)


def test_short_gaps_are_bridged_and_long_ones_left():
    time = np.arange(30) / 60
    track = 0.1 * time
    track[3:5] = np.nan
    track[10:25] = np.nan
    both = {"marker0_x_m": track, "marker0_y_m": track}
    tracks, numbers = markers(fill_gaps(Recording("g", time, both), longest=0.1))
    assert numbers == [0]
    assert np.allclose(tracks[3:5, 0, 0], 0.1 * time[3:5])
    assert np.isnan(tracks[10:25]).all()
