"""Calibration: the lens from views of a ChArUco board, the camera's pose from surveyed points in
the pool, also under water.
"""

import csv
import math
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from tailbeat.files import BadInput
from tailbeat.vision.calibration import WATER, Hung, Lens, places
from tailbeat.vision.tags import Board, charuco

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]
VIEWS = 8  # least number of views of the board
CORNERS = 12  # least number of corners in a view
WORST_LENS = 1.0  # px rms: above it the board is not flat or something moved; chosen
WORST_PLACE = 0.02  # m: a point with a larger error was measured or written down wrong; chosen


# ---- the lens -----------------------------------------------------------------------------------


def board_corners(image: Picture, board: Board) -> tuple[Array, Array] | None:
    """Positions on the board (n, 3) [m] and pixels (n, 2) of the corners seen, or None if too
    few."""
    drawn = charuco(board)
    corners, ids, _, _ = cv2.aruco.CharucoDetector(drawn).detectBoard(image)
    if ids is None or len(ids) < CORNERS:
        return None
    points, pixels = drawn.matchImagePoints(corners, ids)
    return points.reshape(-1, 3).astype(float), pixels.reshape(-1, 2).astype(float)


def fit_lens(images: Iterable[Picture], board: Board) -> Lens:
    """Fit the lens to views of a board that is held everywhere in the picture and tilted. Raises
    BadInput if too few views show it, sizes differ or the fit is poor."""
    seen: list[tuple[Array, Array]] = []
    size, count = (0, 0), 0
    for count, image in enumerate(images, 1):
        shape = (image.shape[1], image.shape[0])
        if seen and shape != size:
            raise BadInput(f"view {count}: {shape}, the others {size} pixels; use one camera mode.")
        size = shape
        found = board_corners(image, board)
        if found is not None:
            seen.append(found)
    if len(seen) < VIEWS:
        raise BadInput(
            f"the board was found in {len(seen)} of {count} views; {VIEWS} are needed. Check"
            f" light, focus, {board.columns} x {board.rows} squares of {1e3 * board.square:g} mm."
        )
    points, pixels = ([pair[k].astype(np.float32) for pair in seen] for k in (0, 1))
    rms, matrix, distortion, *_ = cv2.calibrateCamera(points, pixels, size, None, None)
    if not rms <= WORST_LENS:
        raise BadInput(
            f"the lens fits to {rms:.2f} px rms; at most {WORST_LENS:g} is allowed."
            " Use a flat board and a fixed focus."
        )
    return Lens(size, np.array(matrix, float), np.array(distortion, float).ravel()[:5], float(rms))


# ---- where the camera hangs ---------------------------------------------------------------------


@dataclass(frozen=True)
class Surveyed:
    """A point at a known position: x, y and height above the water's surface [m]; with the tag at
    that point, or the pixel where it was seen."""

    place: tuple[float, float, float]
    tag: int | None = None
    pixel: tuple[float, float] | None = None

    @property
    def name(self) -> str:
        """For messages."""
        return f"tag {self.tag}" if self.tag is not None else f"the point at {self.place[:2]}"


def read_survey(path: Path) -> list[Surveyed]:
    """Read a table x_m, y_m, z_m (0: the surface, negative under water) with `tag`, or u_px and
    v_px. Raises BadInput."""
    if not path.is_file():  # a device or a pipe would be read without end
        raise BadInput(f"{path}: no such file; give a CSV table of surveyed points.")
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise BadInput(f"{path}: {error}; give a CSV table of surveyed points.") from None
    return [_surveyed(path, number, row) for number, row in enumerate(rows, 1)]


def _surveyed(path: Path, number: int, row: dict[str, str]) -> Surveyed:
    try:
        x, y, z = (float(row[name]) for name in ("x_m", "y_m", "z_m"))
        if row.get("tag"):
            made = Surveyed((x, y, z), tag=int(row["tag"]))
        else:
            made = Surveyed((x, y, z), pixel=(float(row["u_px"]), float(row["v_px"])))
    except (KeyError, TypeError, ValueError):
        raise BadInput(
            f"{path}, row {number}: {_short(row)}; give x_m, y_m, z_m and tag, or u_px and v_px:"
            f" numbers."
        ) from None
    if not all(map(math.isfinite, (x, y, z, *(made.pixel or ())))):
        raise BadInput(f"{path}, row {number}: {_short(row)}; the numbers must be finite.")
    return made


def _short(row: dict[str, str]) -> str:
    """A row for a message."""
    return textwrap.shorten(str(row), 200)


def hang(lens: Lens, points: Sequence[Surveyed], pixels: Array, index: float = WATER) -> Hung:
    """Fit the camera's pose so that `pixels` (n, 2) are at the surveyed points. Raises BadInput for
    fewer than four points, points on a line, or a point that does not fit the others."""
    known = np.array([point.place for point in points])
    if len(points) < 4 or np.linalg.svd(known[:, :2] - known[:, :2].mean(axis=0))[1][1] < 0.1:
        raise BadInput(
            f"{len(points)} surveyed points were seen; 4 are needed, better 8, spread over the"
            f" pool's length and width."
        )

    def away(guess: Array) -> Array:
        turn, _ = cv2.Rodrigues(guess[:3])
        found = places(lens, np.asarray(turn, float), guess[3:], pixels, known[:, 2], index)
        return np.asarray(np.nan_to_num(found - known[:, :2], nan=10.0)).ravel()

    best = least_squares(away, _first_guess(lens, known, pixels, index), loss="soft_l1",
                         f_scale=0.005, x_scale=[0.1] * 6)  # fmt: skip
    errors = np.linalg.norm(away(best.x).reshape(-1, 2), axis=1)
    worst = int(np.argmax(errors))
    if not errors[worst] <= WORST_PLACE:
        raise BadInput(
            f"{points[worst].name} is {1e3 * errors[worst]:.0f} mm from where the others put it;"
            f" at most {1e3 * WORST_PLACE:g} mm are allowed. Measure it again, also its height z."
        )
    turn, _ = cv2.Rodrigues(best.x[:3])
    if best.x[5] <= 0:
        raise BadInput(
            "the camera would be under water; the survey's axes must be x, y left, z up."
        )
    return Hung(np.asarray(turn, float), best.x[3:], float(np.sqrt(np.mean(errors**2))))


def _first_guess(lens: Lens, known: Array, pixels: Array, index: float) -> Array:
    """First guess: water only raises what is under it. Turn (3,) [rad] and position (3,) [m]."""
    lifted = known.copy()
    lifted[:, 2] = np.where(known[:, 2] < 0, known[:, 2] / index, known[:, 2])
    _, turn, shift = cv2.solvePnP(
        lifted, pixels, lens.matrix, lens.distortion, flags=cv2.SOLVEPNP_SQPNP
    )
    rotation, _ = cv2.Rodrigues(turn)
    return np.concatenate([turn.ravel(), (-rotation.T @ shift).ravel()])
