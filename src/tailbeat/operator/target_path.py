"""A target that moves by the clock: where it is at a time, from a named path or a file.

Everything is checked before anything moves: numbers, times, jumps, the pool's walls and the fish's
speed.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tailbeat.control.measure import PAPER, SPEED, Measure
from tailbeat.files import BadInput
from tailbeat.link.places import POOL
from tailbeat.operator.path_file import FilePath, read_path_file
from tailbeat.operator.paths import LAP, MARGIN, PATHS, even, lap_length

Array = NDArray[np.float64]
Place = tuple[float, float]
EIGHT = "figure-eight"
NAMES = {EIGHT: "eight", "circle": "circle", "square": "square"}
USUAL = 0.12  # m/s of the paper's fish: a target's speed where none is given (chosen)
POINTS = 1000  # of one lap of a named path
JUMP = 0.25  # m of the paper's fish: neighbours that are farther apart are a jump (chosen)
CLOSED = 0.01  # m: a file whose last point is so near the first is a closed path
LONGEST, MOST_LAPS = 3600.0, 100_000  # s
SLACK = 1.01  # of the fastest speed: the points of a named path are not quite even
AHEAD = 0.05  # m of a path that give its first direction


@dataclass(frozen=True)
class PathAsked:
    """What a person asks for: the name of a path or a file, the target's speed [m/s], and how many
    laps or seconds it moves; None for the usual."""

    path: str
    speed: float | None = None
    laps: int | None = None
    seconds: float | None = None


@dataclass(frozen=True, eq=False)
class TargetPath:
    """A path by the clock: `places` (k, 2) [m] at the rising times `time` (k,) [s], from 0.

    Between two places the target moves in a straight line. A `closed` path ends where it begins,
    and repeats. The target moves for `seconds`.
    """

    name: str
    time: Array
    places: Array
    closed: bool
    seconds: float

    @property
    def lap(self) -> float:
        """Time of the whole path once [s]."""
        return float(self.time[-1])

    @property
    def speed(self) -> float:
        """Mean speed [m/s]."""
        return float(np.hypot(*np.diff(self.places, axis=0).T).sum()) / self.lap

    @property
    def speeds(self) -> Array:
        """Speed from each place to the next (k - 1,) [m/s]."""
        return np.asarray(np.hypot(*np.diff(self.places, axis=0).T) / np.diff(self.time))

    @property
    def fastest(self) -> float:
        """Largest of the speeds [m/s]."""
        return float(self.speeds.max())

    @property
    def heading(self) -> float:
        """Direction in which the target begins to move [rad]."""
        away = self.places - self.places[0]
        first = int(np.argmax(np.hypot(*away.T) >= min(AHEAD, np.hypot(*away.T).max())))
        return float(np.arctan2(away[first, 1], away[first, 0]))

    def along(self, seconds: Array) -> Array:
        """Places (n, 2) [m] at times (n,) [s]; before the start it rests at the first one."""
        at = np.maximum(seconds, 0.0)
        at = at % self.lap if self.closed else np.minimum(at, self.lap)
        return np.stack([np.interp(at, self.time, column) for column in self.places.T], axis=-1)

    def at(self, seconds: float) -> Place:
        """Place [m] at a time [s]."""
        x, y = self.along(np.array([seconds]))[0].tolist()
        return x, y


def target_path(
    asked: PathAsked, pool: tuple[float, float] = POOL, measure: Measure = PAPER
) -> TargetPath:
    """The path that a person asks for, checked, in a pool of this length and width [m] and in a
    fish's measure. Raises BadInput."""
    if asked.path in NAMES:
        path, found = _named(asked, measure), None
    else:
        found = read_path_file(asked.path)
        path = _of_file(asked, found, measure)
    _check_places(path, found, pool, MARGIN * measure.reach)
    _check_speed(path, found, fastest(measure))
    return path


def fastest(measure: Measure) -> float:
    """Speed [m/s] of the fish's quick swims, which a target must not exceed."""
    return SPEED * measure.speed


def _named(asked: PathAsked, measure: Measure) -> TargetPath:
    shape = PATHS[NAMES[asked.path]]
    length = lap_length(shape) * measure.reach
    lap = LAP * measure.time if asked.path == EIGHT else length / (USUAL * measure.speed)
    if asked.speed is not None:
        lap = length / _speed(asked.speed, measure)
    places = even(shape, POINTS) * measure.reach
    time = np.linspace(0.0, lap, POINTS + 1)
    return TargetPath(
        asked.path, time, np.vstack([places, places[:1]]), True, _seconds(asked, lap, True)
    )


