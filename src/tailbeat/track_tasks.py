"""What do the camera's verbs do? Sheets to print, a calibration, poses, and a camera to try."""

import signal
import time
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from tailbeat import __version__
from tailbeat.files import BadInput, need, refuse_existing

Say = Callable[[str], None]
Pose = tuple[float, float, float]
PICTURES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm")
MOVED = 30.0  # px: two views of a board less apart say the same
EVERY = 0.5  # s between two lines
STARTING = 20.0  # s that the tracker may take on top
SURVEYED = [(x, y) for x in (-2.2, 0.0, 2.2) for y in (-1.0, 0.0, 1.0)]  # m, of a made survey
FIRST_TAG = 10  # of those


def need_extra() -> None:
    """Raises BadInput where the camera's packages are missing."""
    need("the camera", "robot", "cv2", "pyapriltags")


def sheets(out: Path, ids: tuple[int, int], side: float, square: float) -> list[Path]:
    """Write what is to be printed."""
    need_extra()
    from tailbeat.vision.sheet import write_sheets  # needs the extra
    from tailbeat.vision.tags import Board

    return write_sheets(out, ids, side, Board(square=square, marker=0.75 * square))


# ---- calibrate ----------------------------------------------------------------------------------


def calibrate(
    views: str, survey: Path, picture: str, sheet: dict[str, float], out: Path, count: int, say: Say
) -> dict[str, Any]:
    """Lens from views of the board, place from surveyed points, one file. `sheet`: the board's
    `square` and, of fish and target, `side` and `height` [m], as `fish_side` and so on."""
    need_extra()
    refuse_existing(out)
    from tailbeat.vision.calibration import Calibration, write_calibration
    from tailbeat.vision.survey import fit_lens, hang, read_survey
    from tailbeat.vision.tags import Board, Tag

    board = Board(square=sheet["square"], marker=0.75 * sheet["square"])
    known = read_survey(survey)
    images = list(_views(views, board, count, say))
    lens = fit_lens(images, board)
    say(f"lens: {len(images)} views, {lens.rms:.2f} px rms")
    points, pixels = _found(picture, known, say)
    hung = hang(lens, points, pixels)
    fish, target = (Tag(sheet[f"{n}_side"], sheet[f"{n}_height"]) for n in ("fish", "target"))
    provenance = {
        "views": views, "views_given": len(images), "survey": str(survey), "picture": picture,
        "points": [point.name for point in points], "board": vars(board),
        "tailbeat": __version__, "opencv": version("opencv-python-headless"),
    }  # fmt: skip
    write_calibration(out, Calibration(lens, hung, fish, target, provenance=provenance))
    return {
        "file": str(out), "views": len(images), "lens_rms_px": lens.rms,
        "focal_px": float(lens.matrix[0, 0]), "points": len(points),
        "place_rms_mm": 1e3 * hung.rms, "camera_m": hung.position.tolist(),
        "fish_height_m": fish.height, "target_height_m": target.height,
    }  # fmt: skip


def _is_camera(where: str) -> bool:
    return where.startswith(("unix:", "/dev/video")) or where.isdigit()


def _pictures(where: str) -> Iterator[tuple[str, Any]]:
    """Grey pictures of a file, of a folder's files, of a film or a camera, each with a name."""
    from tailbeat.vision.camera import CameraFault, open_camera

    path = Path(where)
    if path.is_dir() or path.suffix.lower() in PICTURES:
        paths = sorted(path.iterdir()) if path.is_dir() else [path]
        chosen = [one for one in paths if one.suffix.lower() in PICTURES]
        if not chosen:
            raise BadInput(f"{where}: no picture in it ({', '.join(PICTURES)}); give another.")
        yield from ((one.name, _picture(one)) for one in chosen)
        return
    camera = open_camera(where)
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
    import cv2

    image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise BadInput(f"{path}: OpenCV cannot read this picture; save it as PNG.")
    return image


def _views(where: str, board: Any, count: int, say: Say) -> Iterator[Any]:
    """Views for the lens: every picture of a folder; of films and cameras those in which the board
    has moved on, until there are `count`."""
    from tailbeat.vision.survey import board_corners

    if Path(where).is_dir():
        yield from (image for _, image in _pictures(where))
        return
    kept: list[Any] = []
    say(f"show the board everywhere in the picture, near and tilted; {count} views are taken")
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


def _found(picture: str, known: list[Any], say: Say) -> tuple[list[Any], Any]:
    """The surveyed points that are seen, and where (n, 2) [px]; a camera is asked for twenty
    frames, and the median taken, against waves."""
    from tailbeat.vision.detector import open_detector

    detector = open_detector()
    places: dict[int, list[Any]] = {}
    for number, (_, image) in enumerate(_pictures(picture), 1):
        for one in detector.find(image):
            places.setdefault(one.ident, []).append(one.corners.mean(axis=0))
        if number == 20:
            break
    points, pixels = [], []
    for point in known:
        seen = [point.pixel] if point.pixel else places.get(point.tag, [])
        if not seen:
            say(f"{point.name} is not seen, and left out")
            continue
        points.append(point)
        pixels.append(np.median(seen, axis=0))
    return points, np.array(pixels).reshape(-1, 2)


