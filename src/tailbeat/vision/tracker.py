"""From frames to poses: which tags to accept, and where they are in the pool.

A tag is searched for in the whole picture until it is found, then in a window about its last
position. Now and then the whole picture is searched, for a second print of the same tag. A tag that
fails a test is rejected and counted by reason: unexpected, corrected bits, too faint, at the
picture's edge, turned over, of another size or not square, twice in view, jumped, turned too fast.
"""

from collections import Counter, deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tailbeat.control.observation import wrapped
from tailbeat.files import BadInput
from tailbeat.link.datagrams import Frame
from tailbeat.vision.calibration import Calibration
from tailbeat.vision.detector import Detector, Seen, open_detector
from tailbeat.vision.field_of_view import EDGE
from tailbeat.vision.fixed import FixedTags
from tailbeat.vision.tags import FISH, TARGET, Tag

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]
Pose = tuple[float, float, float]
SECOND = 1_000_000_000


@dataclass(frozen=True)
class TrackerLimits:
    """Limits of what is accepted; chosen. Speeds bound the change between two sightings, plus
    `step` and `turn` for noise. A sighting older than `memory` is not used."""

    mended: int = 1  # corrected bits of 36; two tags differ in 11
    margin: float = 15.0  # decision margin; blur and glare lower it
    edge: float = EDGE  # px from the picture's edge within which corners may be wrong
    size: float = 0.25  # largest relative error of the mean side
    square: float = 0.25  # largest relative difference of two sides or diagonals
    speed: float = 3.0  # m/s
    step: float = 0.05  # m
    turning: float = 12.0  # rad/s: a fish's head beats, it does not spin
    turn: float = 0.5  # rad
    memory: float = 1.0  # s
    scan: float = 0.5  # s between two searches of the whole picture, at any frame rate
    hunt: int = 3  # frames, while a tag is missing: a full search takes as long as ten windows


@dataclass(frozen=True, eq=False)
class Sighting:
    """Result of one frame: the `frame` to send, corners (4, 2) [px] of accepted tags by id; so far
    rejects by reason, accepted tags by id, and frames; frames per second; whether the whole picture
    was searched; how far [m] a tag that is fixed to the pool is from its place."""

    frame: Frame
    corners: dict[int, Array]
    rejected: dict[str, int]
    believed: dict[int, int]
    frames: int
    rate: float
    whole: bool
    moved: float = 0.0


@dataclass(frozen=True, eq=False)
class Last:
    """Where a tag was accepted last."""

    stamp: int
    pose: Pose
    middle: Array  # px
    side: float  # px


def check_ids(ids: tuple[int, int], calibration: Calibration) -> None:
    """Raises BadInput if fish and target have one id, or the id of a tag that is fixed to the
    pool."""
    if ids[0] == ids[1]:
        raise BadInput(f"fish and target both have tag {ids[0]}; give two different ones.")
    taken = [one for one in ids if one in calibration.fixed]
    if taken:
        raise BadInput(
            f"tag {taken[0]} is one of those surveyed in the pool; give fish and target other tags,"
            f" or survey the pool with others."
        )


