"""Optics of a camera above the pool: lens, pose, refraction at the surface.

A calibration has to find these values. Independent of `vision/calibration.py`, which computes the
inverse, from pixels to positions. Pixel centres are at whole numbers.
"""

from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from tailbeat.link.places import POOL

Array = NDArray[np.float64]
LEAST_SIDE = 14.0  # px of a tag; of 12 px, two in five were not found while the fish swam
STEPS = 4  # Newton steps: error below 1 nm at depths up to 1 m
ROUNDS = 14  # iterations of the lens's inverse: error below 1e-6 px at the picture's corners


@dataclass(frozen=True)
class Optics:
    """A wide lens 3.2 m above the middle of a pool of 5.5 x 2.7 m, slightly tilted; all chosen. It
    sees a tag everywhere in the pool (at 3 m it did not, 4.5 cm along one wall). `above` hangs it
    over another pool.

    `focal`, `centre` [px]; `radial` (k1, k2) and `tangential` (p1, p2) as in OpenCV; `position` [m]
    in the pool; `tilt` [rad] about the pool's x, y, z, from looking straight down with the
    picture's x along the pool's; `pool` length and width [m].
    """

    size: tuple[int, int] = (1280, 720)
    focal: float = 750.0
    centre: tuple[float, float] = (645.3, 352.8)
    radial: tuple[float, float] = (-0.12, 0.02)
    tangential: tuple[float, float] = (0.0004, -0.0003)
    position: tuple[float, float, float] = (0.05, -0.03, 3.2)
    tilt: tuple[float, float, float] = (0.012, -0.009, 0.015)
    index: float = 1.333  # of water, 20 degrees C, sodium light
    pool: tuple[float, float] = POOL

    @cached_property
    def rotation(self) -> Array:
        """From the pool's axes to the camera's (x right, y down, z ahead), (3, 3)."""
        (a, b, c), one = self.tilt, np.eye(3)
        turns = []
        for axis, angle in enumerate((a, b, c)):
            i, j = (axis + 1) % 3, (axis + 2) % 3
            turn = one.copy()
            turn[i, i] = turn[j, j] = np.cos(angle)
            turn[i, j], turn[j, i] = -np.sin(angle), np.sin(angle)
            turns.append(turn)
        return np.diag([1.0, -1.0, -1.0]) @ turns[0] @ turns[1] @ turns[2]

    @property
    def scale(self) -> float:
        """Pixels of a metre on the surface, straight below the camera."""
        return self.focal / self.position[2]


def above(pool: tuple[float, float], side: float) -> Optics:
    """The camera so high above a pool of this length and width [m] that it sees all of it, with as
    many pixels as a tag of this `side` [m] needs."""
    usual = Optics()
    share = max(own / other for own, other in zip(pool, usual.pool, strict=True))
    x, y, z = (share * one for one in usual.position)
    hung = replace(usual, position=(x, y, z), pool=pool)
    finer = max(LEAST_SIDE / (side * hung.scale), 1.0)
    columns, rows = (round(finer * one) for one in usual.size)
    middle = (finer * usual.centre[0], finer * usual.centre[1])
    return replace(hung, size=(columns, rows), focal=finer * usual.focal, centre=middle)


def project(optics: Optics, points: Array, slopes: Array | None = None) -> Array:
    """Pixels (n, 2) of positions (n, 3) [m] in the pool. Points with z < 0 are seen through the
    surface, whose `slopes` (n, 2) shift them (to first order)."""
    return _distorted(optics, (through_surface(optics, points, slopes) - optics.position))


def through_surface(optics: Optics, points: Array, slopes: Array | None = None) -> Array:
    """Where light from each position (n, 3) leaves the water towards the camera; positions above
    the water do not change. Snell: sin(in air) = index sin(in water)."""
    camera = np.array(optics.position)
    depth = np.maximum(-points[:, 2], 0.0)
    away = points[:, :2] - camera[:2]
    if slopes is not None:
        away = away + depth[:, None] * (1 - 1 / optics.index) * slopes
    far = np.linalg.norm(away, axis=1)
    share = _crossing(camera[2], depth, far, optics.index) / np.maximum(far, 1e-12)
    crossed = np.column_stack([camera[:2] + away * share[:, None], np.zeros(len(points))])
    return np.where(depth[:, None] > 0, crossed, points)


def _crossing(height: float, depth: Array, far: Array, index: float) -> Array:
    """Horizontal distance from the camera at which light from `far` away and `depth` down leaves
    the water."""
    near = far * height / (height + depth / index)
    for _ in range(STEPS):
        up, down = np.hypot(near, height), np.hypot(far - near, depth) + 1e-12
        error = near / up - index * (far - near) / down
        slope = height**2 / up**3 + index * depth**2 / down**3
        near = near - error / np.maximum(slope, 1e-12)
    return np.clip(near, 0.0, far)


def _distorted(optics: Optics, seen: Array) -> Array:
    """Pixels (n, 2) of directions (n, 3) in the pool's axes."""
    ahead = seen @ optics.rotation.T
    return lens(optics, ahead[:, :2] / ahead[:, 2:])


def lens(optics: Optics, flat: Array) -> Array:
    """Pixels (…, 2) of positions (…, 2) on the plane one metre ahead of the camera."""
    return optics.focal * _bent(optics, flat) + np.array(optics.centre)


def _bent(optics: Optics, flat: Array) -> Array:
    x, y = flat[..., 0], flat[..., 1]
    (k1, k2), (p1, p2) = optics.radial, optics.tangential
    square = x * x + y * y
    radial = 1 + square * (k1 + k2 * square)
    across = x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x)
    down = y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y
    return np.stack([across, down], axis=-1)


@cache
def rays(optics: Optics) -> Array:
    """Position (rows, columns, 2) that every pixel sees on the plane one metre ahead of the
    camera."""
    columns, rows = optics.size
    pixels = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1)
    wanted = (pixels - np.array(optics.centre)) / optics.focal
    flat = wanted.copy()
    for _ in range(ROUNDS):
        flat += wanted - _bent(optics, flat)
    return flat


def floor(optics: Optics, depth: float) -> Array:
    """Position x, y (rows, columns, 2) [m] on the pool's floor that every pixel sees."""
    flat = rays(optics)
    ahead = np.concatenate([flat, np.ones_like(flat[..., :1])], axis=-1) @ optics.rotation
    ahead /= np.linalg.norm(ahead, axis=-1, keepdims=True)
    surface = np.array(optics.position) - ahead * (optics.position[2] / ahead[..., 2:])
    down = np.sqrt(1 - (1 - ahead[..., 2] ** 2) / optics.index**2)
    under = ahead[..., :2] / optics.index * (depth / down)[..., None]
    return np.asarray(surface[..., :2] + under)
