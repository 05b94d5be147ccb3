"""The whole chain in real time after a target that moves by the clock."""

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("cv2", reason="the robot extra is not installed")

from tailbeat.cli import progress
from tailbeat.evaluate.following import FollowConfig, live
from tailbeat.operator.target_path import PathAsked, target_path
from tailbeat.report import following as page
from tailbeat.robot.log import read_rows

pytestmark = pytest.mark.realtime

SECONDS = 8.0


@pytest.fixture(scope="module")
def swum(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A circle at 0.1 m/s by the shipped policy. How well it follows is not asked here."""
    out = tmp_path_factory.mktemp("path")
    asked = PathAsked("circle", speed=0.1, seconds=SECONDS)
    followed = live(FollowConfig("pulley-fish-pool-generator", asked), out, print)
    page.write(followed, out, progress.counting, 1.0)
    return out


def test_the_targets_in_the_fish_s_log_are_those_of_the_clock(swum):
    path = target_path(PathAsked("circle", speed=0.1, seconds=SECONDS))
    began = json.loads((swum / "path.json").read_text())["began"]
    rows = [row for row in read_rows(swum / "swim.mcap") if len(row["decided_on"])]
    frames = np.array([row["decided_on"][:6] for row in rows], float)
    filmed = np.array([row["time_s"] for row in rows]) - frames[:, 5] - began
    inside = (filmed > 0.2) & (filmed < SECONDS)
    assert inside.sum() > 100 and np.ptp(filmed[inside]) > 3.0
    off = np.hypot(*(frames[inside, 3:5] - path.along(filmed[inside])).T)
    assert np.median(off) < 0.02 and np.quantile(off, 0.95) < 0.02
    moved = np.hypot(*np.ptp(frames[inside, 3:5], axis=0))
    assert moved > 0.2  # it did not wait


def test_the_results_are_written_and_say_what_happened(swum):
    result = json.loads((swum / "summary.json").read_text())["result"]
    held = json.loads((swum / "path.json").read_text())["holds"]
    assert result["path"] == "circle" and result["target_speed"] == pytest.approx(0.1, rel=0.01)
    assert result["median_distance"] <= result["p95_distance"] <= result["largest_distance"] < 5
    assert result["holds"] == held and result["crossings"] is None
    for name in ("figures/path.svg", "report.html", "swim.mcap"):
        assert (swum / name).stat().st_size > 1000
    assert (swum / "swim.mp4").exists() or "There is no film" in (swum / "report.html").read_text()
