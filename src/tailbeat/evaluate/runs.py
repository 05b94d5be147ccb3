"""What a trial leaves behind: n swims as arrays, and a folder of them that survives a stop.

An arm is swum in chunks, each a file of its own, written beside and renamed: a trial that was cut
short is read up to its end and says so.
"""

import json
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.control.actions import PERIOD
from tailbeat.control.observation import bearing
from tailbeat.files import BadInput, leaves, new_file, write_json
from tailbeat.recording import Recording

Single = NDArray[np.float32]
Flags = NDArray[np.bool_]
SHOWN = 8  # fish of a chunk whose whole shape is kept
NEAR = 0.2  # m, the paper's wider circle


@dataclass(frozen=True, eq=False)
class Runs:
    """n swims of up to k control steps; after a swim's end everything is NaN.

    `pose` (n, k + 1, 3) of the tag, `target` (n, k + 1, 2), `motor` (n, k + 1) angle and `setpoint`
    (n, k) [rad]; `steps` swum, `reached`, `lost` (numbers left the finite, or out of range) (n,);
    `energy` (n,) [J] that the actuator put in, NaN in a twin; `shape` (m, k + 1, nv) the
    generalised coordinates of the first few; `water` (n,) which pool.
    """

    pose: Single
    target: Single
    motor: Single
    setpoint: Single
    steps: NDArray[np.int64]
    reached: Flags
    lost: Flags
    energy: Single
    shape: Single
    water: NDArray[np.int64]

    @property
    def count(self) -> int:
        """How many swims."""
        return len(self.steps)

    @property
    def distance(self) -> Single:
        """To the target at each time (n, k + 1) [m]."""
        apart = self.target - self.pose[..., :2]
        return np.asarray(np.hypot(apart[..., 0], apart[..., 1]))

    @property
    def nearest(self) -> Single:
        """Closest approach (n,) [m]."""
        return np.asarray(np.nanmin(self.distance, axis=1))

    @property
    def seconds(self) -> NDArray[np.float64]:
        """How long each swam (n,)."""
        return np.asarray(PERIOD * self.steps, dtype=np.float64)

    @property
    def bearing(self) -> Single:
        """Of the target at the start, from straight ahead (n,) [rad], in -pi to pi."""
        return np.asarray(bearing(self.pose[:, 0], self.target[:, 0]))

    def part(self, own: slice) -> "Runs":
        """Some of the swims; their shapes are left out."""
        values = {name: one[own] for name, one in vars(self).items() if name != "shape"}
        return Runs(**values, shape=self.shape[:0])


def surge(runs: Runs, seconds: float = 0.5) -> Single:
    """Speed along the heading (n, k) [m/s], averaged over so many seconds."""
    width = max(round(seconds / PERIOD), 1)
    step = np.diff(runs.pose[..., :2], axis=1) / PERIOD
    heading = runs.pose[:, :-1, 2]
    ahead = step[..., 0] * np.cos(heading) + step[..., 1] * np.sin(heading)
    kernel = np.ones(width) / width
    smooth = [np.convolve(row, kernel, mode="same") for row in ahead]
    return np.asarray(smooth, dtype=np.float32)


def as_recordings(runs: Runs, name: str, shortest: float = 1.0) -> list[Recording]:
    """The swims of `shortest` seconds or more as recordings: motor angle and pose of the tag."""
    return [
        _recording(runs, int(swim), f"{name} swim {swim + 1}")
        for swim in np.flatnonzero(runs.seconds >= shortest - 1e-9)
    ]


def _recording(runs: Runs, swim: int, name: str) -> Recording:
    numbers = np.column_stack([runs.motor[swim], runs.pose[swim]]).astype(np.float64)
    numbers = numbers[: runs.steps[swim] + 1]
    finite = np.isfinite(numbers).all(axis=1)  # a swim that was lost ends beside the numbers
    names = ("motor_angle_rad", "x_m", "y_m", "yaw_rad")
    columns = dict(zip(names, numbers[finite].T, strict=True))
    return Recording(name, np.flatnonzero(finite).astype(np.float64) * PERIOD, columns)


# ---- on disk ------------------------------------------------------------------------------------


def begin(out: Path, plan: dict[str, Any]) -> None:
    """Note what is asked for; raises BadInput where the folder holds other runs."""
    path, wanted = out / "plan.json", json.loads(json.dumps(plan))
    if not path.is_file():
        if out.exists() and any(out.iterdir()):
            raise BadInput(f"{out}: holds something else; choose a new folder.")
        write_json(path, plan)
        return
    held, wanted = leaves("", read_plan(out)), leaves("", wanted)
    names = sorted(set(held) | set(wanted), key=lambda name: (name.startswith("arms"), name))
    wrong = [name for name in names if held.get(name) != wanted.get(name)]
    if wrong:
        said = [f"{name} was {held.get(name)}, now {wanted.get(name)}" for name in wrong[:3]]
        more = f" and {len(wrong) - 3} more" if len(wrong) > 3 else ""
        raise BadInput(
            f"{out}: holds other runs: {'; '.join(said)}{more}; ask for the same, or choose a new"
            f" folder."
        )


def read_plan(out: Path) -> dict[str, Any]:
    """What a folder's runs were asked to be."""
    path = out / "plan.json"
    if not path.is_file():
        raise BadInput(f"{out}: no runs here (plan.json is missing); `tailbeat evaluate` makes it.")
    try:
        held: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except ValueError:
        raise BadInput(f"{path}: not readable JSON; evaluate into a new folder.") from None
    return held


def chunk_path(out: Path, arm: str, chunk: int) -> Path:
    """Where one chunk of an arm lies."""
    name = arm.replace(" ", "-").replace("/", "-per-")
    return out / "runs" / f"{name}.{chunk:03d}.npz"


def save(runs: Runs, path: Path) -> None:
    """Write one chunk."""
    with new_file(path, overwrite=True) as beside:
        np.savez_compressed(beside, **vars(runs))


def load(out: Path, arm: str, chunks: int) -> tuple[Runs, bool]:
    """All chunks of an arm that are there, and whether some are missing. Raises BadInput if none
    is."""
    paths = [chunk_path(out, arm, chunk) for chunk in range(chunks)]
    found = [path for path in paths if path.is_file()]
    if not found:
        raise BadInput(f"{out}: no swims of {arm!r} here; run the evaluation again to fill it.")
    return joined([read_chunk(path) for path in found]), len(found) < chunks


def read_chunk(path: Path) -> Runs:
    """One chunk's swims. Raises BadInput."""
    if not path.is_file():
        raise BadInput(f"{path}: no such file; give a chunk that `tailbeat evaluate` wrote.")
    try:
        with np.load(path) as held:
            return Runs(**{field.name: held[field.name] for field in fields(Runs)})
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise BadInput(f"{path}: cannot be read; delete it and evaluate again.") from error


def joined(parts: Sequence[Runs]) -> Runs:
    """Chunks as one; shorter ones are filled with NaN."""
    longest = max(part.motor.shape[1] for part in parts)
    values = {
        field.name: np.concatenate(
            [_filled(field.name, getattr(part, field.name), longest) for part in parts]
        )
        for field in fields(Runs)
    }
    return Runs(**values)


def _filled(name: str, values: Any, longest: int) -> Any:
    if values.ndim == 1:
        return values
    missing = longest - (name == "setpoint") - values.shape[1]
    if not missing:
        return values
    tail = np.full((len(values), missing, *values.shape[2:]), np.nan, dtype=np.float32)
    return np.concatenate([values, tail], axis=1)
