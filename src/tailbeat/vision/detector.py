"""The AprilTag detector, kept for the life of its process and used by one thread.

pyapriltags leaves the field `min_white_black_diff` at 5, so that every noisy tile of a picture is
searched for edges: 10 to 30 times the time. It lies behind the fields that the binding names. It is
set through a cast of ours, after what lies there has been seen to be the library's defaults.
"""

import ctypes
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyapriltags
from numpy.typing import NDArray
from pyapriltags.apriltags import _ApriltagDetector

from tailbeat.vision.tags import FAMILY

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]
HALF = 0.5  # px: the library puts pixel centres at (0.5, 0.5), OpenCV and we at (0, 0)


class _Quads(ctypes.Structure):
    """`apriltag_quad_thresh_params` of AprilTag 3.4."""

    _fields_ = (
        ("min_cluster_pixels", ctypes.c_int),
        ("max_nmaxima", ctypes.c_int),
        ("critical_rad", ctypes.c_float),
        ("cos_critical_rad", ctypes.c_float),
        ("max_line_fit_mse", ctypes.c_float),
        ("min_white_black_diff", ctypes.c_int),
        ("deglitch", ctypes.c_int),
    )


DEFAULTS = (5, 10, 0.0, 0.98481, 10.0, 5, 0)  # what AprilTag 3.4 starts with


@dataclass(frozen=True, eq=False)
class Seen:
    """One tag in a picture: `corners` (4, 2) [px], pixel centres at whole numbers, in the tag's
    order left bottom, right bottom, right top, left top; bits that were mended; decision margin."""

    ident: int
    corners: Array
    mended: int
    margin: float

    @property
    def side(self) -> float:
        """Mean length of its sides [px]."""
        sides = self.corners - np.roll(self.corners, 1, axis=0)
        return float(np.linalg.norm(sides, axis=1).mean())


@dataclass(eq=False)
class Detector:
    """See `open_detector`; `fast` tells whether the cast was taken."""

    native: Any
    fast: bool

    def find(self, image: Picture, corner: tuple[int, int] = (0, 0)) -> list[Seen]:
        """Every 36h11 tag of a grey picture (rows, columns), or of the part of one whose first
        pixel lies at `corner` (column, row)."""
        found = self.native.detect(np.ascontiguousarray(image))
        shift = np.array(corner) - HALF
        return [Seen(t.tag_id, t.corners + shift, t.hamming, t.decision_margin) for t in found]


def open_detector(contrast: int = 40) -> Detector:
    """A detector on one thread, at full resolution; tiles with less than `contrast` grey levels
    between black and white are passed over."""
    native: Any = pyapriltags.Detector(FAMILY, nthreads=1, quad_decimate=1.0)
    known = native.tag_detector_ptr.contents
    known.decode_sharpening = 0.25  # the binding makes a whole number, 0, of it
    behind = _ApriltagDetector.debug.offset + _ApriltagDetector.debug.size
    quads = _Quads.from_address(ctypes.addressof(known) + behind)
    held = [getattr(quads, name) for name, _ in _Quads._fields_]
    fast = bool(np.allclose(held, DEFAULTS, atol=1e-4))
    if fast:
        quads.min_white_black_diff = contrast
    return Detector(native, fast)
