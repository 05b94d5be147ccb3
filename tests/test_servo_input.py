"""Recordings of a servo that cannot be fitted, or whose fit cannot be trusted, are told."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from other_servos import SERVOS, bench_of, pendulum_log
from support import complaint
from synthetic_recordings import servo_run
from tailbeat.files import BadInput
from tailbeat.fish.store import load_fish
from tailbeat.identify.protocol import limits, servo_commands
from tailbeat.identify.search import Effort
from tailbeat.identify.servo import as_bench, check_driven, servo_space
from tailbeat.identify.servo_gains import at_edges
from tailbeat.identify.servo_job import identify_servo
from tailbeat.identify.servo_report import as_report
from tailbeat.identify.servo_search import ServoConfig
from tailbeat.recording import Recording

FISH = load_fish("pulley-fish")
TRIED = ("sin_sin", "lift_and_drop")  # motions of a pendulum
STEPS = Path(__file__).parents[1] / "examples/bench/servo-steps.csv"


@pytest.fixture(scope="module")
def made() -> dict[str, Recording]:
    commands = servo_commands(FISH, limits(FISH))
    return {name: servo_run(FISH, c, seed) for seed, (name, c) in enumerate(commands.items())}


def with_column(recording: Recording, **columns) -> Recording:
    return replace(recording, columns={**recording.columns, **columns})


def test_what_no_servo_does_is_refused(made):
    """Each of these was fitted, and written as a fish."""
    chirp = made["servo-chirp"]
    angle = chirp.columns["angle_rad"]
    for wrong, said in (
        (with_column(chirp, angle_rad=-angle), "runs against command_rad; turn the sign"),
        (with_column(chirp, angle_rad=0 * angle), "angle_rad never moves, the command does"),
        (replace(chirp, time=1e3 * chirp.time), "time_s: samples are .* s apart; allowed is 0.1"),
        (replace(chirp, meta={"load_arm_m": "0.15"}), "metadata load_mass_kg = None"),
    ):
        with pytest.raises(BadInput, match=said):
            as_bench(wrong, FISH)
    off = with_column(chirp, enabled_ratio=0 * angle)
    with pytest.raises(BadInput, match="enabled_ratio is never 1"):
        check_driven([as_bench(off, FISH)])
    check_driven([as_bench(off, FISH), as_bench(chirp, FISH)])


def test_a_servo_that_lags_half_a_beat_is_not_called_mirrored(made):
    """Nor is any command of the bench, at the strokes and delays of slow servos."""
    for recording in made.values():
        as_bench(recording, FISH)
    time = np.arange(0, 6, 0.008)
    for frequency, delay in ((1.0, 0.2), (2.5, 0.15), (5.0, 0.1), (4.0, 0.2)):
        wave, late = (np.sin(2 * np.pi * frequency * (time - by)) for by in (0.0, delay))
        as_bench(Recording("r", time, {"command_rad": wave, "angle_rad": 0.3 * late}), FISH)
    fall = np.where(time < 1, -time, np.minimum(time - 2, 0.0))  # torque off, against the command
    columns = {"command_rad": -np.minimum(time, 2.0), "angle_rad": fall, "enabled_ratio": time < 1}
    as_bench(Recording("r", time, {k: 1.0 * v for k, v in columns.items()}), FISH)


def test_glitches_are_not_called_degrees(made):
    """A fifth of the samples are spikes; between 20 and 50 % the fit says so, and is written."""
    chirp = made["servo-chirp"]
    rng = np.random.default_rng(0)
    angle = chirp.columns["angle_rad"].copy()
    hit = rng.choice(angle.size, angle.size // 5, replace=False)
    angle[hit] = rng.uniform(20, 100, hit.size)
    bench = as_bench(with_column(chirp, angle_rad=angle), FISH)
    assert np.isnan(bench.angle).sum() > 0.9 * hit.size
    with pytest.raises(BadInput, match="looks like degrees"):
        as_bench(with_column(chirp, angle_rad=np.degrees(chirp.columns["angle_rad"])), FISH)


def test_a_number_at_the_end_of_its_range_is_not_trusted(made):
    space = servo_space([as_bench(made["servo-chirp"], FISH)])
    z = np.array([p.to_z(max(p.prior, 1e-4)) for p in space])
    assert at_edges(space, z) == []
    for name, end in (("kp", "low"), ("armature", "high"), ("delay", "high")):
        (index,) = (i for i, p in enumerate(space) if p.path == name)
        moved = z.copy()
        moved[index] = space[index].to_z(getattr(space[index], end))
        (said,) = at_edges(space, moved)
        assert said.startswith(name) and "stopped at the end of its range" in said
    (index,) = (i for i, p in enumerate(space) if p.path == "force_limit")
    z[index] = space[index].to_z(space[index].high)  # no recording reached it
    assert at_edges(space, z) == []


@pytest.mark.thorough
def test_a_load_that_is_stated_wrongly_is_told(tmp_path):
    """Two loads at one gain; the heavier is stated as a third of what it was."""
    runs = {}
    for weight, load in enumerate(sorted(SERVOS["mx64"].loads)):
        logs = [pendulum_log("mx64", motion, 8, load, weight) for motion in TRIED]
        runs[weight] = [bench_of(log, tmp_path, FISH) for log in logs]
    config = ServoConfig(seeds=1, effort=Effort(60, 32, 15, 300))
    right = as_report(identify_servo(FISH, runs[0] + runs[1], [], config, tmp_path / "right"))
    assert right["trusted"], right["verdict"]
    heavy = [pendulum_log("mx64", motion, 8, (1.0, 0.15), 1) for motion in TRIED]
    wrong = [bench_of({**log, "mass": 1 / 3}, tmp_path, FISH) for log in heavy]
    told = as_report(identify_servo(FISH, runs[0] + wrong, [], config, tmp_path / "wrong"))
    assert not told["trusted"] and "a stated gain or load is wrong" in told["verdict"][0]


def test_a_recording_is_fitted_or_a_test(tmp_path):
    words = ("identify", "servo", "--fish", "pulley-fish", "--fit", STEPS, "--out")
    said = complaint(*words, tmp_path / "a.toml", "--validate", STEPS)
    assert "given to --fit and to --validate" in said
    said = complaint(*words, tmp_path / "b.toml", "--cross-validate")
    assert "give --fit two recordings or more" in said
    assert not any(tmp_path.iterdir())
