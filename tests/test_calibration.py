"""Calibration on rendered views: what it finds, and what it refuses."""

import hashlib
import json
import math
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("cv2", reason="the robot extra is not installed")
pytest.importorskip("pyapriltags", reason="the robot extra is not installed")

from camera_views import FISH, TARGET, true_calibration
from tailbeat.emulators.board import Picture, board_views
from tailbeat.emulators.optics import Optics, project
from tailbeat.files import BadInput
from tailbeat.vision.calibration import Calibration, Lens, read_calibration, write_calibration
from tailbeat.vision.survey import Surveyed, fit_lens, hang, read_survey
from tailbeat.vision.tags import Board

OPTICS, BOARD = Optics(), Board()
RNG = np.random.default_rng(1)
GRID = [(x, y) for x in (-2.2, 0.0, 2.2) for y in (-1.0, 1.0)]


@pytest.fixture(scope="module")
def views() -> list[Picture]:
    return board_views(OPTICS, BOARD, 14, seed=2)


@pytest.fixture(scope="module")
def lens(views) -> Lens:
    return fit_lens(views, BOARD)


def surveyed(height: float) -> tuple[list[Surveyed], np.ndarray]:
    points = [Surveyed((x, y, height), tag=10 + k) for k, (x, y) in enumerate(GRID)]
    pixels = project(OPTICS, np.array([point.place for point in points]))
    return points, pixels + RNG.normal(0, 0.1, pixels.shape)


@pytest.mark.thorough
def test_the_lens_is_found_from_views_of_a_board(lens):
    assert lens.size == OPTICS.size and lens.rms < 0.4
    assert lens.matrix[0, 0] == pytest.approx(OPTICS.focal, rel=0.004)
    assert lens.matrix[:2, 2] == pytest.approx(OPTICS.centre, abs=2.0)
    assert lens.distortion[0] == pytest.approx(OPTICS.radial[0], abs=0.01)


@pytest.mark.thorough
@pytest.mark.parametrize("height", [0.1, 0.0, -0.05, -0.2])
def test_the_camera_s_place_is_found_from_points_in_and_above_the_water(lens, height):
    points, pixels = surveyed(height)
    hung = hang(lens, points, pixels)
    assert hung.position == pytest.approx(OPTICS.position, abs=0.015) and hung.rms < 0.002
    places = np.column_stack([RNG.uniform(-2.6, 2.6, 200), RNG.uniform(-1.3, 1.3, 200)])
    for other in (height, 0.0, -0.05):  # fish and target need not lie where it was surveyed
        seen = project(OPTICS, np.column_stack([places, np.full(200, other)]))
        found = Calibration(lens, hung, FISH, TARGET).places(seen, other)
        assert np.linalg.norm(found - places, axis=1).max() < 0.005


@pytest.mark.parametrize(
    "tilt, position",
    [
        ((0, 0, math.pi), (0.2, 0.1, 3.2)),
        ((0.02, 0.01, -math.pi / 2), (0.1, 0.0, 6.0)),
        ((-0.25, 0, 0.1), (0.2, -1.1, 3.3)),
    ],
    ids=["turned over", "across", "from the side"],
)
def test_a_camera_may_hang_turned_or_askew(tilt, position):
    optics = Optics(tilt=tilt, position=position)
    points = [Surveyed((x, y, z)) for x, y in GRID for z in (0.0, -0.1)]
    pixels = project(optics, np.array([point.place for point in points]))
    assert ((pixels > 0) & (pixels < optics.size)).all()
    hung = hang(true_calibration(optics).lens, points, pixels)
    assert hung.position == pytest.approx(optics.position, abs=1e-3)
    assert hung.rotation == pytest.approx(optics.rotation, abs=1e-3)


def test_too_few_views_of_the_board_are_refused(views):
    blank = np.full((720, 1280), 90, np.uint8)
    with pytest.raises(BadInput, match="found in 3 of 6 views; 8 are needed"):
        fit_lens([*views[:3], blank, blank, blank], BOARD)
    with pytest.raises(BadInput, match="view 3"):
        fit_lens([*views[:2], blank[:480]], BOARD)


def test_a_point_written_down_wrong_is_named():
    points, pixels = surveyed(0.0)
    points[4] = Surveyed((2.2, -0.9, 0.0), tag=14)
    with pytest.raises(BadInput, match=r"tag 14 is \d+ mm from where the others put it"):
        hang(true_calibration().lens, points, pixels)


def test_points_too_few_or_on_a_line_are_refused():
    points, pixels = surveyed(0.0)
    line = [point for point in points if point.place[1] > 0]
    for some in (points[:3], line + line):
        with pytest.raises(BadInput, match="4 are needed, better 8, spread over"):
            hang(true_calibration().lens, some, pixels[: len(some)])


