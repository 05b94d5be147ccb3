"""Two percent of wrong samples do not move what a clean recording decides; three used to."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from broken_sensors import glitched
from tailbeat.fish.store import load_fish
from tailbeat.identify.estimate import Estimate
from tailbeat.identify.intervals import estimates
from tailbeat.identify.polish import polish
from tailbeat.identify.search import Fit
from tailbeat.identify.servo import as_bench, blocks, residual_function, servo_space
from tailbeat.identify.servo_doubt import load_doubt, with_honest_intervals
from tailbeat.identify.servo_job import identify_servo
from tailbeat.identify.servo_report import as_report
from tailbeat.identify.servo_search import ServoConfig
from tailbeat.identify.shaft import Bench
from tailbeat.importers.xl330 import import_xl330
from tailbeat.recording import Recording, read_recording

BENCH = Path(__file__).parents[1] / "examples" / "bench"
FISH = load_fish("pulley-fish")
TRUTH = FISH.servos["identified"].model_dump()
RECORDINGS = [read_recording(BENCH / f"servo-{name}.csv") for name in ("steps", "triangle")]


def polished(benches: Sequence[Bench]) -> Mapping[str, Estimate]:
    """A fit that starts at the truth, without a search: what the data say near it."""
    space = servo_space(benches, gears=False)
    residuals = residual_function(benches, space)
    start = np.array([p.to_z(max(TRUTH[p.path], p.low)) for p in space])
    z = polish(residuals, space, start, 25, central=True)
    rough = Fit(0, z, 0.0, z, np.eye(z.size), np.eye(z.size))
    fit = with_honest_intervals(rough, residuals, blocks(benches))
    return estimates(
        space, [replace(fit, covariance=fit.covariance + load_doubt(space, z, benches))]
    )


def outside(found: Mapping[str, Estimate], clean: Mapping[str, Estimate]) -> list[str]:
    return [
        name
        for name, one in clean.items()
        if not one.interval[0] <= found[name].value <= one.interval[1]
    ]


def spiked(recording: Recording) -> Recording:
    """Three readings of -3.14 rad, as 15 % of another make's logs have one."""
    angle = recording.columns["angle_rad"].copy()
    step = max(angle.size // 400, 1)  # of the samples that are compared
    angle[[int(share * angle.size) // step * step for share in (0.2, 0.5, 0.8)]] = -3.14
    return replace(recording, columns={**recording.columns, "angle_rad": angle})


def test_three_wrong_readings_move_the_friction_if_kept_and_nothing_if_left_out():
    benches = [as_bench(one, FISH) for one in RECORDINGS]
    clean = polished(benches)
    wrong = [spiked(one).columns["angle_rad"] for one in RECORDINGS]
    kept = [replace(bench, angle=angle) for bench, angle in zip(benches, wrong, strict=True)]
    assert "friction" in outside(polished(kept), clean)
    left_out = [as_bench(spiked(one), FISH) for one in RECORDINGS]
    assert all(bench.good.sum() == bench.time.size - 3 for bench in left_out)
    assert outside(polished(left_out), clean) == []


@pytest.mark.thorough
def test_two_percent_of_glitches_keep_every_number_in_its_interval():
    clean = polished([as_bench(one, FISH) for one in RECORDINGS])
    for seed in range(3):
        broken = [glitched(r, ["angle_rad"], 10 * seed + i)[0] for i, r in enumerate(RECORDINGS)]
        assert outside(polished([as_bench(one, FISH) for one in broken]), clean) == [], seed


@pytest.mark.slow
@pytest.mark.parametrize("which", ["bench", "xl330"])
def test_the_whole_fit_keeps_what_is_decided(data, tmp_path, which):
    if which == "bench":
        names = ("chirp", "steps", "triangle")
        recordings = [read_recording(BENCH / f"servo-{name}.csv") for name in names]
    else:
        recordings = [import_xl330(path) for path in sorted((data / "xl330").glob("*.json"))]
    broken = [glitched(r, ["angle_rad"], seed)[0] for seed, r in enumerate(recordings)]
    clean, found = (
        as_report(
            identify_servo(FISH, [as_bench(r, FISH) for r in group], [], ServoConfig(), tmp_path)
        )
        for group in (recordings, broken)
    )
    assert sum(row["count"] for row in found["glitches"]) > 0.015 * sum(
        r.time.size for r in recordings
    )
    for name, row in clean["parameters"].items():
        if row["decided_by_data"]:
            low, high = row["interval"]
            assert low <= found["parameters"][name]["value"] <= high, name
    assert found["error_over_best_naive"] < 0.5
    # A frozen value in a fast stroke is within what a shaft can do: it stays, and costs a little.
    assert found["fit_mae_deg"] < clean["fit_mae_deg"] + 0.05
