"""The motion that a film shows: pose, bent tail and target at every frame, from a log or a tour.

A log has the shaft's angle, but not the tail's shape. The compiled twin's motor is driven through
the logged angle in water, and its hinge angles are used; its root is placed at the camera's pose.
The poses are smoothed between the camera's frames.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import gaussian_filter1d
from scipy.signal import savgol_filter

from tailbeat.control.actions import PERIOD
from tailbeat.control.measure import ARRIVAL, arrival_of
from tailbeat.files import BadInput
from tailbeat.fish.description import Fish, length_of
from tailbeat.fish.outline import MOTOR
from tailbeat.fish.rollout import Start, replay_command, swim
from tailbeat.fish.twin import Options, compile_twin

if TYPE_CHECKING:  # a process that renders would wait for the pool's compiled code
    from tailbeat.evaluate.tour import Tour

Array = NDArray[np.float64]
Row = Mapping[str, Any]
NEEDED = ("time_s", "x_m", "y_m", "yaw_rad", "motor_angle_rad")  # fields of a log's rows
TARGET = slice(3, 5)  # of the newest frame in `decided_on`
SHORTEST = 0.5  # s of poses that make a film
BEFORE = 1.0  # s that a film shows before the fish swims
GRID = 120.0  # Hz at which poses are smoothed: twice a camera's rate
WINDOW = 25  # samples of it: a cubic fit passes beats up to 7 Hz
LEAD_IN = 1.0  # s in which the twin's straight tail moves to the log's first angle
RESTED = 0.5  # s that a target rests at a place before the fish can arrive there
SAME = 0.01  # m within which a target rests: its tag is seen with noise
LATE = 0.4  # of an arrival's distance: the log's last pose before it may be outside
CAMERA_LAG, CAMERA_TURN = (
    0.6,
    1.2,
)  # s over which a following camera's position and direction are averaged
AHEAD = 0.12  # m that it looks ahead of the fish's tag


@dataclass(frozen=True, eq=False)
class Motion:
    """A fish at `rate` frames per second [Hz]: generalised coordinates `qpos` (k, nv), the `tag`'s
    x, y [m] and yaw [rad] (k, 3), and its `target` (k, 2) [m], NaN where there is none. A target is
    reached within `arrival` [m]."""

    rate: float
    qpos: Array
    tag: Array
    target: Array
    arrival: float = ARRIVAL

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.qpos)

    def arrivals(self) -> tuple[tuple[int, float, float], ...]:
        """Frame and position x, y [m] of each target that the fish reached. One that moves is
        followed, not reached."""
        found, last = list[tuple[int, float, float]](), (np.inf, np.inf)
        reach = (1 + LATE) * self.arrival
        near = np.hypot(*(self.tag[:, :2] - self.target).T) < reach  # False for NaN
        for frame in np.flatnonzero(near & self._rests()).tolist():
            place = (float(self.target[frame, 0]), float(self.target[frame, 1]))
            if math.dist(place, last) > SAME:
                found.append((frame, *place))
                last = place
        return tuple(found)

    def _rests(self) -> NDArray[np.bool_]:
        """Whether the target was in the same place half a second ago (k,), or as long as it is
        known."""
        before = np.maximum(np.arange(self.frames) - round(RESTED * self.rate), 0)
        away = np.hypot(*(self.target - self.target[before]).T)
        return np.asarray(~(away > SAME))  # True for NaN: there was none yet


@dataclass(frozen=True)
class Span:
    """Part of a swim: from `start` [s] after its first row, `seconds` long. `start` None is a
    second before the fish first swims."""

    seconds: float = 20.0
    start: float | None = None


def of_tour(tour: "Tour", span: Span, rate: float, arrival: float = ARRIVAL) -> Motion:
    """A tour's motion; its shape is simulated or estimated. Targets are reached within `arrival`
    [m]."""
    return of_steps(tour.shape, tour.pose, tour.targets[tour.goal], span, rate, arrival)


def of_steps(
    shape: Array, pose: Array, target: Array, span: Span, rate: float, arrival: float = ARRIVAL
) -> Motion:
    """The motion of a simulated swim at its control steps: generalised coordinates (k, nv), the
    tag's pose (k, 3) and the target (k, 2)."""
    whole = PERIOD * (len(shape) - 1)
    first = min(span.start or 0.0, whole)
    wanted = _frames(first, min(first + span.seconds, whole), rate)
    at = np.asarray(PERIOD * np.arange(len(shape)), dtype=np.float64)
    held = np.minimum((wanted / PERIOD).astype(int), len(shape) - 1)
    qpos, tag = _resampled(at, shape, wanted), _resampled(at, pose, wanted)
    return Motion(rate, qpos, tag, target[held], arrival)


