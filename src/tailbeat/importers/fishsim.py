"""Read marker files of srl-ethz/fishsim as recordings."""

from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray

from tailbeat.files import BadInput, refuse_existing
from tailbeat.recording import Recording, is_marker, markers, write_recording

Array = NDArray[np.float64]

# srl-ethz/fishsim: nine markers, pixels, y down, 60 fps as its repository declares.
FISHSIM_MARKERS = 9
HEAD_DISTANCE = 0.142  # m between head markers 0 and 1
TAIL_MARKERS = (3, 4, 5, 6, 7)
TAIL_SPACING = np.array([0.030, 0.032, 0.029, 0.021])  # m along the body, markers 3-4 … 6-7
# Relative error allowed in two tail markers' spacing; chosen on the clean files f0_75 and f1_00.
SLIP = 0.4
JUMP = 0.05  # m from its running median that no marker moves within a frame at 60 fps (3 m/s)


def convert(csv: Path, out: Path, frame_rate: float) -> Recording:
    """Read a fishsim marker file and write a recording to `out`, .csv or .parquet; `frame_rate`
    [Hz]. Raises BadInput as `import_fishsim` and `write_recording` do."""
    refuse_existing(out)
    if not frame_rate > 0:
        raise BadInput(f"--frame-rate {frame_rate:g}: give the video's frames per second, above 0.")
    recording = import_fishsim(csv, frame_rate)
    write_recording(recording, out)
    return recording


def import_fishsim(path: str | Path, frame_rate: float = 60.0) -> Recording:
    """Marker tracks of a fishsim CSV as a recording in metres and radians.

    Scale is 0.142 m over the mean distance [pixels] of markers 0 and 1. The world frame has its
    origin at the first head pose, x along the mean heading of the first second and y to the left.
    The pose columns are of the midpoint of head markers 0 and 1. The frequency in a file's name is
    not used: it is not the tail's. A slipped marker counts as unseen: gaps of up to 0.1 s are
    interpolated, longer ones are NaN. Raises BadInput that names file and row.
    """
    file = Path(path)
    if not 0 < frame_rate < np.inf:
        raise BadInput(f"{file}: frame rate {frame_rate:g}; give frames per second, above 0.")
    tracks, scale = _to_metres(file, _read_pixels(file))
    dropped = _slips(tracks)
    tracks[dropped] = np.nan
    time = np.arange(len(tracks)) / frame_rate
    pose = _head_pose(_bridged_head(file, time, tracks))
    pose, tracks = _to_start(pose, tracks, max(1, int(frame_rate)))
    columns = {"x_m": pose[:, 0], "y_m": pose[:, 1], "yaw_rad": pose[:, 2], **_columns(tracks)}
    meta = {
        "source": f"srl-ethz/fishsim {file.name}",
        "frame_rate_hz": f"{frame_rate:g}",
        "metres_per_pixel": f"{scale:.6g}",
        "frames_dropped_per_marker": " ".join(map(str, dropped.sum(axis=0))),
    }
    return fill_gaps(Recording(file.stem, time, columns, meta))


def _read_pixels(file: Path) -> Array:
    """(frames, 9, 2) pixels."""
    if not file.is_file():
        raise BadInput(f"{file}: no such file; give a fishsim marker CSV.")
    try:
        table = pl.read_csv(file, has_header=False, infer_schema=False)
        frame = table.select(pl.all().cast(pl.Float64, strict=False))
    except (pl.exceptions.PolarsError, UnicodeDecodeError):
        raise BadInput(f"{file}: not a CSV; give a fishsim marker file.") from None
    if frame.width != 2 * FISHSIM_MARKERS or frame.height < 2:
        raise BadInput(
            f"{file}: {frame.height} rows of {frame.width} columns; a fishsim marker file has no"
            f" header and {2 * FISHSIM_MARKERS} columns of pixels."
        )
    values = frame.fill_null(float("nan")).to_numpy()
    bad = np.argwhere(~np.isfinite(values))
    if bad.size:
        row, column = bad[0]
        raise BadInput(
            f"{file}: row {row + 1}, column {column + 1}: {table[int(row), int(column)]!r} is not a"
            f" finite number; correct or remove the row."
        )
    return values.reshape(-1, FISHSIM_MARKERS, 2)


def _to_metres(file: Path, pixels: Array) -> tuple[Array, float]:
    """Tracks (frames, 9, 2) [m], y up, and the metres per pixel."""
    distance = np.linalg.norm(pixels[:, 0] - pixels[:, 1], axis=1).mean()
    if distance < 1:
        raise BadInput(f"{file}: head markers 0 and 1 coincide; give a fishsim marker file.")
    scale = HEAD_DISTANCE / distance
    return pixels * [scale, -scale], float(scale)  # image y is down


