"""The whole chain in real time after a target that moves by the clock."""

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("cv2", reason="the robot extra is not installed")

from tailbeat.cli import progress
from tailbeat.emulators import live as chain
from tailbeat.emulators.film import Filming, known_calibration
from tailbeat.evaluate.following import FollowConfig, live
from tailbeat.operator.target_path import PathAsked, target_path
from tailbeat.report import following as page
from tailbeat.report.film_frames import Shot
from tailbeat.robot.log import read_rows
from tailbeat.vision.calibration import write_calibration

pytestmark = pytest.mark.realtime

SECONDS = 6.5  # the first 5 do not count


@pytest.fixture(scope="module")
def swum(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A circle at 0.1 m/s by the shipped follower. A busy machine may hold it, so how well it
    follows is asked in the plant (`test_follow_policy`). `test_film` renders and `test_live`
    calibrates; here the camera is known, and no frame is rendered."""
    out = tmp_path_factory.mktemp("path")
    asked = PathAsked("circle", speed=0.1, seconds=SECONDS)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(chain, "calibrate", known)
        followed = live(FollowConfig("pulley-fish-pool-follow", asked), out, print)
        patch.setattr(page.film, "write", not_rendered)
        page.write(followed, out, progress.counting, 1.0)
    return out


def known(folder: Path, swimming: chain.Chain, say: object) -> Path:
    """The camera's exact calibration."""
    write_calibration(folder / "camera.json", known_calibration(Filming()))
    return folder / "camera.json"


def not_rendered(shot: Shot, path: Path, _: object) -> None:
    """A film of a second of the log, but for its pictures."""
    assert shot.motion.frames >= 25 and np.isfinite(shot.motion.qpos).all()
    path.touch()


@pytest.mark.slow
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


@pytest.mark.thorough
def test_the_results_are_written_and_say_what_happened(swum):
    result = json.loads((swum / "summary.json").read_text())["result"]
    held = json.loads((swum / "path.json").read_text())["holds"]
    assert result["path"] == "circle" and result["target_speed"] == pytest.approx(0.1, rel=0.01)
    assert result["median_distance"] <= result["p95_distance"] <= result["largest_distance"] < 5
    assert result["holds"] == held and result["crossings"] is None
    for name in ("figures/path.svg", "report.html", "swim.mcap"):
        assert (swum / name).stat().st_size > 1000
    assert (swum / "swim.mp4").exists() and "There is no film" not in (
        swum / "report.html"
    ).read_text("utf-8")