def of_log(log: Path, fish: Fish, span: Span, rate: float) -> Motion:
    """A log's motion. Raises BadInput for a log without poses or shaft angles."""
    from tailbeat.robot.log import read_rows  # needs the extra

    rows = _timed(log, read_rows(log))
    at, seen = _poses(log, rows)
    first = _first(log, rows, at, span)
    last = min(first + span.seconds, float(at[-1]))
    wanted = _frames(first, last, rate)
    tag = _smoothed(at, seen, wanted)
    tail = _tail(log, fish, rows, wanted)
    qpos, arrival = np.column_stack([root(fish, tag), tail]), arrival_of(length_of(fish))
    return Motion(rate, qpos, tag, _targets(rows, wanted), arrival)


# ---- what a log holds ---------------------------------------------------------------------------


def _timed(log: Path, rows: Sequence[Row]) -> list[Row]:
    """The rows that have a time. Raises BadInput where no row has one of `NEEDED`."""
    missing = [name for name in NEEDED if all(row.get(name) is None for row in rows)]
    if missing:
        raise BadInput(
            f"{log}: no row has {', '.join(missing)}; a film needs {', '.join(NEEDED)}, so give a"
            f" log of a fish that a camera saw."
        )
    return [row for row in rows if row["time_s"] is not None]


def _poses(log: Path, rows: Sequence[Row]) -> tuple[Array, Array]:
    """Times (k,) [s] and poses (k, 3) of the fish in the camera's frames, each frame once."""
    names = ("x_m", "y_m", "yaw_rad")
    whole = [row for row in rows if all(row[name] is not None for name in names)]
    pose = np.array([[row[name] for name in names] for row in whole], float).reshape(-1, 3)
    age = [row.get("pose_age_s") or 0.0 for row in whole]
    at = np.array([row["time_s"] for row in whole], float) - np.array(age, float)
    new = np.append(True, np.any(np.diff(pose, axis=0) != 0, axis=1))[: len(pose)]
    at, kept = np.unique(np.maximum.accumulate(at[new]), return_index=True)
    if not len(at) or at[-1] - at[0] < SHORTEST:
        span = at[-1] - at[0] if len(at) else 0.0
        raise BadInput(
            f"{log}: {len(at)} poses of the fish over {span:.1f} s; a film needs"
            f" {SHORTEST:g} s of them, so give a log in which the camera saw the fish."
        )
    pose = pose[new][kept]
    pose[:, 2] = np.unwrap(pose[:, 2])
    return at, pose


def _first(log: Path, rows: Sequence[Row], at: Array, span: Span) -> float:
    """Start of the film on the log's clock [s]."""
    begins = float(rows[0]["time_s"])
    if span.start is not None:
        first = max(begins + span.start, float(at[0]))
        if first > at[-1] - SHORTEST:
            raise BadInput(
                f"--start {span.start:g}: {log} has poses until {at[-1] - begins:.1f} s after its"
                f" first row; start {SHORTEST:g} s before that at the latest."
            )
        return first
    swims = next((row["time_s"] for row in rows if row.get("state") == "run"), begins)
    return float(np.clip(swims - BEFORE, at[0], at[-1] - SHORTEST))


def _targets(rows: Sequence[Row], wanted: Array) -> Array:
    """The target that the policy swam to at each time (k, 2); NaN while it did not swim."""
    swum = [row for row in rows if row.get("decided_on")]
    if not swum:
        return np.full((len(wanted), 2), np.nan)
    at = np.array([row["time_s"] for row in swum], float)
    places = np.array([row["decided_on"][TARGET] for row in swum], float)
    index = np.searchsorted(at, wanted, side="right") - 1
    return np.where(index[:, None] >= 0, places[np.maximum(index, 0)], np.nan)