@dataclass(eq=False)
class Tracker:
    """Tracks the tags of fish and target, `ids`; see `see`. It has one detector, so use it in one
    thread."""

    calibration: Calibration
    ids: tuple[int, int] = (FISH, TARGET)
    limits: TrackerLimits = field(default_factory=TrackerLimits)
    detector: Detector = field(default_factory=open_detector)
    rejected: Counter[str] = field(default_factory=Counter)
    counts: Counter[int] = field(default_factory=Counter)  # accepted, by id
    frames: int = 0
    last: dict[int, Last] = field(default_factory=dict)
    searched: int = -(10**9)  # last frame that was searched as a whole
    scanned: int = -(10**18)  # its stamp [ns]
    stamps: deque[int] = field(default_factory=lambda: deque(maxlen=61))

    def __post_init__(self) -> None:
        check_ids(self.ids, self.calibration)
        self.fixed = FixedTags(self.calibration)

    def see(self, image: Picture, stamp: int) -> Sighting:
        """Track one grey frame (rows, columns), exposed at `stamp` [ns]. Raises BadInput if its
        size is not the calibration's."""
        size = (image.shape[1], image.shape[0])
        if size != self.calibration.lens.size:
            raise BadInput(
                f"the camera gives {size[0]} x {size[1]} pixels, but the calibration is for"
                f" {self.calibration.lens.size[0]} x {self.calibration.lens.size[1]}; set the"
                f" camera's mode, or calibrate again."
            )
        whole = self._search_all(stamp)
        found = self.detector.find(image) if whole else self._windows(image)
        if whole:
            self.fixed.see(found)
            found = [one for one in found if one.ident not in self.fixed.known]
        believed = self._believed(found, size, stamp)
        self.frames += 1
        self.stamps.append(stamp)
        return self._sighting(believed, stamp, whole)

    # ---- where to look --------------------------------------------------------------------------

    def _search_all(self, stamp: int) -> bool:
        """Whether this frame is searched as a whole; removes old sightings."""
        old = round(self.limits.memory * SECOND)
        self.last = {k: one for k, one in self.last.items() if 0 <= stamp - one.stamp <= old}
        before = self.stamps[-1] if self.stamps else 0
        seen = [one for one in self.last.values() if one.stamp == before]
        missing = len(seen) < len(self.ids) and self.frames - self.searched >= self.limits.hunt
        fresh = 0 <= stamp - self.scanned < round(self.limits.scan * SECOND)
        if not self.last or missing or not fresh:
            self.searched, self.scanned = self.frames, stamp
            return True
        return False

    def _windows(self, image: Picture) -> list[Seen]:
        """Find tags in windows about their last positions; windows are multiples of 32 pixels
        wide."""
        found = []
        for ident, last in self.last.items():
            half = 16 * int(np.clip(np.ceil(3 * last.side / 32), 3, 12))
            rows, columns = image.shape
            x, y = (
                int(np.clip(round(middle) - half, 0, max(most - 2 * half, 0)))
                for middle, most in zip(last.middle, (columns, rows), strict=True)
            )
            window = image[y : y + 2 * half, x : x + 2 * half]
            found += [one for one in self.detector.find(window, (x, y)) if one.ident == ident]
        return found

    # ---- what to accept -------------------------------------------------------------------------

    def _believed(self, found: list[Seen], size: tuple[int, int], stamp: int) -> dict[int, Seen]:
        count = Counter(one.ident for one in found)
        believed = {}
        for one in found:
            reason = "seen twice" if count[one.ident] > 1 else self._doubt(one, size, stamp)
            if reason:
                self.rejected[reason] += 1
            else:
                believed[one.ident] = one
        for ident, times in count.items():
            if times > 1:
                self.last.pop(
                    ident, None
                )  # either may be ours: search the whole picture until one is left
        return believed

    def _doubt(self, one: Seen, size: tuple[int, int], stamp: int) -> str:
        """Why a tag is rejected; "" if it is accepted, and then it is stored."""
        limits = self.limits
        if one.ident not in self.ids:
            return "unexpected tag"
        if one.mended > limits.mended:
            return "bits mended"
        if one.margin < limits.margin:
            return "too faint"
        if not self._inside(one.corners, size):
            return "at the edge"
        tag = self._tag(one.ident)
        corners = self.calibration.places(one.corners, tag.height)
        reason = misshapen(corners, tag.side, limits)
        if reason:
            return reason
        pose = planar_pose(corners)
        reason = self._jump(one.ident, pose, stamp)
        if not reason:
            self.last[one.ident] = Last(stamp, pose, one.corners.mean(axis=0), one.side)
        return reason

    def _tag(self, ident: int) -> Tag:
        return self.calibration.fish if ident == self.ids[0] else self.calibration.target

    def _inside(self, corners: Array, size: tuple[int, int]) -> bool:
        edge = self.limits.edge
        return bool((corners > edge).all() and (corners < np.array(size) - 1 - edge).all())

    def _jump(self, ident: int, pose: Pose, stamp: int) -> str:
        """Whether a tag moved or turned faster than possible since it was last accepted."""
        last, limits = self.last.get(ident), self.limits
        if last is None:
            return ""
        since = (stamp - last.stamp) / SECOND
        moved = np.hypot(pose[0] - last.pose[0], pose[1] - last.pose[1])
        if moved > limits.speed * since + limits.step:
            return "jumped"
        turned = abs(wrapped(pose[2] - last.pose[2]))
        most = min(limits.turning * since + limits.turn, 0.75 * np.pi)  # never half a turn
        return "turned too fast" if turned > most else ""

    # ---- the result -----------------------------------------------------------------------------

    def _sighting(self, believed: dict[int, Seen], stamp: int, whole: bool) -> Sighting:
        fish, target = (self.last[k].pose if k in believed else None for k in self.ids)
        frame = Frame(stamp, fish, None if target is None else target[:2])
        span = (self.stamps[-1] - self.stamps[0]) / SECOND
        rate = (len(self.stamps) - 1) / span if span > 0 else 0.0
        corners = {ident: one.corners for ident, one in believed.items()}
        self.counts.update(believed.keys())
        told = dict(self.rejected), dict(self.counts)
        return Sighting(frame, corners, *told, self.frames, rate, whole, self.fixed.moved())


def planar_pose(corners: Array) -> Pose:
    """x, y [m] and yaw [rad] of a tag from the positions of its corners (4, 2), in the detector's
    order: their mean, and the mean direction of the lower and upper edge, along the arrow."""
    ahead = corners[1] - corners[0] + corners[2] - corners[3]
    x, y = corners.mean(axis=0)
    return float(x), float(y), float(np.arctan2(ahead[1], ahead[0]))


def misshapen(corners: Array, side: float, limits: TrackerLimits) -> str:
    """Why four positions (4, 2) [m] are not the corners of a tag with black sides of `side` [m]
    seen from above; "" if they are."""
    if not np.isfinite(corners).all():
        return "not in the pool"
    x, y = corners.T
    area = float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2
    if area <= 0:
        return "mirrored"
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)
    if abs(sides.mean() / side - 1) > limits.size:
        return "another size"
    across = np.linalg.norm(corners[:2] - corners[2:], axis=1)
    if max(np.ptp(sides) / side, np.ptp(across) / side) > limits.square:
        return "no square"
    return ""