def _of_file(asked: PathAsked, found: FilePath, measure: Measure) -> TargetPath:
    places, steps = found.places, np.hypot(*np.diff(found.places, axis=0).T)
    far = np.flatnonzero(steps > JUMP * measure.reach)
    if far.size:
        k = int(far[0])
        raise BadInput(
            f"{found.between(k)}: the path jumps by {steps[k]:.2f} m; neighbours may be"
            f" {JUMP * measure.reach:g} m apart, so put points between them."
        )
    if not steps.any():
        raise BadInput(f"{found.name}: all points are the same place; give a path.")
    if found.time is None:
        speed = USUAL * measure.speed if asked.speed is None else _speed(asked.speed, measure)
        places = places[np.append(True, steps > 0)]
        time = np.append(0.0, np.cumsum(steps[steps > 0])) / speed
    elif asked.speed is not None:
        raise BadInput(f"--speed {asked.speed:g}: {found.name} has a column time; leave it out.")
    else:
        time = found.time - found.time[0]
    closed = bool(np.hypot(*(places[-1] - places[0])) <= CLOSED)
    whole = _seconds(asked, float(time[-1]), closed)
    return TargetPath(found.name, time, places, closed, whole)


def _speed(speed: float, measure: Measure) -> float:
    """The speed that a person gives [m/s]. Raises BadInput."""
    most = fastest(measure)
    if not 0 < speed <= most:
        raise BadInput(
            f"--speed {speed:g}: allowed are speeds above 0 and up to {most:g} m/s, the fastest"
            f" of the fish."
        )
    return speed


def _seconds(asked: PathAsked, lap: float, closed: bool) -> float:
    """How long the target moves [s]. Raises BadInput."""
    if asked.laps is not None and asked.seconds is not None:
        raise BadInput(f"--laps {asked.laps} and --seconds {asked.seconds:g}: give one of them.")
    if asked.seconds is not None and not 0 < asked.seconds < math.inf:
        raise BadInput(f"--seconds {asked.seconds:g}: give a time above 0.")
    if asked.laps is not None and not 1 <= asked.laps <= MOST_LAPS:
        raise BadInput(f"--laps {str(asked.laps)[:20]}: give 1 or more, up to {MOST_LAPS}.")
    whole = lap * (asked.laps or 1) if asked.seconds is None else asked.seconds
    if not closed and whole > lap * (1 + 1e-9):
        raise BadInput(
            f"--path {asked.path}: it ends after {lap:.4g} s, and not where it begins; give one lap"
            f" or fewer seconds, or a path that returns to its first point."
        )
    if whole > LONGEST:
        raise BadInput(f"--path {asked.path}: it takes {whole:g} s; {LONGEST:g} s are allowed.")
    return whole


def _check_places(
    path: TargetPath, found: FilePath | None, pool: tuple[float, float], margin: float
) -> None:
    """Check that no point is too close to a wall. Raises BadInput."""
    room = np.array(pool) / 2 - margin
    points = path.places if found is None else found.places
    bad = np.flatnonzero((np.abs(points) > room).any(axis=1))
    if not bad.size:
        return
    k = int(bad[0])
    where = f"--path {path.name}" if found is None else found.line(k)
    x, y = points[k]
    raise BadInput(
        f"{where}: x {x:.2f}, y {y:.2f} m is outside the pool or less than {margin:g} m from a"
        f" wall; in this pool of {pool[0]:g} x {pool[1]:g} m, x -{max(room[0], 0):.2f} to"
        f" {max(room[0], 0):.2f} and y -{max(room[1], 0):.2f} to {max(room[1], 0):.2f} m are"
        f" allowed."
    )


def _check_speed(path: TargetPath, found: FilePath | None, most: float) -> None:
    """Check that the target is never faster than the fish. Raises BadInput."""
    speeds = path.speeds
    k = int(np.argmax(speeds))
    if speeds[k] <= most * SLACK:
        return
    where = f"--path {path.name}" if found is None else found.between(k)
    raise BadInput(
        f"{where}: the target moves at {speeds[k]:.2f} m/s; at most {most:g} m/s are allowed, the"
        f" fastest of the fish."
    )
