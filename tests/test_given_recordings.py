"""Fits of recordings as labs give them: of one name, corrected, cut off, full of glitches."""

import re
from dataclasses import replace

import numpy as np
import pytest

from synthetic import record
from synthetic_recordings import TailTruth, release, tail_sweep
from tailbeat.files import BadInput
from tailbeat.fish.store import load_fish
from tailbeat.identify import job, tail_report
from tailbeat.identify.decay import ring_down
from tailbeat.identify.glitches import Glitch
from tailbeat.identify.runs import as_run
from tailbeat.identify.servo import as_bench
from tailbeat.identify.servo_job import identify_servo
from tailbeat.identify.servo_search import ServoConfig
from tailbeat.identify.tail import identify_tail
from tailbeat.identify.trust import share_left_out
from tailbeat.recording import (
    Recording,
    crop,
    read_recording,
    read_recordings,
    rows,
    write_recording,
)

FISH = load_fish("pulley-fish")
SWIM = record(FISH, "swim", 1.5, 0.5, seconds=3.0)
FREQUENCIES, STROKES = (0.7, 1.3, 2.2, 3.6), (0.1, 0.2)


# ---- names --------------------------------------------------------------------------------------


def test_two_tails_whose_files_have_one_name_contradict_each_other(tmp_path):
    """A protocol always writes tail-sweep.csv, and the two were averaged as one recording."""
    paths = []
    for day, stiffness in (("monday", 0.98), ("tuesday", 1.5)):
        (tmp_path / day).mkdir()
        paths.append(tmp_path / day / "tail-sweep.csv")
        made = tail_sweep(TailTruth(k_eff=stiffness), FREQUENCIES, STROKES, 4.0, 0)
        write_recording(made, paths[-1])
    found = read_recordings(paths)
    assert [one.name for one in found] == ["monday/tail-sweep", "tuesday/tail-sweep"]
    (said,) = identify_tail(found).contradictions
    assert "in monday/tail-sweep and 1." in said
    with pytest.raises(BadInput, match=r"tail-sweep\.csv: given twice"):
        read_recordings([paths[0], paths[1], paths[0]])
    assert [one.name for one in read_recordings(paths[:1])] == ["tail-sweep"]


# ---- what is searched again ---------------------------------------------------------------------


def test_a_corrected_launch_or_marker_is_another_search():
    """The same command would have gone on with the search of the recording before."""
    config, run = job.FluidConfig(zones=1), as_run(SWIM, FISH)
    size = (run.track.time.size, 1, 2)
    seen, moved = (replace(run.track, markers=np.full(size, x)) for x in (0.0, 0.01))
    others = [
        run,
        replace(run, launch=np.array([-0.2, 0.0, 0.0])),
        replace(run, track=seen),
        replace(run, track=moved),
    ]
    assert len({job._key(FISH, [one], config) for one in others}) == len(others)
    assert job._key(FISH, [as_run(SWIM, FISH)], config) == job._key(FISH, [run], config)


# ---- glitches -----------------------------------------------------------------------------------


def test_a_tag_that_is_seen_wrongly_is_one_sample_and_not_three():
    times = tuple(np.arange(0.0, 0.7, 0.01))
    found = [Glitch("a", name, "jump", times) for name in ("x_m", "y_m", "yaw_rad")]
    found += [Glitch("a", "x_m", "frozen", (0.9,) * 10), Glitch("a", "time_s", "gap", times)]
    assert share_left_out(found, 1000) == pytest.approx(0.08)
    assert share_left_out([], 1000) == 0.0


def test_the_share_is_of_the_rows_before_any_was_left_out():
    columns = dict(SWIM.columns)
    columns["x_m"] = columns["x_m"].copy()
    columns["x_m"][10:60:5] += 3.0
    run = as_run(replace(SWIM, columns=columns), FISH)
    assert run.rows == SWIM.time.size > run.track.time.size
    assert share_left_out(run.glitches, run.rows) == pytest.approx(10 / SWIM.time.size)


def test_a_sweep_full_of_glitches_is_not_trusted():
    sweep = tail_sweep(TailTruth(), FREQUENCIES, STROKES, 6.0, 0)
    bad = np.random.default_rng(0).random(sweep.time.size) < 0.3
    angle = np.where(bad, np.pi, sweep.columns["angle_rad"])
    fit = identify_tail([replace(sweep, columns={**sweep.columns, "angle_rad": angle})])
    report = tail_report.as_report(tail_report.combine(FISH, fit, None, None))
    assert not report["trusted"]
    assert re.match(r"do not trust this fit: \d\d % of the samples of tail", report["verdict"][0])
    clean = tail_report.combine(FISH, identify_tail([sweep]), None, None)
    assert tail_report.as_report(clean)["trusted"]


# ---- too short ----------------------------------------------------------------------------------


def test_a_release_that_is_cut_off_while_it_swings_is_refused():
    """Nothing is above the noise then, which is taken from the last fifth."""
    weak = TailTruth(c_eff=0.0012, coulomb=0.0)
    let_go = release(weak, 0.3, 4.0, 0)
    with pytest.raises(BadInput, match="no ring-down found"):
        ring_down(crop(let_go, 0.0, 0.9))
    time = np.arange(0.0, 4.0, 0.01)
    driven = Recording("sine", time, {"angle_rad": 0.3 * np.cos(9.0 * time)})
    with pytest.raises(BadInput, match="no ring-down found"):
        ring_down(driven)


def test_a_swim_of_two_rows_is_no_traceback(tmp_path):
    write_recording(rows(SWIM, slice(0, 2)), tmp_path / "two.csv")
    with pytest.raises(BadInput, match=r"a swim lasts 0\.5 s or more\. Leave this one out\.$"):
        as_run(read_recording(tmp_path / "two.csv"), FISH)


# ---- options ------------------------------------------------------------------------------------


def test_a_gain_that_no_recording_states_is_refused(tmp_path):
    time = np.arange(0.0, 2.0, 0.01)
    angle = 0.3 * np.sin(3 * time)
    bench = as_bench(Recording("s", time, {"command_rad": angle, "angle_rad": angle}), FISH)
    with pytest.raises(BadInput, match="--gain 400: no recording states its gain"):
        identify_servo(FISH, [bench], [], ServoConfig(gain=400.0), tmp_path)