# ---- track --------------------------------------------------------------------------------------


def track(
    camera: str, calibration: Path, ids: tuple[int, int], seconds: float, oldest: float,
    exposure: float, latency: float, say: Say,
) -> dict[str, Any]:  # fmt: skip
    """Watch so long (0: until told to stop), say a line now and then, sum up."""
    need_extra()
    from tailbeat.vision.calibration import read_calibration
    from tailbeat.vision.camera import open_camera
    from tailbeat.vision.tracking import start_tracker

    made = read_calibration(calibration, oldest)
    open_camera(camera, made.lens.size).close()  # refused here if it is none, not again and again
    tracker = start_tracker(camera, made, ids, exposure=exposure, latency=latency)
    ended: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda n, _: ended.append(n))
    try:
        took = _follow(tracker, seconds, lambda: bool(ended), say)
    finally:
        tracker.close()
    return {"camera": camera, **summary(tracker, ids, took)}


def _follow(tracker: Any, seconds: float, stop: Callable[[], bool], say: Say) -> float:
    """Say what is seen; seconds from the first sighting to the end."""
    began, due, fault, first = time.monotonic(), 0.0, "", None
    while not stop():
        now = time.monotonic()
        sighting = tracker.newest()
        first = first or (now if sighting is not None else None)
        if tracker.fault != fault:
            fault = tracker.fault
            say(fault or "frames come again")
        if "the film is over" in fault or (
            seconds and now - (first or began + STARTING) >= seconds
        ):
            break
        if now >= due and sighting is not None and not fault:
            due = now + EVERY
            say(line(sighting))
        time.sleep(0.01)
    return time.monotonic() - (first or began)


def line(sighting: Any) -> str:
    """One sighting in words."""
    fish, target = sighting.frame.fish, sighting.frame.target
    swims = (
        f"{fish[0]:+.3f} {fish[1]:+.3f} m {np.degrees(fish[2]):+6.1f} deg" if fish else "not seen"
    )
    floats = f"{target[0]:+.3f} {target[1]:+.3f} m" if target else "not seen"
    rejects = ", ".join(f"{why} {count}" for why, count in sighting.rejected.items()) or "nothing"
    return f"fish {swims}; target {floats}; {sighting.rate:.1f} frames/s; rejected: {rejects}"


def summary(tracker: Any, ids: tuple[int, int], took: float) -> dict[str, Any]:
    """What a watch comes to."""
    last = tracker.newest()
    frames = last.frames if last else 0
    shares = [(last.believed.get(ident, 0) / frames if frames else 0.0) for ident in ids]
    return {
        "seconds": took,
        "frames": frames,
        "rate_hz": last.rate if last else 0.0,
        "fish_seen": shares[0],
        "target_seen": shares[1],
        "rejected": last.rejected if last else {},
        "restarts": tracker.restarts,
        "fault": tracker.fault,
    }


# ---- a camera to try it with --------------------------------------------------------------------


def film(socket: Path, fish: str, seconds: float, seed: int, say: Say) -> None:
    """A virtual camera at a socket over a fish that swims round and round, until told to stop."""
    need_extra()
    from tailbeat.benchmarks.vision import Course, fish_line
    from tailbeat.emulators.film import Filming, start_camera

    ended: list[int] = []
    course, drawn = Course(), fish_line(fish)
    camera = start_camera(socket, Filming(seed=seed))
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda n, _: ended.append(n))
    say(f"filming at {camera.where}")
    began = time.monotonic()
    while not ended and not (seconds and time.monotonic() - began >= seconds):
        camera.show(course.scene(time.monotonic() - began, drawn))
        time.sleep(0.004)
    camera.close()


def pictures(folder: Path, count: int, seed: int) -> None:
    """What a lab would take to calibrate: views of the board, a picture of tags in the water, and
    the table of their places."""
    need_extra()
    import cv2

    from tailbeat.emulators.camera import Renderer, Scene, board_views
    from tailbeat.emulators.optics import Optics
    from tailbeat.files import new_file
    from tailbeat.vision.tags import Board, Tag

    refuse_existing(folder)
    fish = Tag(height=-0.03)
    others = tuple((FIRST_TAG + k, (x, y, 0.0)) for k, (x, y) in enumerate(SURVEYED))
    pool = Renderer(Optics(), fish=fish, seed=seed).draw(Scene(others=others), 0.0)
    views = board_views(Optics(), Board(), count, seed)
    named = {f"views/{k:02d}.png": view for k, view in enumerate(views, 1)} | {"pool.png": pool}
    for name, image in named.items():
        with new_file(folder / name) as beside:
            cv2.imwrite(str(beside), image)
    rows = [f"{ident},{x},{y},{fish.height}" for ident, (x, y, _) in others]
    with new_file(folder / "survey.csv") as beside:
        beside.write_text("\n".join(["tag,x_m,y_m,z_m", *rows]) + "\n", encoding="utf-8")