def test_a_survey_is_read_by_tag_or_pixel_and_nonsense_is_named(tmp_path: Path):
    path = tmp_path / "survey.csv"
    path.write_text("# the pool on Monday\ntag,x_m,y_m,z_m,u_px,v_px\n11,1,2,-0.03,,\n,0,0,0,5,6\n")
    one, two = read_survey(path)
    assert one == Surveyed((1.0, 2.0, -0.03), tag=11) and two.pixel == (5.0, 6.0)
    for text in ("tag,x_m,y_m\n1,0,0\n", "tag,x_m,y_m,z_m\n1,left,0,0\n", "x_m,y_m,z_m\n0,0,0\n"):
        path.write_text(text)
        with pytest.raises(BadInput, match="row 1"):
            read_survey(path)
    path.write_text("tag,x_m,y_m,z_m\n1,nan,0,0\n")
    with pytest.raises(BadInput, match="must be finite"):
        read_survey(path)
    with pytest.raises(BadInput, match="give a CSV table"):
        read_survey(tmp_path / "none.csv")


# ---- the file -----------------------------------------------------------------------------------


def test_a_calibration_is_read_back_as_it_was_written(tmp_path: Path):
    made, path = true_calibration(), tmp_path / "camera.json"
    write_calibration(path, made)
    back = read_calibration(path)
    assert back.digest == hashlib.sha256(path.read_bytes()).digest()
    assert back.lens.size == made.lens.size and np.array_equal(back.lens.matrix, made.lens.matrix)
    assert np.array_equal(back.lens.distortion, made.lens.distortion)
    assert np.array_equal(back.hung.rotation, made.hung.rotation)
    assert (back.fish, back.target, back.index) == (made.fish, made.target, made.index)
    assert back.pool == made.pool == (5.5, 2.7)
    assert datetime.now(UTC) - datetime.fromisoformat(back.made) < timedelta(minutes=5)
    with pytest.raises(BadInput, match="exists already"):
        write_calibration(path, made)


def spoilt(path: Path, **changes: Any) -> Path:
    """A calibration's file with fields changed; None takes them out."""
    path.unlink(missing_ok=True)
    write_calibration(path, true_calibration())
    data = {**json.loads(path.read_text()), **changes}
    path.write_text(json.dumps({k: v for k, v in data.items() if v is not None}))
    return path


@pytest.mark.parametrize(
    "changes, complaint",
    [
        ({"matrix": None}, "matrix is missing"),
        ({"fish": None}, "fish is missing"),
        ({"kind": "a photo"}, "give a file of tailbeat calibrate"),
        ({"made": "yesterday"}, "made 'yesterday'"),
        ({"made": "2026-01-01T00:00:00"}, "a date with its zone"),
        ({"made": "2020-01-01T00:00:00+00:00"}, "at most 30 days are allowed"),
        ({"made": "2090-01-01T00:00:00+00:00"}, "at most 30 days are allowed"),
        ({"distortion": [0, 0, 0]}, r"allowed: 5 finite number\(s\)"),
        ({"position": [0, 0, math.nan]}, "position"),
        ({"position": [0, 0, -1]}, "impossible for a camera"),
        ({"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]}, "impossible for a camera"),
        ({"size": [0, 720]}, "impossible for a camera"),
        ({"index": 4}, "impossible for a camera"),
        ({"target": {"side": 0.08}}, "target.height = None"),
        ({"fish": {"side": -1, "height": 0}}, "side above 0"),
        ({"fish": "big"}, "fish.side = None"),
        ({"pool": [5.5]}, r"pool = \[5.5\]; allowed: 2 finite"),
        ({"pool": [5.5, 0]}, "each side must be 0.3 to 100 m"),
    ],
)
def test_what_a_calibration_may_not_be_is_named(tmp_path: Path, changes, complaint):
    with pytest.raises(BadInput, match=complaint):
        read_calibration(spoilt(tmp_path / "camera.json", **changes))


def test_a_calibration_made_before_it_held_the_pool_is_read(tmp_path: Path):
    assert read_calibration(spoilt(tmp_path / "camera.json", pool=None)).pool is None


def test_an_old_calibration_is_taken_where_that_is_asked_for(tmp_path: Path):
    path = spoilt(tmp_path / "camera.json", made="2020-01-01T00:00:00+00:00")
    assert read_calibration(path, oldest=1e5).lens.size == (1280, 720)
    path.write_text("{")
    with pytest.raises(BadInput, match="give a file of tailbeat calibrate"):
        read_calibration(path)