def _slips(tracks: Array) -> NDArray[np.bool_]:
    """Where a marker's track is wrong: jumps of any marker, tail markers out of their spacing."""
    wild = _jumps(tracks)
    tail = list(TAIL_MARKERS)
    wild[:, tail] |= ~_consistent(tracks[:, tail])
    return wild


def _jumps(tracks: Array) -> NDArray[np.bool_]:
    """Samples that are further than `JUMP` from the median of the five frames around them."""
    padded = np.pad(tracks, ((2, 2), (0, 0), (0, 0)), mode="reflect")  # finds a bad first frame
    windows = np.stack([padded[i : i + len(tracks)] for i in range(5)])
    return np.asarray(np.linalg.norm(tracks - np.median(windows, axis=0), axis=2) > JUMP)


def _consistent(tail: Array) -> NDArray[np.bool_]:
    """Per frame, the largest subset of tail markers whose spacings match `TAIL_SPACING`.

    Of several subsets of one size, the one with the smallest total misfit is kept. A subset has at
    least two markers; without one, no tail marker of the frame is kept.
    """
    place = np.concatenate([[0.0], np.cumsum(TAIL_SPACING)])
    best = np.zeros(tail.shape[:2], dtype=bool)
    score = np.full(len(tail), np.inf)
    for size in (2, 3, 4, 5):
        for subset in map(list, combinations(range(5), size)):
            gaps = np.linalg.norm(np.diff(tail[:, subset], axis=1), axis=2)
            misfit = np.abs(gaps / np.diff(place[subset]) - 1)
            rank = np.where(misfit.max(axis=1) < SLIP, misfit.sum(axis=1) - 100 * size, np.inf)
            better = rank < score
            score = np.where(better, rank, score)
            best[better] = np.isin(np.arange(5), subset)
    return best


def _columns(tracks: Array) -> dict[str, Array]:
    return {
        f"marker{k}_{axis}_m": tracks[:, k, i]
        for k in range(tracks.shape[1])
        for i, axis in enumerate("xy")
    }


def _bridged_head(file: Path, time: Array, tracks: Array) -> Array:
    """(frames, 2, 2) head markers without gaps: the pose needs both in every frame."""
    head, _ = markers(fill_gaps(Recording(file.stem, time, _columns(tracks[:, :2]))))
    lost = np.argwhere(np.isnan(head[..., 0]))
    if lost.size:
        row, marker = lost[0]
        raise BadInput(
            f"{file}: row {row + 1}: head marker {marker} jumps, and is lost for over 0.1 s or at"
            f" an end of the file; keep only the rows where the head is tracked."
        )
    return head


def _head_pose(head: Array) -> Array:
    """x, y [m] of the midpoint of markers 0 and 1, and yaw [rad] from 1 to 0, unwrapped."""
    front, rear = head[:, 0], head[:, 1]
    axis = front - rear
    yaw = np.unwrap(np.arctan2(axis[:, 1], axis[:, 0]))
    return np.column_stack([(front + rear) / 2, yaw])


def _to_start(pose: Array, tracks: Array, second: int) -> tuple[Array, Array]:
    """Move and turn the world to the first pose and the first second's mean heading."""
    origin, heading = pose[0, :2].copy(), pose[:second, 2].mean()
    cos, sin = np.cos(heading), np.sin(heading)
    turn = np.array([[cos, -sin], [sin, cos]])  # rows times this turns by -heading
    moved = np.column_stack([(pose[:, :2] - origin) @ turn, pose[:, 2] - heading])
    return moved, (tracks - origin) @ turn


def fill_gaps(recording: Recording, longest: float = 0.1) -> Recording:
    """Interpolate unseen marker samples linearly over gaps of up to `longest` [s]. Longer gaps, and
    gaps at the ends, stay NaN."""
    columns = {
        name: _bridge(recording.time, column, longest) if is_marker(name) else column
        for name, column in recording.columns.items()
    }
    return replace(recording, columns=columns)


def _bridge(time: Array, column: Array, longest: float) -> Array:
    seen = np.flatnonzero(np.isfinite(column))
    if seen.size < 2:
        return column
    gap_start = seen[np.searchsorted(seen, np.arange(time.size), side="right").clip(1) - 1]
    gap_end = seen[np.searchsorted(seen, np.arange(time.size)).clip(max=seen.size - 1)]
    inside = (gap_start < np.arange(time.size)) & (gap_end > np.arange(time.size))
    short = inside & (time[gap_end] - time[gap_start] <= longest + 1e-9)
    return np.where(short, np.interp(time, time[seen], column[seen]), column)
