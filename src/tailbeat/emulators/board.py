"""Views of a calibration board held in the air before the camera."""

import cv2
import numpy as np
from numpy.typing import NDArray

from tailbeat.emulators.optics import Optics, rays
from tailbeat.vision.tags import Board, board_picture

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]


def board_view(
    optics: Optics, board: Board, turn: Array, place: Array, rng: np.random.Generator
) -> Picture:
    """Draw a board held in the air before the camera: `turn` (3, 3) from the board (x across, y
    down its squares) to the camera, `place` [m] of its first corner in camera axes."""
    texture = cv2.copyMakeBorder(
        board_picture(board), 80, 80, 80, 80, cv2.BORDER_CONSTANT, value=255
    )
    flat = rays(optics)
    ahead = np.concatenate([flat, np.ones_like(flat[..., :1])], axis=-1)
    reach = turn[:, 2] @ place / (ahead @ turn[:, 2])
    on_board = (ahead * reach[..., None] - place) @ turn[:, :2]
    where = (on_board / board.square * 80 + 80 - 0.5).astype(np.float32)
    made = cv2.remap(texture, where[..., 0], where[..., 1], cv2.INTER_AREA, borderValue=110)
    grey = cv2.GaussianBlur(made, (0, 0), 0.7).astype(np.float32) * 0.65 + 35
    return np.clip(np.rint(grey + rng.normal(0, 2.0, grey.shape)), 0, 255).astype(np.uint8)


def board_views(optics: Optics, board: Board, count: int, seed: int = 0) -> list[Picture]:
    """Draw views like a person's: everywhere in the picture, tilted in all directions, near and
    far."""
    rng = np.random.default_rng(seed)
    size = board.square * np.array([board.columns, board.rows])
    made = []
    for _ in range(count):
        distance = rng.uniform(0.3, 0.6)
        spread = 0.42 * np.array(optics.size) / optics.focal * distance
        middle = np.append(rng.uniform(-1, 1, 2) * spread, distance)
        turn = np.asarray(cv2.Rodrigues(rng.uniform(-0.6, 0.6, 3) * [1, 1, 0.5])[0], float)
        made.append(board_view(optics, board, turn, middle - turn[:, :2] @ size / 2, rng))
    return made
