"""From pixels to positions in the pool: lens, position of the camera, refraction at the surface.

`survey.py` computes them. A pixel's ray is followed exactly: out of the lens, refracted at the
surface (Snell's law), down to the plane of the tag. (A plane at depth / 1.333, often used, is the
limit for steep rays: its error is 5 mm in the corner of a pool of 5.5 m, 5 cm down, 3 m below the
camera.) Fish and target may be in different planes. Pixel centres are at whole numbers.
"""

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tailbeat.files import BadInput, write_json
from tailbeat.link.places import LARGEST, SMALLEST, is_pool
from tailbeat.vision.tags import Tag

Array = NDArray[np.float64]
KIND = "tailbeat camera calibration"
WATER = 1.333  # index of refraction, 20 degrees C, sodium light
OLDEST = 30.0  # days; cameras are moved by accident; chosen
FIELDS = ("made", "size", "matrix", "distortion", "rotation", "position", "index", "fish", "target",
          "lens_rms_px", "place_rms_m", "provenance")  # fmt: skip


@dataclass(frozen=True, eq=False)
class Lens:
    """Pinhole `matrix` (3, 3) and `distortion` (5,) as in OpenCV, for pictures of `size` (columns,
    rows); rms error of the fit [px]."""

    size: tuple[int, int]
    matrix: Array
    distortion: Array
    rms: float


@dataclass(frozen=True, eq=False)
class Hung:
    """Pose of a camera: `rotation` (3, 3) from the pool's axes to the camera's (x right, y down, z
    ahead), `position` (3,) [m] with z above the water's surface; rms error of the fit [m]."""

    rotation: Array
    position: Array
    rms: float


@dataclass(frozen=True, eq=False)
class Calibration:
    """A calibration: lens, pose, refraction `index` of water, the tags' sizes and heights, length
    and width of the pool [m] (None in older files), surveyed x, y, z [m] of the tags that may stay
    in the pool, by id (`fixed`), provenance, and the SHA-256 of the file that it was read from."""

    lens: Lens
    hung: Hung
    fish: Tag
    target: Tag
    index: float = WATER
    made: str = ""
    pool: tuple[float, float] | None = None
    fixed: Mapping[int, tuple[float, float, float]] = field(default_factory=dict)
    provenance: dict[str, Any] = field(default_factory=dict)
    digest: bytes = b""

    def places(self, pixels: Array, height: float) -> Array:
        """Positions x, y (n, 2) [m] in the pool of `pixels` (n, 2) of points at `height` [m] above
        the water's surface, negative below; NaN where a ray does not go down."""
        return places(self.lens, self.hung.rotation, self.hung.position, pixels, height, self.index)


def places(
    lens: Lens, rotation: Array, position: Array, pixels: Array, height: Any, index: float
) -> Array:
    """As `Calibration.places`, with rotation and position given; `height` may differ between
    pixels."""
    flat = cv2.undistortPoints(pixels.reshape(-1, 1, 2).astype(float), lens.matrix, lens.distortion)
    ahead = np.column_stack([flat[:, 0], np.ones(len(flat))]) @ rotation
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    down = np.where(ahead[:, 2] < -1e-6, -ahead[:, 2], np.nan)
    above, depth = np.maximum(height, 0.0), np.maximum(-np.asarray(height), 0.0)
    met = position[:2] + ahead[:, :2] * ((position[2] - above) / down)[:, None]
    steep = np.sqrt(1 - (1 - down**2) / index**2)  # Snell
    return np.asarray(met + ahead[:, :2] * (depth / (index * steep))[:, None])


# ---- the file -----------------------------------------------------------------------------------


def write_calibration(path: Path, made: Calibration) -> None:
    """Write a calibration as JSON. Raises BadInput if the file exists."""
    write_json(
        path,
        {
            "kind": KIND,
            "made": made.made or datetime.now(UTC).isoformat(timespec="seconds"),
            "size": made.lens.size,
            "matrix": made.lens.matrix,
            "distortion": made.lens.distortion,
            "lens_rms_px": made.lens.rms,
            "rotation": made.hung.rotation,
            "position": made.hung.position,
            "place_rms_m": made.hung.rms,
            "index": made.index,
            "pool": made.pool,
            "fixed": {str(ident): place for ident, place in made.fixed.items()},
            "fish": vars(made.fish),
            "target": vars(made.target),
            "provenance": made.provenance,
        },
    )


