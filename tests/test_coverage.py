"""Swims against the recordings of an identification: what is covered, and what to record next."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from support import complaint, tailbeat
from synthetic import clock_of, filmed, record
from tailbeat.evaluate import store
from tailbeat.evaluate.runs import Runs, as_recordings
from tailbeat.files import BadInput
from tailbeat.fish.store import load_fish
from tailbeat.identify.coverage import BANDS, Coverage, Quantity, coverage
from tailbeat.recording import Recording, crop, write_recording

FISH = load_fish("pulley-fish")


@pytest.fixture(scope="module")
def protocol() -> list[Recording]:
    """Swims over 1 to 4 Hz, to both sides: each beat is swept up by 30 %."""
    gaits = [(1.0, 0.6, 0.1), (1.5, 0.5, -0.1), (2.2, 0.35, 0.0), (3.4, 0.2, 0.0)]
    return [
        record(FISH, f"fluid-{rate}", rate, stroke, offset=turn, seconds=8.0)
        for rate, stroke, turn in gaits
    ]


@pytest.fixture(scope="module")
def slow() -> Recording:
    """A slow swim with a large stroke."""
    return record(FISH, "slow", 0.3, 1.2, seconds=12.0)


def quantity(found: Coverage, name: str) -> Quantity:
    return next(one for one in found.quantities if one.term.name == name)


def test_recordings_cover_themselves(protocol):
    found = coverage(protocol, protocol, FISH)
    assert [one.term.name for one in found.quantities] == [
        "motor power", "speed", "yaw rate", "motor angle", "motor rate",
    ]  # fmt: skip
    assert all(one.outside == 0 for one in found.quantities)
    assert all(one.overlap == pytest.approx(1) for one in found.quantities)
    assert found.covered and not found.advice and not found.missing


def test_a_swim_between_the_recorded_beats_is_covered(protocol):
    between = record(FISH, "between", 1.8, 0.4, seconds=8.0)
    found = coverage([between], protocol, FISH)
    assert quantity(found, "motor power").outside < 0.02
    assert quantity(found, "motor power").overlap < 0.9  # one beat of many
    assert quantity(found, "motor angle").covered


def test_a_slow_large_stroke_is_uncovered_and_its_band_named(protocol, slow):
    found = coverage([slow], protocol, FISH)
    power = quantity(found, "motor power")
    assert 0.8 < power.low < 1.05 and 3.4 < power.high < 4.5
    assert power.below > 0.9 and power.own_below < 0.05
    bands = {(band.low, band.high): band for band in found.bands}
    assert bands[0.0, 0.5].swims > 0.9 and bands[0.0, 0.5].recordings < 0.02
    assert not quantity(found, "motor angle").covered  # 1.2 rad where 0.7 were recorded
    assert quantity(found, "motor rate").covered  # slow as it is, the shaft turns no faster
    assert not found.covered
    share = f"{100 * power.below:.0f} % of the motor's power is there"
    assert f"record swims below {power.low:.2g} Hz: {share}" in found.advice[0]
    assert any("record larger motor angles to the left" in line for line in found.advice)


def test_shares_of_power_add_up(protocol, slow):
    found = coverage([slow], protocol, FISH)
    assert BANDS[0] == 0
    assert sum(band.swims for band in found.bands) == pytest.approx(1, abs=1e-6)
    assert sum(band.recordings for band in found.bands) == pytest.approx(1, abs=1e-6)


def test_a_turn_beyond_any_recording_names_its_side(protocol):
    straight = [one for one in protocol if "2.2" in one.name or "3.4" in one.name]
    turns = {"left": 0.5, "right": -0.5}
    for side, offset in turns.items():
        swum = record(FISH, side, 2.2, 0.35, offset=offset, seconds=8.0)
        yaw = swum.columns["yaw_rad"]
        found = coverage([swum], straight, FISH)
        turned = "left" if yaw[-1] > yaw[0] else "right"
        assert not quantity(found, "yaw rate").covered
        assert any(f"record turns to the {turned}" in line for line in found.advice)
        assert not quantity(found, "motor angle").covered
        assert any(f"motor angles to the {side}" in line for line in found.advice)


def test_a_share_of_the_time_is_that_share(protocol):
    """Known speeds: a quarter of the time faster than the recordings' constant speed."""
    time = np.arange(0, 40, 0.02)
    beat = 0.5 * np.sin(2 * np.pi * 1.5 * time)
    speed = np.where(time < 30, 0.2, 0.3)

    def made(name: str, speed: np.ndarray) -> Recording:
        x = np.concatenate([[0.0], np.cumsum(speed[:-1] * 0.02)])
        still = np.zeros_like(time)
        columns = {"motor_angle_rad": beat, "x_m": x, "y_m": still, "yaw_rad": still}
        return Recording(name, time, columns)

    recorded = made("recorded", 0.2 + 0.02 * np.sin(time / 2))
    found = quantity(coverage([made("swim", speed)], [recorded], FISH), "speed")
    assert found.low == pytest.approx(0.18, abs=1e-3) and found.high == pytest.approx(
        0.22, abs=1e-3
    )
    assert found.outside == pytest.approx(0.25, abs=0.02)


def test_quantities_without_columns_are_left_out_and_said(protocol):
    alone = [
        replace(one, columns={"motor_angle_rad": one.columns["motor_angle_rad"]})
        for one in protocol
    ]
    found = coverage(protocol, alone, FISH)
    assert found.covered and len(found.quantities) == 3
    assert [line.split(" is not")[0] for line in found.missing] == ["speed", "yaw rate"]
    assert all("recordings" in line for line in found.missing)


