"""AprilTag 36h11 as the tag library draws them, and the calibration board.

OpenCV's dictionary has the same tags rotated by 180 degrees, and another version may rotate them
back: with such a tag, the fish would appear to swim backwards. So no tag here is drawn by OpenCV.
The board's markers are of another family, which the tracker ignores.
"""

import ctypes
from dataclasses import dataclass
from functools import cache
from typing import Any

import cv2
import numpy as np
import pyapriltags
from numpy.typing import NDArray
from pyapriltags.apriltags import _image_u8_get_array, _ImageU8

from tailbeat.files import BadInput

Picture = NDArray[np.uint8]
FAMILY = "tag36h11"
FISH, TARGET = 0, 1  # ids, unless others are given
MODULES, BLACK = 10, 8  # modules of a side: with the white border, and of the black square
IDS = 587
SAME_SIZE = 0.05  # of a side: closer than the tracker can tell (chosen)
SIDE = 0.08  # m, of the paper's tag: of a fish that does not say its own


@dataclass(frozen=True)
class Tag:
    """A printed tag: `side` of its black square [m], `height` above the water's surface [m],
    negative below it. Its x axis, the arrow on the sheet, points towards the fish's nose."""

    side: float = SIDE
    height: float = 0.0


def of_other_size(calibrated: Tag, described: float | None) -> str:
    """A sentence part if a camera was calibrated for a tag of another size than the fish's
    `described` side [m] (None: not described); "" if not."""
    if described is None or abs(calibrated.side / described - 1) < SAME_SIZE:
        return ""
    return (
        f"calibrated for a tag of {1e3 * calibrated.side:g} mm, and the fish's has"
        f" {1e3 * described:g} mm"
    )


@dataclass(frozen=True)
class Board:
    """A ChArUco board: squares across and down, sides of a square and of its marker [m]. The rows
    are odd, because OpenCV 4.6 changed boards with an even number."""

    columns: int = 9
    rows: int = 7
    square: float = 0.026
    marker: float = 0.0195


def board_of(square: float) -> Board:
    """The board with squares of this side [m]."""
    return Board(square=square, marker=0.75 * square)


@cache
def tag_picture(ident: int) -> Picture:
    """A tag's modules (10, 10), 0 or 255, with its white border; row 0 is the top, columns follow
    the arrow. Drawn by `apriltag_to_image`. Raises BadInput for an id that 36h11 does not have."""
    if not 0 <= ident < IDS:
        raise BadInput(f"tag {ident}: {FAMILY} has 0 to {IDS - 1}; choose one of those.")
    detector: Any = pyapriltags.Detector(FAMILY)
    draw = detector.libc.apriltag_to_image
    draw.restype = ctypes.POINTER(_ImageU8)
    drawn = draw(detector.tag_families[FAMILY], ident)
    shape = drawn.contents.height, drawn.contents.width
    made: Picture = _image_u8_get_array(drawn)[:, : shape[1]].copy()
    detector.libc.image_u8_destroy(drawn)
    assert made.shape == (MODULES, MODULES), made.shape
    made.flags.writeable = False
    return made


def charuco(board: Board) -> Any:
    """OpenCV's board."""
    markers = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    size = (board.columns, board.rows)
    return cv2.aruco.CharucoBoard(size, board.square, board.marker, markers)


@cache
def board_picture(board: Board, square: int = 80) -> Picture:
    """The board, `square` pixels a square, without a margin."""
    made = charuco(board).generateImage((square * board.columns, square * board.rows))
    return np.asarray(made, np.uint8)