def read_calibration(
    path: Path, oldest: float = OLDEST, now: datetime | None = None
) -> Calibration:
    """Read a file of `write_calibration` that is at most `oldest` days old. Raises BadInput if a
    field is missing, has another shape, is not finite or is out of range."""
    if not path.is_file():  # a device or a pipe would be read without end
        raise BadInput(f"{path}: no such file; give a file of tailbeat calibrate.")
    try:
        read = path.read_bytes()
        data = json.loads(read.decode("utf-8"))
    except (OSError, ValueError) as error:
        raise BadInput(f"{path}: {error}; give a file of tailbeat calibrate.") from None
    if not isinstance(data, dict) or data.get("kind") != KIND:
        raise BadInput(f"{path}: not a {KIND}; give a file of tailbeat calibrate.")
    for name in FIELDS:
        if name not in data:
            raise BadInput(f"{path}: {name} is missing; calibrate again.")
    _check_age(path, data["made"], oldest, now or datetime.now(UTC))
    return replace(_checked(path, data), digest=hashlib.sha256(read).digest())


def _check_age(path: Path, made: Any, oldest: float, now: datetime) -> None:
    try:
        age = (now - datetime.fromisoformat(made)) / timedelta(days=1)
    except (TypeError, ValueError):
        raise BadInput(f"{path}: made {made!r}; give a date with its zone, ISO 8601.") from None
    if not -1 <= age <= oldest:
        raise BadInput(
            f"{path}: made {made}, {age:.0f} days ago; at most {oldest:g} days are allowed, because"
            f" cameras are moved by accident. Calibrate again, or allow more days."
        )


def _numbers(path: Path, name: str, value: Any, shape: tuple[int, ...]) -> Array:
    try:
        made = np.asarray(value, float)
    except (TypeError, ValueError):
        made = np.array(math.nan)
    if made.shape != shape or not np.isfinite(made).all():
        what = " x ".join(map(str, shape)) or "one"
        raise BadInput(
            f"{path}: {name} = {value}; allowed: {what} finite number(s). Calibrate again."
        )
    return made


def _checked(path: Path, data: dict[str, Any]) -> Calibration:
    def take(name: str, *shape: int) -> Array:
        return _numbers(path, name, data[name], shape)

    size, matrix, rotation = take("size", 2), take("matrix", 3, 3), take("rotation", 3, 3)
    position, index = take("position", 3), float(take("index"))
    straight = np.abs(rotation @ rotation.T - np.eye(3)).max() < 1e-6 < np.linalg.det(rotation)
    for name, good in (
        ("size", (size > 0).all()), ("matrix", matrix[0, 0] > 0 and matrix[1, 1] > 0),
        ("rotation", straight), ("position", position[2] > 0), ("index", 1 <= index < 2),
    ):  # fmt: skip
        if not good:
            raise BadInput(
                f"{path}: {name} = {data[name]} is impossible for a camera. Calibrate again."
            )
    columns, rows = size.astype(int).tolist()
    lens = Lens((columns, rows), matrix, take("distortion", 5), float(take("lens_rms_px")))
    hung = Hung(rotation, position, float(take("place_rms_m")))
    fish, target = (_tag(path, name, data[name], position[2]) for name in ("fish", "target"))
    pool = _pool(path, data.get("pool"))
    fixed = _fixed(path, data.get("fixed", {}))
    told = data["made"], pool, fixed, data["provenance"]
    return Calibration(lens, hung, fish, target, index, *told)


def _fixed(path: Path, value: Any) -> dict[int, tuple[float, float, float]]:
    """The surveyed tags; none in older files."""
    if not isinstance(value, dict) or not all(str(one).isdigit() for one in value):
        raise BadInput(f"{path}: fixed = {value}; allowed: a table of tags. Calibrate again.")
    found = {}
    for ident, place in value.items():
        x, y, z = _numbers(path, f"fixed.{ident}", place, (3,)).tolist()
        found[int(ident)] = (x, y, z)
    return found


def _pool(path: Path, value: Any) -> tuple[float, float] | None:
    """Length and width [m]; None in older files."""
    if value is None:
        return None
    length, width = _numbers(path, "pool", value, (2,)).tolist()
    if not is_pool(length, width):
        raise BadInput(
            f"{path}: pool = {value}; each side must be {SMALLEST:g} to {LARGEST:g} m. Calibrate"
            f" again with --pool."
        )
    return length, width


def _tag(path: Path, name: str, value: Any, highest: float) -> Tag:
    given = value if isinstance(value, dict) else {}
    side, height = (
        float(_numbers(path, f"{name}.{part}", given.get(part), ())) for part in ("side", "height")
    )
    if not (side > 0 and height < highest):
        raise BadInput(f"{path}: {name} = {value}; allowed: side above 0, height below the camera.")
    return Tag(side, height)
