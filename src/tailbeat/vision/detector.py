"""The AprilTag detector; one per process, used by one thread.

pyapriltags leaves the field `min_white_black_diff` at 5, so the detector searches every noisy tile
of a picture for edges and takes 10 to 30 times longer. The binding does not name the field; it
comes after the named ones. It is set through a cast, after a check that the memory there has the
library's defaults.
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


DEFAULTS = (5, 10, 0.0, 0.98481, 10.0, 5, 0)  # defaults of AprilTag 3.4


@dataclass(frozen=True, eq=False)
class Seen:
    """One tag in a picture: `corners` (4, 2) [px], pixel centres at whole numbers, in the order
    left bottom, right bottom, right top, left top of the tag; corrected bits; decision margin."""

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
    """See `open_detector`; `fast` tells whether the contrast could be set."""

    native: Any
    fast: bool

    def find(self, image: Picture, corner: tuple[int, int] = (0, 0)) -> list[Seen]:
        """Find every 36h11 tag in a grey picture (rows, columns), or in a part of one that starts
        at pixel `corner` (column, row)."""
        found = self.native.detect(np.ascontiguousarray(image))
        shift = np.array(corner) - HALF
        return [Seen(t.tag_id, t.corners + shift, t.hamming, t.decision_margin) for t in found]


def open_detector(contrast: int = 40) -> Detector:
    """Make a detector with one thread, at full resolution. It skips tiles with less than `contrast`
    grey levels between black and white."""
    native: Any = pyapriltags.Detector(FAMILY, nthreads=1, quad_decimate=1.0)
    known = native.tag_detector_ptr.contents
    known.decode_sharpening = 0.25  # the binding rounds it to 0
    behind = _ApriltagDetector.debug.offset + _ApriltagDetector.debug.size
    quads = _Quads.from_address(ctypes.addressof(known) + behind)
    held = [getattr(quads, name) for name, _ in _Quads._fields_]
    fast = bool(np.allclose(held, DEFAULTS, atol=1e-4))
    if fast:
        quads.min_white_black_diff = contrast
    return Detector(native, fast)
