"""The pool as the camera above it sees it: fish, tags, glare, waves, noise, at 1280 x 720.

What moves is drawn on a picture of the empty pool made beforehand: the fish as lines, the tags as
patches four times as fine, each warped by the homography of its four corners as lens and water show
them. Noise comes from a ready-made tile. Brightness and places are chosen; nothing here was held
against a real camera.
"""

from dataclasses import dataclass, field
from functools import cache

import cv2
import numpy as np
from numpy.typing import NDArray

from tailbeat.emulators.optics import Optics, floor, project, rays
from tailbeat.vision.tags import (
    BLACK,
    FISH,
    MODULES,
    TARGET,
    Board,
    Tag,
    board_picture,
    tag_picture,
)  # fmt: skip

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]
Pose = tuple[float, float, float]
FINE = 4  # a tag's patch against the picture
GRAIN = 8  # px of a module in the picture that is warped
INK, PAPER, BACK = 40, 200, 70  # grey levels of a tag's black and white, and of the fish
DEPTH, TILE = 1.0, 0.25  # m: of the pool, and of a tile on its floor
LAMPS = ((-1.6, 0.5), (0.3, -0.8), (1.9, 0.9))  # m: where lamps shine back from the surface
GLARE_SIZE = 0.09  # m, standard deviation of a lamp's glare
WAVES = ((2.1, 0.4, 5.4), (-1.2, 3.3, 6.9), (4.7, -2.6, 8.8))  # rad/m, rad/m, rad/s
SHIMMERS = 8  # pictures of the empty pool, shown in turn
TURN = 6  # frames that each is shown
STILL = 0.3  # px of motion within an exposure that one drawing is enough for: half the lens's blur
NOISE_TILE = 256  # px that the noise tile is larger than the picture


@dataclass(frozen=True)
class Conditions:
    """What the light, the water and the camera do; all chosen. Shares are of frames."""

    exposure: float = 0.002  # s
    rolling: float = 0.0  # s from the first row's exposure to the last one's; 0: all at once
    blur: float = 0.6  # px, standard deviation of the lens's own
    noise: float = 2.0  # grey levels rms
    bits: int = 8  # of brightness; fewer are coarser
    flicker: float = 0.02  # of brightness, from frame to frame
    glare: float = 90.0  # grey levels that a lamp adds at its middle
    slope: float = 0.02  # rms of the water's surface
    dropped: float = 0.01  # share of frames that never come
    hidden: float = 0.0  # share in which a bubble or a hand lies over half a tag


def calm() -> Conditions:
    """Without noise, waves, glare, drops: what the optics alone do."""
    return Conditions(blur=0.5, noise=0.0, flicker=0.0, glare=0.0, slope=0.0, dropped=0.0)


@dataclass(frozen=True, eq=False)
class Scene:
    """What is in the pool: the fish tag's x, y [m] and yaw [rad] and how fast they change, the
    fish's line from nose to tail (k, 2) [m], the target tag's x, y and yaw. None: not there.
    `others` are more tags of the fish's size at its depth, id and pose, among them a second print
    of its own; `mirrored` shows the fish's tag from behind."""

    fish: Pose | None = None
    speed: Pose = (0.0, 0.0, 0.0)
    outline: Array | None = None
    target: Pose | None = None
    others: tuple[tuple[int, Pose], ...] = ()
    mirrored: bool = False


