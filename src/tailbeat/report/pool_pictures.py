"""Textures of the film's pool: tiles in moving light, glints on the water, a tag.

Tiles and glints repeat without a seam. All sizes and colours are chosen only for their looks.
"""

from functools import cache
from importlib.util import find_spec

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, zoom

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]
SIDE = 1.2  # m, side of the area that a texture covers
TILES = 8  # tiles along a side, each 15 cm
PIXELS = 384  # pixels along a side
COARSE = 192  # pixels of the light along a side, with two rays per pixel
JOINT = 2  # px of joint on each side of a tile
TILE, GROUT = (70, 150, 172), (128, 190, 202)
# Waves of the surface: whole numbers over the picture's side in x and y, and over the loop.
WAVES = ((3, 1, 1), (-2, 4, -1), (4, -3, 1), (1, -5, -1), (-5, -2, 2), (3, 6, -1), (6, -4, 1))
TILT = 0.0055  # fraction of SIDE by which a wave of number 1 moves a ray
TURNS, LOOP = 36, 3.6  # pictures of a loop, and its duration [s]
SHADE, SHINE, BRIGHTEST = (
    0.80,
    0.22,
    3.5,
)  # brightness of the floor without caustics; gain of caustics; their limit
WATER, GLINT = (70, 160, 185), (255, 255, 255)


@cache
def caustic(turn: int) -> Array:
    """Light on the floor (PIXELS, PIXELS), 1 on average: rays bent by a wavy surface."""
    rays, phase = 2 * COARSE, 2 * np.pi * turn / TURNS
    x, y = np.meshgrid(*[2 * np.pi * (np.arange(rays, dtype=np.float32) + 0.5) / rays] * 2)
    bent = np.zeros((2, rays, rays), np.float32)
    for number, (i, j, k) in enumerate(WAVES):
        slope = np.cos(i * x + j * y + k * phase + 1.7 * number) / np.hypot(i, j)
        bent += TILT * np.array([i, j], np.float32)[:, None, None] * slope
    column, row = ((np.stack([x, y]) / (2 * np.pi) + bent) * COARSE) % COARSE
    soft = gaussian_filter(_splat(column.ravel(), row.ravel()), 0.7, mode="wrap")
    fine = zoom(soft / soft.mean(), PIXELS / COARSE, order=1, mode="grid-wrap", grid_mode=True)
    return np.asarray(fine)


def _splat(column: Array, row: Array) -> Array:
    """Distribute each ray over the four pixels around it: the number at each (COARSE, COARSE)."""
    left, top = column.astype(int), row.astype(int)
    right, below = column - left, row - top
    hits = np.zeros(COARSE * COARSE)
    for a, across in ((0, 1 - right), (1, right)):
        for b, down in ((0, 1 - below), (1, below)):
            place = (top + b) % COARSE * COARSE + (left + a) % COARSE
            hits += np.bincount(place, across * down, COARSE * COARSE)
    return hits.reshape(COARSE, COARSE)


@cache
def tiles() -> Array:
    """The floor's colours (PIXELS, PIXELS, 3), 0 to 255; every tile is slightly different."""
    place = np.arange(PIXELS) % (PIXELS // TILES)
    edge = (place < JOINT) | (place >= PIXELS // TILES - JOINT)
    joint = edge[:, None] | edge
    index = np.arange(PIXELS) // (PIXELS // TILES)
    shade = np.random.default_rng(1).normal(1.0, 0.02, (TILES, TILES))[index][:, index]
    return np.where(joint[..., None], GROUT, shade[..., None] * TILE)


@cache
def lit_tiles(turn: int) -> Picture:
    """The floor (PIXELS, PIXELS, 3) at a step of the loop."""
    level = SHADE + SHINE * np.minimum(caustic(turn), BRIGHTEST)
    return np.clip(tiles() * level[..., None], 0, 255).astype(np.uint8)


@cache
def surface(turn: int) -> Picture:
    """The water from above (PIXELS, PIXELS, 3): its colour with a few glints."""
    bright = np.clip(caustic((turn + TURNS // 2) % TURNS) - 1.4, 0.0, 2.0)[..., None] / 2
    colour = WATER + bright * (np.array(GLINT) - WATER)
    return np.asarray(colour, np.uint8)


def tag(ident: int, module: int = 16) -> Picture:
    """A tag as the camera sees it (n, n, 3), row 0 at the top; a plain plate if the library that
    draws tags is not installed."""
    if find_spec("pyapriltags") is None or find_spec("cv2") is None:
        return np.full((10 * module, 10 * module, 3), 235, np.uint8)
    from tailbeat.vision.tags import tag_picture

    grey = np.kron(tag_picture(ident), np.ones((module, module), np.uint8))
    return np.repeat(np.where(grey > 0, 240, 25).astype(np.uint8)[..., None], 3, axis=2)