def test_glitches_leave_a_verdict_as_it_was(protocol, slow):
    """Jumps of the shaft in the recordings would widen their range: everything looks covered."""
    broken = [glitched(one, [40, 140, 240]) for one in protocol]
    clean, found = (coverage([slow], some, FISH) for some in (protocol, broken))
    assert len(found.glitches) == len(protocol) and not clean.glitches
    for a, b in zip(clean.quantities, found.quantities, strict=True):
        assert a.covered == b.covered
        assert b.high == pytest.approx(a.high, rel=0.03)
        assert b.outside == pytest.approx(a.outside, abs=0.02)


def glitched(one: Recording, at: list[int]) -> Recording:
    """A recording with a shaft that reads its range's end in some rows."""
    angle = np.array(one.columns["motor_angle_rad"])
    angle[at] = 1.39
    return replace(one, columns={**one.columns, "motor_angle_rad": angle})


def test_bad_input_is_one_sentence(protocol):
    blind = replace(protocol[0], columns={"x_m": protocol[0].time})
    with pytest.raises(BadInput, match="motor_angle_rad is missing"):
        coverage([blind], protocol, FISH)
    with pytest.raises(BadInput, match=r"0\.50 s; coverage needs 1 s or more"):
        coverage([crop(protocol[0], 0.0, 0.5)], protocol, FISH)
    columns = {**protocol[0].columns}
    columns["motor_angle_rad"] = 57.3 * columns["motor_angle_rad"]
    with pytest.raises(BadInput, match=r"outside motor\.range"):
        coverage(protocol, [replace(protocol[0], columns=columns)], FISH)
    still = filmed(FISH, "still", np.zeros(clock_of(FISH, 3.0).size), seconds=3.0)
    with pytest.raises(BadInput, match="never moves in any recording"):
        coverage(protocol, [still], FISH)


# ---- the verb -----------------------------------------------------------------------------------


def as_runs(swims: list[Recording]) -> Runs:
    """Swims as an evaluation keeps them; the second ends after 3 s, the third after half a one."""
    clock = np.arange(0, 7.9, 0.02)
    names = ("motor_angle_rad", "x_m", "y_m", "yaw_rad")
    numbers = np.array(
        [[np.interp(clock, one.time, one.columns[name]) for name in names] for one in swims]
    )
    steps = np.array([clock.size - 1, 150, 25])[: len(swims)]
    for one, last in zip(numbers, steps, strict=True):
        one[:, last + 1 :] = np.nan
    count, pose = len(swims), np.moveaxis(numbers[:, 1:], 1, 2).astype(np.float32)
    none = np.zeros(count, bool)
    return Runs(
        pose, np.zeros((count, clock.size, 2), np.float32), numbers[:, 0].astype(np.float32),
        np.zeros((count, clock.size - 1), np.float32), steps, none, none,
        np.full(count, np.nan, np.float32), np.zeros((0, clock.size, 9), np.float32),
        np.zeros(count, np.int64), np.ones(count, np.float32), np.ones(count, np.float32),
    )  # fmt: skip


def test_swims_of_an_evaluation_become_recordings(protocol):
    kept = as_recordings(as_runs(protocol[:3]), "reach.000")
    assert [one.name for one in kept] == ["reach.000 swim 1", "reach.000 swim 2"]
    assert kept[1].time[-1] == pytest.approx(3.0) and kept[1].time.size == 151
    angle = np.interp(kept[0].time, protocol[0].time, protocol[0].columns["motor_angle_rad"])
    assert kept[0].columns["motor_angle_rad"] == pytest.approx(angle, abs=1e-6)
    assert all(np.isfinite(column).all() for one in kept for column in one.columns.values())


@pytest.fixture(scope="module")
def folder(tmp_path_factory, protocol, slow) -> Path:
    """The recordings as a user keeps them, and an evaluation's chunk."""
    path = tmp_path_factory.mktemp("coverage")
    for one in (*protocol, slow):
        write_recording(one, path / f"{one.name}.csv")
    store.save(as_runs(protocol[:2]), path / "reach.000.npz")
    return path


def test_the_verb_says_what_to_record_and_exits_with_it(folder, tmp_path):
    known = sorted(folder.glob("fluid-*.csv"))
    same = tailbeat("coverage", *known, "--against", *known, "--fish", "pulley-fish")
    assert same.returncode == 0 and "cover the swims" in same.stdout
    out = tmp_path / "c.json"
    other = tailbeat(
        "coverage", folder / "slow.csv", "--against", *known, "--fish", "pulley-fish",
        "--json", out,
    )  # fmt: skip
    assert other.returncode == 1 and "record swims below" in other.stdout
    result = json.loads(out.read_text())
    assert not result["covered"] and result["advice"]
    assert result["quantities"][0]["quantity"] == "motor power"
    assert result["quantities"][0]["outside"] > 0.9


def test_the_verb_reads_chunks_of_an_evaluation(folder):
    known = sorted(folder.glob("fluid-*.csv"))
    swims = folder / "reach.000.npz"
    done = tailbeat("coverage", swims, "--against", *known, "--fish", "pulley-fish")
    assert done.returncode == 0, done.stdout
    turned = tailbeat("coverage", swims, "--against", known[-1], "--fish", "pulley-fish")
    assert turned.returncode == 1


def test_files_that_cannot_be_read_are_refused(folder, tmp_path):
    known = sorted(folder.glob("fluid-*.csv"))
    (tmp_path / "bad.npz").write_bytes(b"PK\x03\x04 not a chunk")
    reasons = {"bad.npz": "cannot be read", "no.npz": "no such file", "no.csv": "no such file"}
    for name, reason in reasons.items():
        swims = tmp_path / name
        assert reason in complaint("coverage", swims, "--against", *known, "--fish", "pulley-fish")