@dataclass(eq=False)
class Renderer:
    """Draws scenes; everything random comes from `seed`."""

    optics: Optics = field(default_factory=Optics)
    conditions: Conditions = field(default_factory=Conditions)
    fish: Tag = field(default_factory=lambda: Tag(height=-0.03))
    target: Tag = field(default_factory=Tag)
    ids: tuple[int, int] = (FISH, TARGET)
    seed: int = 0

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        self.empty = empty_pools(self.optics)
        self.more, self.less = _noise(self.optics.size, self.conditions.noise, self.seed)
        self.phases = self.rng.uniform(0, 2 * np.pi, len(WAVES))
        self.frames = 0

    def draw(self, scene: Scene, time: float) -> Picture:
        """A frame (rows, columns) exposed about `time` [s]. No scene's drawing depends on another
        but through the random numbers used up."""
        image = self.empty[self.frames // TURN % SHIMMERS].copy()
        self.frames += 1
        if scene.outline is not None:
            self._draw_fish(image, scene.outline, time)
        hidden = self.rng.uniform(size=2) < self.conditions.hidden
        still = (0.0, 0.0, 0.0)
        tags = [
            *((self.fish, pose, still, (ident, False, False)) for ident, pose in scene.others),
            (self.fish, scene.fish, scene.speed, (self.ids[0], scene.mirrored, bool(hidden[0]))),
            (self.target, scene.target, still, (self.ids[1], False, bool(hidden[1]))),
        ]
        for tag, pose, speed, look in sorted(tags, key=lambda one: one[0].height):
            if pose is not None:
                self._draw_tag(image, pose, speed, tag, look, time)
        self._draw_glare(image, time)
        return self._developed(image)

    # ---- what is in the water -------------------------------------------------------------------

    def slopes(self, places: Array, time: float) -> Array:
        """Of the surface (n, 2) at places (n, 2) [m]."""
        waves = np.array(WAVES)
        length = np.linalg.norm(waves[:, :2], axis=1)
        swing = np.cos(places @ waves[:, :2].T - waves[:, 2] * time + self.phases)
        share = self.conditions.slope * np.sqrt(2 / len(waves))
        return np.asarray(share * swing @ (waves[:, :2] / length[:, None]))

    def seen(self, places: Array, height: float, time: float) -> Array:
        """Pixels (n, 2) of places (n, 2) at a height [m]."""
        points = np.column_stack([places, np.full(len(places), height)])
        return project(self.optics, points, self.slopes(places, time))

    def _draw_fish(self, image: Picture, outline: Array, time: float) -> None:
        line = self.seen(outline, self.fish.height - 0.03, time)
        thick = np.interp(np.arange(len(line) - 1), [0, 1, len(line) - 1], [18, 14, 4]).round()
        for start, end, width in zip(line[:-1], line[1:], thick, strict=True):
            _line(image, start, end, int(width))

    def _draw_tag(
        self,
        image: Picture,
        pose: Pose,
        speed: Pose,
        tag: Tag,
        look: tuple[int, bool, bool],
        time: float,
    ) -> None:
        """Exposures of a moving tag are several drawings, averaged."""
        half = self.conditions.exposure / 2
        if self.conditions.rolling:
            row = self.seen(np.array([pose[:2]]), tag.height, time)[0, 1] / len(image) - 0.5
            pose = _after(pose, speed, self.conditions.rolling * row)
        poses = [_after(pose, speed, late) for late in (-half, half)]
        corners = np.concatenate([sheet_corners(one, tag.side) for one in poses])
        begin, end = np.split(self.seen(corners, tag.height, time), 2)
        moved = float(np.abs(end - begin).max())
        count = 1 if moved < STILL else 3 if moved < 1.0 else 7
        shares = (np.arange(count) + 0.5) / count
        during = [begin + share * (end - begin) for share in shares]
        _paste(image, during, look, self.conditions.blur)

    def _draw_glare(self, image: Picture, time: float) -> None:
        """Lamps shine back from the surface, and wander with its slope."""
        if not self.conditions.glare:
            return
        lamps = np.array(LAMPS)
        away = lamps + 2 * self.optics.position[2] * self.slopes(lamps, time)
        blob = _blob(self.conditions.glare, GLARE_SIZE * self.optics.focal / 3)
        for x, y in self.seen(away, 0.0, time):
            part, cut = _overlap(image, round(x), round(y), blob)
            if part.size:
                cv2.add(part, cut, dst=part)

    # ---- what the camera makes of it ------------------------------------------------------------

    def _developed(self, image: Picture) -> Picture:
        """Flicker, noise and as many grey levels as there are bits."""
        wanted = self.conditions
        if wanted.noise:
            down, across = self.rng.integers(0, NOISE_TILE, 2)
            rows, columns = image.shape
            cut = np.s_[down : down + rows, across : across + columns]
            cv2.add(image, self.more[cut], dst=image)
            cv2.subtract(image, self.less[cut], dst=image)
        if wanted.flicker:
            cv2.convertScaleAbs(image, dst=image, alpha=1 + wanted.flicker * self.rng.normal())
        if wanted.bits < 8:
            cv2.bitwise_and(image, np.array(256 - (1 << (8 - wanted.bits))), dst=image)
        return image


# ---- pieces ------------------------------------------------------------------------------------


def _after(pose: Pose, speed: Pose, late: float) -> Pose:
    x, y, yaw = (at + late * rate for at, rate in zip(pose, speed, strict=True))
    return x, y, yaw


def sheet_corners(pose: Pose, side: float) -> Array:
    """Places (4, 2) of a printed tag's corners, white border included: left bottom, right bottom,
    right top, left top of the sheet whose arrow points along the yaw."""
    half = side * MODULES / BLACK / 2
    corners = half * np.array([[-1.0, -1.0], [1, -1], [1, 1], [-1, 1]])
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return np.asarray(pose[:2] + corners @ np.array([[c, s], [-s, c]]))


@cache
def _ink(ident: int, mirrored: bool, hide: bool) -> Picture:
    """A tag to warp: grey levels and how much it covers (255: all), (n, n, 2)."""
    modules = np.kron(tag_picture(ident), np.ones((GRAIN, GRAIN), np.uint8))
    grey = np.where(modules > 0, PAPER, INK).astype(np.uint8)
    if mirrored:
        grey = grey[:, ::-1]
    if hide:
        grey[:, grey.shape[1] // 2 :] = BACK
    return np.ascontiguousarray(np.dstack([grey, np.full_like(grey, 255)]))


def _paste(image: Picture, corners: list[Array], look: tuple[int, bool, bool], blur: float) -> None:
    """Warp a tag onto the picture, averaged over places of its corners (4, 2) [px]."""
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
    """The tag in a fine patch of `size` pixels; outside it nothing, covering nothing."""
    ink = _ink(*look)
    last = len(ink) - 0.5
    sheet = np.array([[-0.5, last], [last, last], [last, -0.5], [-0.5, -0.5]], np.float32)
    fine = (FINE * (corners + 0.5) - 0.5).astype(np.float32)
    way = cv2.getPerspectiveTransform(sheet, fine)
    made = cv2.warpPerspective(ink, way, (FINE * size[0], FINE * size[1]), flags=cv2.INTER_LINEAR)
    return np.asarray(made, np.uint8)


def _line(image: Picture, start: Array, end: Array, width: int) -> None:
    points = [tuple(np.rint(16 * place).astype(int).tolist()) for place in (start, end)]
    cv2.line(image, points[0], points[1], BACK, width, cv2.LINE_AA, shift=4)


@cache
def _blob(height: float, size: float) -> Picture:
    reach = np.arange(-int(3 * size), int(3 * size) + 1)
    bell = np.exp(-0.5 * (reach / size) ** 2)
    return np.asarray(np.rint(height * bell[:, None] * bell), np.uint8)


def _overlap(image: Picture, x: int, y: int, blob: Picture) -> tuple[Picture, Picture]:
    """The part of the picture that a blob about x, y covers, and that part of the blob."""
    half, (rows, columns) = len(blob) // 2, image.shape
    top, left = y - half, x - half
    down = np.s_[max(top, 0) : max(min(top + len(blob), rows), 0)]
    across = np.s_[max(left, 0) : max(min(left + len(blob), columns), 0)]
    cut = blob[
        down.start - top : max(down.stop - top, 0), across.start - left : max(across.stop - left, 0)
    ]
    return image[down, across], cut


@cache
def _noise(size: tuple[int, int], rms: float, seed: int) -> tuple[Picture, Picture]:
    """A tile of noise, what it adds and what it takes away: sums of bytes are quick."""
    columns, rows = size
    rng = np.random.default_rng(seed)
    tile = rng.standard_normal((rows + NOISE_TILE, columns + NOISE_TILE), np.float32)
    whole = np.rint(rms * tile)
    return np.maximum(whole, 0).astype(np.uint8), np.maximum(-whole, 0).astype(np.uint8)


@cache
def empty_pools(optics: Optics) -> list[Picture]:
    """The pool without anything in it, with the light that waves throw on its floor, in turn."""
    places = floor(optics, DEPTH)
    joint = np.abs((places / TILE + 0.5) % 1 - 0.5).min(axis=-1) < 0.012
    inside = (np.abs(places[..., 0]) < 2.75) & (np.abs(places[..., 1]) < 1.35)
    flat = rays(optics)
    corner = 1 - 0.12 * np.square(flat).sum(axis=-1)
    water = floor(optics, 0.0)
    wet = (np.abs(water[..., 0]) < 2.75) & (np.abs(water[..., 1]) < 1.35)
    level = np.where(inside, np.where(joint, 105.0, 125.0), np.where(wet, 112.0, 90.0)) * corner
    x, y = places[..., 0], places[..., 1]
    made = []
    for turn in np.arange(SHIMMERS) * 2 * np.pi / SHIMMERS:
        light = np.sin(9 * x + 4 * y + turn) * np.sin(5 * x - 11 * y - turn)
        picture = np.clip(level + 9 * np.square(light) * inside, 0, 255).astype(np.uint8)
        made.append(cv2.GaussianBlur(picture, (0, 0), 0.7))
    return made


def board_view(
    optics: Optics, board: Board, turn: Array, place: Array, rng: np.random.Generator
) -> Picture:
    """A board held in the air before the camera, for its calibration: `turn` (3, 3) from the board
    (x across, y down its squares) to the camera, `place` [m] of its first corner there."""
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
    """Such views as a person takes: everywhere in the picture, tilted every way, near and far."""
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
