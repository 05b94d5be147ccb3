"""The pool as the camera above it sees it: fish, tags, glare, waves, noise, at 1280 x 720 or finer.

Moving things are drawn on a prepared picture of the empty pool: the fish as lines, the tags as
patches at four times the resolution. Each patch is warped by the homography of its four corners,
computed through lens and water. Noise comes from a prepared tile. Brightness and positions are
chosen; nothing was compared with a real camera.
"""

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from tailbeat.emulators import drawing
from tailbeat.emulators.drawing import NOISE_TILE, SHIMMERS, Picture, Pose
from tailbeat.emulators.optics import Optics, project
from tailbeat.vision.tags import FISH, TARGET, Tag

Array = NDArray[np.float64]
# Reflections of lamps on the surface, over half of the pool's length and width.
LAMPS = ((-1.6 / 2.75, 0.5 / 1.35), (0.3 / 2.75, -0.8 / 1.35), (1.9 / 2.75, 0.9 / 1.35))
GLARE_SIZE = 0.09  # m, standard deviation of a lamp's glare as seen from 3 m, at any height
WAVES = ((2.1, 0.4, 5.4), (-1.2, 3.3, 6.9), (4.7, -2.6, 8.8))  # rad/m, rad/m, rad/s
WIDTHS = 0.96, 0.747, 0.213  # of the drawn fish from nose to tail, over the side of its tag
TURN = 6  # frames for which each empty pool is shown
STILL = (
    0.3  # px of motion within an exposure up to which one drawing is enough: half the lens's blur
)


@dataclass(frozen=True)
class Conditions:
    """Properties of light, water and camera; all chosen."""

    exposure: float = 0.002  # s
    rolling: float = 0.0  # s from the first row's exposure to the last row's; 0: global shutter
    blur: float = 0.6  # px, standard deviation of the lens's blur
    noise: float = 2.0  # grey levels rms
    bits: int = 8  # of brightness
    flicker: float = 0.02  # relative change of brightness from frame to frame
    glare: float = 90.0  # grey levels that a lamp adds at its middle
    slope: float = 0.02  # rms of the water's surface
    dropped: float = 0.01  # fraction of frames that never come
    hidden: float = 0.0  # fraction of frames in which half a tag is hidden


def calm() -> Conditions:
    """Conditions without noise, waves, glare or dropped frames: only the optics."""
    return Conditions(blur=0.5, noise=0.0, flicker=0.0, glare=0.0, slope=0.0, dropped=0.0)


@dataclass(frozen=True, eq=False)
class Scene:
    """What is in the pool; None means that it is not there.

    The fish tag's x, y [m] and yaw [rad], and their rates; the fish's line from nose to tail (k, 2)
    [m]; the target tag's x, y and yaw. `others` are more tags of the fish's size at its depth, id
    and pose, for example a second print of its own tag. `mirrored` shows the fish's tag from
    behind.
    """

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
        self.empty = drawing.empty_pools(self.optics)
        self.more, self.less = drawing.noise_tiles(
            self.optics.size, self.conditions.noise, self.seed
        )
        self.phases = self.rng.uniform(0, 2 * np.pi, len(WAVES))
        self.frames = 0

    def draw(self, scene: Scene, time: float) -> Picture:
        """Draw a frame (rows, columns) exposed about `time` [s]. Frames depend on each other only
        through the random numbers drawn."""
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
        """Slopes (n, 2) of the surface at positions (n, 2) [m]."""
        waves = np.array(WAVES)
        length = np.linalg.norm(waves[:, :2], axis=1)
        swing = np.cos(places @ waves[:, :2].T - waves[:, 2] * time + self.phases)
        share = self.conditions.slope * np.sqrt(2 / len(waves))
        return np.asarray(share * swing @ (waves[:, :2] / length[:, None]))

    def seen(self, places: Array, height: float, time: float) -> Array:
        """Pixels (n, 2) of positions (n, 2) at a height [m]."""
        points = np.column_stack([places, np.full(len(places), height)])
        return project(self.optics, points, self.slopes(places, time))

    def _draw_fish(self, image: Picture, outline: Array, time: float) -> None:
        line = self.seen(outline, self.fish.height - 0.03, time)
        wide = self.fish.side * self.optics.scale * np.array(WIDTHS)
        thick = np.interp(np.arange(len(line) - 1), [0, 1, len(line) - 1], wide).round()
        for start, end, width in zip(line[:-1], line[1:], thick, strict=True):
            drawing.thick_line(image, start, end, int(width))

    def _draw_tag(
        self,
        image: Picture,
        pose: Pose,
        speed: Pose,
        tag: Tag,
        look: tuple[int, bool, bool],
        time: float,
    ) -> None:
        """Draw a tag; the exposure of a moving tag is the mean of several drawings."""
        half = self.conditions.exposure / 2
        if self.conditions.rolling:
            row = self.seen(np.array([pose[:2]]), tag.height, time)[0, 1] / len(image) - 0.5
            pose = drawing.moved(pose, speed, self.conditions.rolling * row)
        poses = [drawing.moved(pose, speed, late) for late in (-half, half)]
        corners = np.concatenate([drawing.sheet_corners(one, tag.side) for one in poses])
        begin, end = np.split(self.seen(corners, tag.height, time), 2)
        moved = float(np.abs(end - begin).max())
        count = 1 if moved < STILL else 3 if moved < 1.0 else 7
        shares = (np.arange(count) + 0.5) / count
        during = [begin + share * (end - begin) for share in shares]
        drawing.paste_tag(image, during, look, self.conditions.blur)

    def _draw_glare(self, image: Picture, time: float) -> None:
        """Draw the reflections of lamps, which move with the surface's slope."""
        if not self.conditions.glare:
            return
        lamps = np.array(LAMPS) * self.optics.pool / 2
        away = lamps + 2 * self.optics.position[2] * self.slopes(lamps, time)
        blob = drawing.glare(self.conditions.glare, GLARE_SIZE * self.optics.focal / 3)
        for x, y in self.seen(away, 0.0, time):
            part, cut = drawing.overlap(image, round(x), round(y), blob)
            if part.size:
                cv2.add(part, cut, dst=part)

    # ---- the camera -----------------------------------------------------------------------------

    def _developed(self, image: Picture) -> Picture:
        """Add flicker and noise, and reduce the grey levels to the camera's bits."""
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
