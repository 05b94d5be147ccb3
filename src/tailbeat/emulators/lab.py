"""Synthetic pictures to calibrate a virtual camera, as a lab would take them."""

from pathlib import Path

import cv2

from tailbeat.emulators.board import board_views
from tailbeat.emulators.camera import Renderer, Scene
from tailbeat.emulators.optics import Optics
from tailbeat.files import new_file, refuse_existing
from tailbeat.vision.tags import Board, Tag

SURVEYED = [
    (x, y) for x in (-2.2, 0.0, 2.2) for y in (-1.0, 0.0, 1.0)
]  # m, positions of the surveyed tags
FIRST_TAG = 10  # id of the first of them


def pictures(folder: Path, count: int, seed: int) -> None:
    """Write a lab's files for a calibration: views of the board, a picture of tags in the water,
    and the table of their positions. Raises BadInput."""
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
