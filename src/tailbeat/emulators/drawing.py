"""Parts of a picture: a warped tag, a thick line, a glare, a noise tile, the empty pool."""

from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from tailbeat.emulators.optics import Optics, floor, rays
from tailbeat.vision.tags import BLACK, MODULES, tag_picture

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]
Pose = tuple[float, float, float]
FINE = 4  # resolution of a tag's patch over the picture's
GRAIN = 8  # px of a module in the picture that is warped
INK, PAPER, BACK = 40, 200, 70  # grey levels of a tag's black and white, and of the fish
DEPTH, TILE = 1.0, 0.25  # m: of the pool, and of a tile on its floor
SHIMMERS = 8  # pictures of the empty pool, shown in turn
NOISE_TILE = 256  # px that the noise tile is larger than the picture


def moved(pose: Pose, speed: Pose, late: float) -> Pose:
    """The pose after `late` seconds at `speed` [m/s, rad/s]."""
    x, y, yaw = (at + late * rate for at, rate in zip(pose, speed, strict=True))
    return x, y, yaw


def sheet_corners(pose: Pose, side: float) -> Array:
    """Positions (4, 2) of a printed tag's corners with its white border: left bottom, right bottom,
    right top, left top of the sheet whose arrow points along the yaw."""
    half = side * MODULES / BLACK / 2
    corners = half * np.array([[-1.0, -1.0], [1, -1], [1, 1], [-1, 1]])
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return np.asarray(pose[:2] + corners @ np.array([[c, s], [-s, c]]))


@cache
def _ink(ident: int, mirrored: bool, hide: bool) -> Picture:
    """A tag to warp (n, n, 2): grey levels, and opacity (255: opaque)."""
    modules = np.kron(tag_picture(ident), np.ones((GRAIN, GRAIN), np.uint8))
    grey = np.where(modules > 0, PAPER, INK).astype(np.uint8)
    if mirrored:
        grey = grey[:, ::-1]
    if hide:
        grey[:, grey.shape[1] // 2 :] = BACK
    return np.ascontiguousarray(np.dstack([grey, np.full_like(grey, 255)]))


def paste_tag(
    image: Picture, corners: list[Array], look: tuple[int, bool, bool], blur: float
) -> None:
    """Warp a tag onto the picture, averaged over positions of its corners (4, 2) [px]."""
    every = np.concatenate(corners)
    low = np.floor(every.min(axis=0)).astype(int) - 3
    high = np.ceil(every.max(axis=0)).astype(int) + 4
    rows, columns = image.shape
    if high[0] <= 0 or high[1] <= 0 or low[0] >= columns or low[1] >= rows:
        return
    size = (high - low).tolist()
    warped = [_warped(one - low, size, look) for one in corners]
    mean = warped[0] if len(warped) == 1 else np.mean(np.array(warped, np.float32), axis=0)
    soft = cv2.GaussianBlur(np.asarray(mean), (0, 0), FINE * blur)
    patch = cv2.resize(soft, size, interpolation=cv2.INTER_AREA)
    first, last = np.maximum(low, 0), np.minimum(high, [columns, rows])
    patch = patch[first[1] - low[1] : last[1] - low[1], first[0] - low[0] : last[0] - low[0]]
    part = image[first[1] : last[1], first[0] : last[0]]
    part[:] = np.rint(patch[..., 0] + (1 - patch[..., 1] / 255.0) * part)


def _warped(corners: Array, size: list[int], look: tuple[int, bool, bool]) -> Picture:
    """The tag in a fine patch of `size` pixels, transparent outside the tag."""
    ink = _ink(*look)
    last = len(ink) - 0.5
    sheet = np.array([[-0.5, last], [last, last], [last, -0.5], [-0.5, -0.5]], np.float32)
    fine = (FINE * (corners + 0.5) - 0.5).astype(np.float32)
    way = cv2.getPerspectiveTransform(sheet, fine)
    made = cv2.warpPerspective(ink, way, (FINE * size[0], FINE * size[1]), flags=cv2.INTER_LINEAR)
    return np.asarray(made, np.uint8)


def thick_line(image: Picture, start: Array, end: Array, width: int) -> None:
    """Draw a line, `width` pixels thick, with ends to a sixteenth of a pixel."""
    points = [tuple(np.rint(16 * place).astype(int).tolist()) for place in (start, end)]
    cv2.line(image, points[0], points[1], BACK, width, cv2.LINE_AA, shift=4)


@cache
def glare(height: float, size: float) -> Picture:
    """A Gaussian spot: `height` grey levels, `size` [px] standard deviation."""
    reach = np.arange(-int(3 * size), int(3 * size) + 1)
    bell = np.exp(-0.5 * (reach / size) ** 2)
    return np.asarray(np.rint(height * bell[:, None] * bell), np.uint8)


def overlap(image: Picture, x: int, y: int, blob: Picture) -> tuple[Picture, Picture]:
    """The part of the picture that a spot about x, y covers, and that part of the spot."""
    half, (rows, columns) = len(blob) // 2, image.shape
    top, left = y - half, x - half
    down = np.s_[max(top, 0) : max(min(top + len(blob), rows), 0)]
    across = np.s_[max(left, 0) : max(min(left + len(blob), columns), 0)]
    cut = blob[
        down.start - top : max(down.stop - top, 0), across.start - left : max(across.stop - left, 0)
    ]
    return image[down, across], cut


@cache
def noise_tiles(size: tuple[int, int], rms: float, seed: int) -> tuple[Picture, Picture]:
    """A tile of noise as two byte arrays, to add and to subtract: this is fast."""
    columns, rows = size
    rng = np.random.default_rng(seed)
    tile = rng.standard_normal((rows + NOISE_TILE, columns + NOISE_TILE), np.float32)
    whole = np.rint(rms * tile)
    return np.maximum(whole, 0).astype(np.uint8), np.maximum(-whole, 0).astype(np.uint8)


@cache
def empty_pools(optics: Optics) -> list[Picture]:
    """Pictures of the empty pool with the light of waves on its floor, to show in turn."""
    places = floor(optics, DEPTH)
    joint = np.abs((places / TILE + 0.5) % 1 - 0.5).min(axis=-1) < 0.012
    half = np.array(optics.pool) / 2
    inside = (np.abs(places) < half).all(axis=-1)
    flat = rays(optics)
    corner = 1 - 0.12 * np.square(flat).sum(axis=-1)
    water = floor(optics, 0.0)
    wet = (np.abs(water) < half).all(axis=-1)
    level = np.where(inside, np.where(joint, 105.0, 125.0), np.where(wet, 112.0, 90.0)) * corner
    x, y = places[..., 0], places[..., 1]
    made = []
    for turn in np.arange(SHIMMERS) * 2 * np.pi / SHIMMERS:
        light = np.sin(9 * x + 4 * y + turn) * np.sin(5 * x - 11 * y - turn)
        picture = np.clip(level + 9 * np.square(light) * inside, 0, 255).astype(np.uint8)
        made.append(cv2.GaussianBlur(picture, (0, 0), 0.7))
    return made
