"""The camera's verbs: sheets that are true to size, a calibration from files, poses from a film."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("cv2", reason="the robot extra is not installed")
pytest.importorskip("pyapriltags", reason="the robot extra is not installed")

import cv2

from camera_views import FISH, TARGET, true_calibration
from support import tailbeat, tailbeat_process
from tailbeat.cli import develop
from tailbeat.emulators.camera import Renderer, Scene
from tailbeat.emulators.drawing import Picture
from tailbeat.emulators.lab import pictures
from tailbeat.emulators.optics import Optics
from tailbeat.files import BadInput
from tailbeat.vision.calibrate import Measured, calibrate
from tailbeat.vision.calibration import read_calibration, write_calibration
from tailbeat.vision.detector import open_detector
from tailbeat.vision.follow import TrackConfig, track
from tailbeat.vision.sheet import write_sheets
from tailbeat.vision.survey import board_corners
from tailbeat.vision.tags import IDS, Board, board_of, tag_picture

MM = 150 / 25.4  # pixels of a millimetre on a printed PNG, read at half its resolution
IDS_HERE = (0, 1)


def printed(path: Path) -> Picture:
    """A page at 150 dots per inch."""
    page = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    assert page is not None
    return np.asarray(
        cv2.resize(page, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), np.uint8
    )


def quiet(_: str) -> None:
    """Nobody listens."""


@pytest.fixture(scope="module")
def lab(tmp_path_factory) -> Path:
    """What a lab would have taken."""
    folder = tmp_path_factory.mktemp("lab") / "pictures"
    pictures(folder, 12, seed=3)
    return folder


@pytest.fixture(scope="module")
def pages(tmp_path_factory) -> list[Path]:
    """Fish (tag 7), target, board."""
    out = tmp_path_factory.mktemp("sheets") / "sheet.png"
    return write_sheets(out, (7, 1), 0.08, board_of(0.026))


# ---- sheets -------------------------------------------------------------------------------------


@pytest.mark.thorough
def test_printed_tags_are_true_to_size_and_their_arrow_is_the_x_axis(pages: list[Path]):
    names = [path.name for path in pages]
    assert names == ["sheet-fish.png", "sheet-target.png", "sheet-board.png"]
    page = printed(pages[0])
    (seen,) = open_detector().find(page)
    assert seen.ident == 7 and seen.side == pytest.approx(80 * MM, abs=1.5)
    begin, end = seen.corners[0], seen.corners[1]
    assert end - begin == pytest.approx([80 * MM, 0], abs=1.5)
    below = round(begin[1] + (10 + 12) * MM)  # white border, then twelve millimetres down
    arrow = page[below - 20 : below + 20] < 128
    columns = np.flatnonzero(arrow.any(axis=0))
    assert begin[0] > columns[0] and columns[-1] > end[0]  # along the whole tag
    heads = [arrow[:, at].sum() for at in (columns[0] + 10, columns[-1] - 10)]
    assert heads[1] > 1.5 * heads[0]  # the head lies at the tag's right


@pytest.mark.thorough
def test_the_printed_board_is_the_one_that_is_looked_for(pages: list[Path]):
    found = board_corners(printed(pages[2]), Board())
    assert found is not None
    points, pixels = found
    assert len(points) == 8 * 6
    away = np.linalg.norm(pixels - pixels[0], axis=1)
    assert away == pytest.approx(1e3 * MM * np.linalg.norm(points - points[0], axis=1), abs=2)


def test_a_pdf_has_three_pages_of_a4_and_an_svg_is_one(tmp_path: Path):
    (pdf,) = write_sheets(tmp_path / "sheet.pdf", IDS_HERE, 0.08, board_of(0.026))
    boxes = re.findall(rb"/MediaBox \[ 0 0 ([\d.]+) ([\d.]+) \]", pdf.read_bytes())
    sizes = [sorted(float(x) / 72 * 25.4 for x in box) for box in boxes]
    assert sizes == [pytest.approx([210, 297], abs=0.1)] * 3
    svg = write_sheets(tmp_path / "sheet.svg", IDS_HERE, 0.08, board_of(0.026))[0].read_text()
    assert float(re.findall(r'width="([\d.]+)pt"', svg)[0]) / 72 * 25.4 == pytest.approx(
        210, abs=0.1
    )


def test_sheets_that_cannot_be_are_refused(tmp_path: Path):
    (tmp_path / "taken-target.png").touch()
    for name, ids, side, square, complaint in (
        ("sheet.doc", IDS_HERE, 0.08, 0.026, "ends in .pdf, .svg, .png"),
        ("sheet.pdf", (IDS, 1), 0.08, 0.026, "tag 587: tag36h11 has 0 to 586"),
        ("sheet.pdf", IDS_HERE, 0.3, 0.026, "a page is A4"),
        ("sheet.pdf", IDS_HERE, 0.08, 0.05, "a page is A4"),
        ("taken.png", IDS_HERE, 0.08, 0.026, "exists already"),
    ):
        with pytest.raises(BadInput, match=complaint):
            write_sheets(tmp_path / name, ids, side, board_of(square))
    assert [path.name for path in tmp_path.iterdir()] == ["taken-target.png"]


def test_every_tag_is_the_library_s_own_and_differs_from_opencv_s():
    """OpenCV draws 36h11 turned by 180 degrees: why it draws none of ours."""
    theirs = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    drawn = np.asarray(theirs.generateImageMarker(0, 8))
    ours = tag_picture(0)[1:-1, 1:-1]
    assert np.array_equal(ours[[0, -1]], np.zeros((2, 8)))  # its black frame
    if not np.array_equal(drawn, ours):  # a later OpenCV may have turned them back
        assert np.array_equal(np.rot90(drawn, 2), ours)


# ---- calibrate ----------------------------------------------------------------------------------

SHEET = Measured(0.026, FISH, TARGET, (6.0, 3.0))


@pytest.mark.thorough
def test_a_lab_s_pictures_make_a_calibration(lab: Path, tmp_path: Path):
    out = tmp_path / "camera.json"
    done = calibrate(str(lab / "views"), lab / "survey.csv", str(lab / "pool.png"),
                                 SHEET, out, 20, quiet)  # fmt: skip
    assert done.points == 9 and done.place_rms_mm < 2 and done.views == 12
    made = read_calibration(out)
    assert made.hung.position == pytest.approx(Optics().position, abs=0.02)
    assert made.lens.matrix[0, 0] == pytest.approx(Optics().focal, rel=0.005)
    assert made.fish == FISH and made.target == TARGET and made.pool == (6.0, 3.0)
    assert made.provenance["points"][0] == "tag 10"


@pytest.mark.thorough
def test_views_are_taken_from_a_film_when_the_board_has_moved(lab: Path, tmp_path: Path):
    film, out = tmp_path / "board.avi", tmp_path / "camera.json"
    writer = cv2.VideoWriter(str(film), cv2.VideoWriter.fourcc(*"MJPG"), 30.0, (1280, 720))
    for path in sorted((lab / "views").iterdir()):
        for _ in range(2):
            writer.write(np.asarray(cv2.imread(str(path))))
    writer.release()
    heard: list[str] = []
    done = calibrate(str(film), lab / "survey.csv", str(lab / "pool.png"), SHEET, out,
                                 10, heard.append)  # fmt: skip
    assert done.views == 10 and "view 10 of 10" in heard
    assert done.focal_px == pytest.approx(Optics().focal, rel=0.01)


@pytest.mark.thorough
def test_what_is_missing_from_a_calibration_is_said(lab: Path, tmp_path: Path):
    views, pool, survey = str(lab / "views"), str(lab / "pool.png"), lab / "survey.csv"
    out = tmp_path / "camera.json"
    (tmp_path / "empty").mkdir()
    (tmp_path / "bad.png").write_text("no picture")
    (tmp_path / "large").mkdir()
    large = str(tmp_path / "large" / "pool.png")
    cv2.imwrite(large, cv2.resize(np.asarray(cv2.imread(pool)), (1920, 1080)))
    for given, complaint in (
        ((views, survey, str(lab / "views" / "01.png")), "0 surveyed points were seen; 4 are"),
        ((str(tmp_path / "empty"), survey, pool), "no picture .*in it"),
        ((views, survey, str(tmp_path / "bad.png")), "cannot read this picture"),
        ((views, tmp_path / "none.csv", pool), "give a CSV table"),
        ((pool, survey, pool), "found in 0 of"),
        ((views, survey, large), "1920 x 1080 pixels, the views of the board have 1280 x 720"),
    ):
        with pytest.raises(BadInput, match=complaint):
            calibrate(*given, SHEET, out, 20, quiet)
    assert not out.exists()


# ---- track --------------------------------------------------------------------------------------


def test_a_film_is_tracked_to_its_end(tmp_path: Path):
    path, renderer = tmp_path / "swim.avi", Renderer(fish=FISH, target=TARGET)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 60.0, (1280, 720))
    for k in range(12):
        image = renderer.draw(Scene((0.01 * k, 0.2, 0.3), target=(1.0, 0.5, 0.0)), k / 60)
        writer.write(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
    writer.release()
    write_calibration(tmp_path / "camera.json", true_calibration())
    heard: list[str] = []
    config = TrackConfig(str(path), tmp_path / "camera.json", IDS_HERE, 0.002, 0.0)
    done = track(config, 60.0, heard.append)
    assert done.frames == 12 and done.fish_seen == done.target_seen == 1.0
    assert "the film is over after 12 frames" in done.fault
    assert any("fish" in line and "deg" in line for line in heard)


@pytest.mark.thorough
def test_the_verbs_print_write_and_refuse(tmp_path: Path):
    done = tailbeat_process("tags", "--out", tmp_path / "s.pdf", "--json", tmp_path / "s.json")
    assert done.returncode == 0, done.stderr
    assert json.loads((tmp_path / "s.json").read_text()) == {"sheets": [str(tmp_path / "s.pdf")]}
    write_calibration(tmp_path / "camera.json", true_calibration())
    done = tailbeat("track", "--camera", "no.avi", "--calibration", tmp_path / "camera.json")
    assert done.returncode == 2, done.stdout
    assert "no such camera" in done.stderr and "Traceback" not in done.stderr
    with pytest.raises(BadInput, match="give either --socket or --pictures"):
        develop.camera()
