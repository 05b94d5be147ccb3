"""Calibrate a camera: its lens from views of a board, its position from surveyed points."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tailbeat import __version__
from tailbeat.files import BadInput, refuse_existing
from tailbeat.link.places import POOL
from tailbeat.vision.calibration import Calibration, write_calibration
from tailbeat.vision.camera import SIZE, CameraFault, is_device, open_camera
from tailbeat.vision.detector import open_detector
from tailbeat.vision.field_of_view import blind
from tailbeat.vision.survey import board_corners, fit_lens, hang, read_survey
from tailbeat.vision.tags import Tag, board_of

Say = Callable[[str], None]
PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm")
MOVED = 30.0  # px: a board that moved less gives no new view


@dataclass(frozen=True)
class Measured:
    """Values measured by hand: side of the board's squares [m], the tags, length and width of the
    pool [m]."""

    square: float
    fish: Tag
    target: Tag
    pool: tuple[float, float] = POOL


@dataclass(frozen=True)
class CalibrationResult:
    """Result of a calibration.

    The file; number of views and points; focal length and rms error of the lens [px]; rms error of
    the points [mm]; the camera's position [m]; heights of the tags above the water's surface [m];
    length and width of the pool [m].
    """

    file: str
    views: int
    lens_rms_px: float
    focal_px: float
    points: int
    place_rms_mm: float
    camera_m: list[float]
    fish_height_m: float
    target_height_m: float
    pool_m: list[float]


def calibrate(
    views: str, survey: Path, picture: str, sheet: Measured, out: Path, count: int, say: Say
) -> CalibrationResult:
    """Calibrate lens and position, and write one file.

    `views` is a folder, a film or a camera that shows the board; `survey` is a table of points;
    `picture` shows the points; `sheet` has what was measured by hand. Raises BadInput.
    """
    refuse_existing(out)
    board = board_of(sheet.square)
    known = read_survey(survey)
    images = list(_views(views, board, count, say))
    lens = fit_lens(images, board)
    say(f"lens: {len(images)} views, {lens.rms:.2f} px rms")
    points, pixels = _found(picture, known, lens.size, say)
    hung = hang(lens, points, pixels)
    fish, target = sheet.fish, sheet.target
    provenance = {
        "views": views, "views_given": len(images), "survey": str(survey), "picture": picture,
        "points": [point.name for point in points], "board": vars(board),
        "tailbeat": __version__, "opencv": version("opencv-python-headless"),
    }  # fmt: skip
    fixed = {point.tag: point.place for point in points if point.tag is not None}
    made = Calibration(lens, hung, fish, target, pool=sheet.pool, fixed=fixed,
                       provenance=provenance)  # fmt: skip
    if strips := blind(made):
        say(f"{strips}; hang the camera higher or over the middle, and calibrate again")
    write_calibration(out, made)
    return CalibrationResult(
        file=str(out), views=len(images), lens_rms_px=lens.rms,
        focal_px=float(lens.matrix[0, 0]), points=len(points), place_rms_mm=1e3 * hung.rms,
        camera_m=hung.position.tolist(), fish_height_m=fish.height,
        target_height_m=target.height, pool_m=list(sheet.pool),
    )  # fmt: skip


def _is_camera(where: str) -> bool:
    return where.startswith("unix:") or is_device(where)


def _pictures(where: str, size: tuple[int, int] = SIZE) -> Iterator[tuple[str, Any]]:
    """Grey pictures with names: of a picture file, a folder, a film or a camera, of which this
    `size` is requested."""
    path = Path(where)
    if path.is_dir() or path.suffix.lower() in PICTURES:
        paths = sorted(path.iterdir()) if path.is_dir() else [path]
        chosen = [one for one in paths if one.suffix.lower() in PICTURES]
        if not chosen:
            raise BadInput(f"{where}: no picture ({', '.join(PICTURES)}) in it; give another.")
        yield from ((one.name, _picture(one)) for one in chosen)
        return
    camera = open_camera(where, size)
    number = 0
    try:
        while True:
            number += 1
            yield f"frame {number}", camera.read()[0]
    except CameraFault as fault:
        if _is_camera(where) or number == 1:
            raise BadInput(str(fault)) from None
    finally:
        camera.close()


def _picture(path: Path) -> Any:
    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise BadInput(f"{path}: OpenCV cannot read this picture; save it as PNG.")
    return image


def _views(where: str, board: Any, count: int, say: Say) -> Iterator[Any]:
    """Views for the lens: every picture of a folder; of films and cameras, those in which the board
    has moved, until there are `count`."""
    if Path(where).is_dir():
        yield from (image for _, image in _pictures(where))
        return
    kept: list[Any] = []
    say(f"show the board everywhere in the picture, near and tilted; {count} views are needed")
    for _, image in _pictures(where):
        found = board_corners(image, board)
        if found is None:
            continue
        middle = found[1].mean(axis=0)
        if all(np.linalg.norm(middle - other) > MOVED for other in kept):
            kept.append(middle)
            say(f"view {len(kept)} of {count}")
            yield image
        if len(kept) == count:
            return


def _found(
    picture: str, known: list[Any], size: tuple[int, int], say: Say
) -> tuple[list[Any], Any]:
    """The surveyed points that are seen, and their pixels (n, 2). A point's pixel is the median of
    up to twenty frames, because waves move it. Raises BadInput if the picture has not the `size` of
    the lens's views."""
    detector = open_detector()
    places: dict[int, list[Any]] = {}
    for number, (name, image) in enumerate(_pictures(picture, size), 1):
        given = (image.shape[1], image.shape[0])
        if given != size:
            raise BadInput(
                f"{picture}: {name} has {given[0]} x {given[1]} pixels, the views of the board have"
                f" {size[0]} x {size[1]}; take both in the same mode of the camera."
            )
        for one in detector.find(image):
            places.setdefault(one.ident, []).append(one.corners.mean(axis=0))
        if number == 20:
            break
    points, pixels = [], []
    for point in known:
        seen = [point.pixel] if point.pixel else places.get(point.tag, [])
        if not seen:
            say(f"{point.name} is not seen and is left out")
            continue
        points.append(point)
        pixels.append(np.median(seen, axis=0))
    return points, np.array(pixels).reshape(-1, 2)