# ---- pose and shape -----------------------------------------------------------------------------


def _frames(first: float, last: float, rate: float) -> Array:
    return first + np.arange(max(int((last - first) * rate + 1e-6), 1)) / rate


def _resampled(at: Array, values: Array, wanted: Array) -> Array:
    """Linear interpolation; the third column is an angle."""
    straight = values.copy()
    straight[:, 2] = np.unwrap(values[:, 2])
    return np.column_stack([np.interp(wanted, at, column) for column in straight.T])


def _smoothed(at: Array, seen: Array, wanted: Array) -> Array:
    """Poses (k, 3) at each time, without the camera's noise and steps."""
    grid = np.arange(at[0], at[-1] + 1 / GRID, 1 / GRID)
    even = np.column_stack([np.interp(grid, at, column) for column in seen.T])
    window = min(WINDOW, (len(grid) - 1) // 2 * 2 + 1)
    smooth = savgol_filter(even, window, 3, axis=0, mode="interp")
    return np.column_stack([np.interp(wanted, grid, column) for column in smooth.T])


def root(fish: Fish, tag: Array) -> Array:
    """Pose of the fish frame (k, 3) from the tag's."""
    ahead, left = fish.tracked[:2]
    c, s = np.cos(tag[:, 2]), np.sin(tag[:, 2])
    shift = np.stack([ahead * c - left * s, ahead * s + left * c], axis=1)
    return np.column_stack([tag[:, :2] - shift, tag[:, 2]])


def _tail(log: Path, fish: Fish, rows: Sequence[Row], wanted: Array) -> Array:
    """Motor and hinge angles (k, 1 + links) [rad] at each time."""
    known = [row for row in rows if row["motor_angle_rad"] is not None]
    at, kept = np.unique([row["time_s"] for row in known], return_index=True)
    angle = np.array([row["motor_angle_rad"] for row in known], float)[kept]
    shape = bent_tail(fish, at, angle, wanted)
    if shape is None:
        raise BadInput(
            f"{log}: the tail of {fish.name} cannot follow the logged shaft angles; give the fish"
            f" that swam with --fish."
        )
    return shape


def bent_tail(fish: Fish, at: Array, angle: Array, wanted: Array) -> Array | None:
    """Motor and hinge angles (k, 1 + links) [rad] of the twin at the times `wanted` (k,) [s].

    Its shaft is driven through `angle` (n,) [rad], sampled at the rising times `at` (n,) [s]. The
    twin swims freely: water and the head's yaw bend its tail as in the swim. None if it diverged.
    """
    twin = compile_twin(fish, Options(replayed=True))
    step = twin.model.opt.timestep
    times = np.arange(wanted[0] - LEAD_IN, wanted[-1] + 2 * step, step)
    if at.size > 1:
        given = PchipInterpolator(at, angle)(np.clip(times, at[0], at[-1]))
    else:
        given = np.full(times.size, angle[0])
    ease = np.clip((times - times[0]) / LEAD_IN, 0.0, 1.0)
    led = given * (3 - 2 * ease) * ease**2
    start = Start(np.zeros(3), np.zeros(3), led[0], (led[1] - led[0]) / step)
    done = swim([twin], [start], [replay_command(twin, led)], every=1)[0]
    if done.diverged:
        return None
    columns = done.qpos[:, MOTOR:].T
    return np.column_stack([np.interp(wanted, times, column) for column in columns])


# ---- the camera ---------------------------------------------------------------------------------


def followed(motion: Motion) -> tuple[Array, Array]:
    """Where a following camera looks (k, 2) [m] and its direction (k,) [rad]: a little ahead of the
    fish, averaged so that the beat does not shake the picture."""
    place = gaussian_filter1d(motion.tag[:, :2], CAMERA_LAG * motion.rate, axis=0, mode="nearest")
    yaw = gaussian_filter1d(motion.tag[:, 2], CAMERA_TURN * motion.rate, mode="nearest")
    ahead = AHEAD * np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
    return np.asarray(place + ahead), np.asarray(yaw)
