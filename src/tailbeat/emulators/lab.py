"""Synthetic pictures to calibrate a virtual camera, as a lab would take them; and what a lab's
calibration gets wrong."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from tailbeat.emulators.board import board_views
from tailbeat.emulators.camera import Renderer, Scene
from tailbeat.emulators.film import Filming
from tailbeat.env.errors import Errors
from tailbeat.files import new_file, refuse_existing
from tailbeat.vision.calibration import Calibration
from tailbeat.vision.tags import Board

Array = NDArray[np.float64]

# Surveyed tags, over half of the pool's length and width.
SURVEYED = [(x, y) for x in (-0.8, 0.0, 0.8) for y in (-1 / 1.35, 0.0, 1 / 1.35)]
FIRST_TAG = 10  # id of the first of them
WIDE = 1.1  # tangent of the widest ray: more than to a corner of the pool from 3.2 m (0.96)


def pictures(folder: Path, count: int, seed: int, filming: Filming | None = None) -> None:
    """Write a lab's files for a calibration: views of the board, a picture of tags in the water,
    and the table of their positions. Raises BadInput."""
    refuse_existing(folder)
    seen = filming or Filming()
    optics, fish = seen.optics, seen.fish
    places = np.round(np.array(SURVEYED) * optics.pool / 2, 3).tolist()
    others = tuple((FIRST_TAG + k, (x, y, 0.0)) for k, (x, y) in enumerate(places))
    pool = Renderer(optics, fish=fish, seed=seed).draw(Scene(others=others), 0.0)
    views = board_views(optics, Board(), count, seed)
    named = {f"views/{k:02d}.png": view for k, view in enumerate(views, 1)} | {"pool.png": pool}
    for name, image in named.items():
        with new_file(folder / name) as beside:
            cv2.imwrite(str(beside), image)
    rows = [f"{ident},{x},{y},{fish.height}" for ident, (x, y, _) in others]
    with new_file(folder / "survey.csv") as beside:
        beside.write_text("\n".join(["tag,x_m,y_m,z_m", *rows]) + "\n", encoding="utf-8")


def miscalibrated(made: Calibration, wrong: Errors) -> Calibration:
    """A calibration by which true pictures are read with the errors `scale`, `turn` and `lens`.

    The camera's place and turn carry scale and rotation exactly, but for a tag's depth, which stays
    (1 mm at 3 cm). The lens's radial terms carry `lens`, about the camera's axis.
    """
    cos, sin = np.cos(wrong.turn), np.sin(wrong.turn)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    hung = replace(
        made.hung,
        rotation=made.hung.rotation @ turn.T,
        position=(1 + wrong.scale) * turn @ made.hung.position,
    )
    if not wrong.lens:
        return replace(made, hung=hung)
    distortion = _bent(made.lens.distortion, wrong.lens * made.hung.position[2] ** 2)
    return replace(made, lens=replace(made.lens, distortion=distortion), hung=hung)


def _bent(distortion: Array, more: float) -> Array:
    """Distortion (5,) by which a ray at `ray` from the axis is read at ray + `more` ray^3."""
    ray = np.linspace(0.05, WIDE, 50)
    powers = np.array([2, 4, 6])
    pixel = ray * (1 + (ray[:, None] ** powers) @ distortion[[0, 1, 4]])
    read = ray + more * ray**3
    terms = np.linalg.lstsq(read[:, None] ** (1 + powers), pixel - read, rcond=None)[0]
    return np.array([*terms[:2], *distortion[2:4], terms[2]])
