"""Following a target on a closed path inside the pool's walls."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.control.actions import PERIOD
from tailbeat.control.measure import PAPER, Measure
from tailbeat.control.observation import wrapped
from tailbeat.env.task import Scene
from tailbeat.evaluate.messy import at_level
from tailbeat.evaluate.runs import Runs
from tailbeat.evaluate.scenes import follow, stays
from tailbeat.evaluate.trial import Condition, Pool
from tailbeat.files import BadInput
from tailbeat.operator.paths import LAP, MARGIN, PATHS, even, lap_length
from tailbeat.pool.plant import Surroundings

SECONDS = LAP  # of every swim
EIGHT, LED_EIGHT, STAYS = "eight 73 s", "eight, led", "stays"
SHAPES = PATHS | {STAYS: stays}
LEAD, HASTE = 0.5, 0.5  # m, m/s: distance and largest speed of a target that waits for the fish


@dataclass(frozen=True)
class TargetPath:
    """A path, the time of one lap [s], and the target's `lead` as in `Scene`."""

    name: str
    path: str
    lap: float
    lead: float = np.inf


@dataclass(frozen=True)
class TrackResult:
    """Results of following a target on one path.

    The target's mean speed [m/s]; the distance to it and the rms distance to its path [m]; how many
    swims kept it; how many crossed the eight's middle cleanly twice, with the fish's direction over
    0.4 s and over 2 s, in which a slow fish's sway does not count; the share of the last minute
    within `BESIDE` of the target.
    """

    condition: str
    swims: int
    target_speed: float
    mean_distance: float
    median_distance: float
    p95_distance: float
    aside_rms: float
    kept: int
    two_crossings: int | None
    two_crossings_over_2_s: int | None
    beside: float


def _target_paths() -> tuple[TargetPath, ...]:
    lengths = {path: lap_length(way) for path, way in PATHS.items()}
    timed = [TargetPath(EIGHT, "eight", 73.0), TargetPath("eight 50 s", "eight", 50.0)]
    timed += [
        TargetPath(f"{path} {speed:g} m/s", path, lengths[path] / speed)
        for path in ("circle", "square")
        for speed in (0.06, 0.12, 0.18)
    ]
    led = [
        TargetPath(f"{path}, led", path, length / HASTE, LEAD) for path, length in lengths.items()
    ]
    return (*timed, *led, TargetPath(STAYS, STAYS, 1.0))


TARGET_PATHS = _target_paths()
# Of the paper's fish, as are the paths and their times.
SETTLING = 5.0  # s at the start that do not count
KEPT = 0.6  # m: largest distance to the target of a swim that kept it
BESIDE, MINUTE = 0.5, 60.0  # m, s: near a target, and how long that is looked at
CROSSING, ALIGNED = 0.15, np.radians(45)  # m, rad, of a clean pass through the eight's middle
AROUND, LONG = 10, 50  # control steps to either side, over which the fish's direction is taken
EARLY = 150  # control steps by which a fish may pass the middle before its target
SWIMS = 10
TRACK = "track"


def conditions(pool: Pool) -> list[Condition]:
    """Ten swims of 73 s per path, each with its own noise, and in its own lab unless the pool's is
    clean; one condition. The waters come one after the other over all paths."""
    parts = [
        follow(pool.fish, SHAPES[one.path], one.lap, SECONDS, SWIMS, one.lead, pool.measure)
        for one in TARGET_PATHS
    ]
    whole = Scene(*(np.concatenate([getattr(one, n) for one in parts]) for n in vars(parts[0])))
    around = (Surroundings(walls=pool.walls),)
    _check_room(pool.walls, pool.measure.reach)
    own = pool.condition(TRACK, whole, around=around, seconds=SECONDS, stop=False)
    return [own if pool.lab == "clean" else at_level(own, pool.lab, pool.seed)]


def _check_room(walls: tuple[float, float], reach: float) -> None:
    """Check that no path is too close to a wall. Raises BadInput."""
    for path, way in PATHS.items():
        length, width = reach * (2 * np.abs(even(way, 360)).max(axis=0) + 2 * MARGIN)
        if length > walls[0] or width > walls[1]:
            raise BadInput(
                f"walls of {walls[0]:g} x {walls[1]:g} m: the {path} needs {length:.1f} x"
                f" {width:.1f} m; use a larger pool, or omit --tasks track."
            )


def by_path(runs: Runs) -> dict[str, Runs]:
    """The condition's swims by path."""
    parts = {one.name: slice(SWIMS * i, SWIMS * (i + 1)) for i, one in enumerate(TARGET_PATHS)}
    return {name: runs.part(own) for name, own in parts.items()}


def numbers(by_condition: Mapping[str, Runs], measure: Measure = PAPER) -> tuple[TrackResult, ...]:
    """Results per path of the target, in the fish's measure."""
    swims = by_path(by_condition[TRACK])
    return tuple(result(one, swims[one.name], measure) for one in TARGET_PATHS)


def result(target: TargetPath, runs: Runs, measure: Measure = PAPER) -> TrackResult:
    """Results of swims after one target. A swim that was lost has not kept it."""
    first, last = (round(s * measure.time / PERIOD) for s in (SETTLING, MINUTE))
    path, reach = target.path, measure.reach
    away, off = runs.distance[:, first:], aside(runs, path)[:, first:]
    crossed = [_twice(runs, half) if path == "eight" else None for half in (AROUND, LONG)]
    moved = np.hypot(*np.moveaxis(np.diff(runs.target, axis=1), -1, 0))
    return TrackResult(
        condition=target.name,
        swims=runs.count,
        target_speed=float(np.nanmean(moved) / PERIOD),
        mean_distance=float(np.nanmean(away)),
        median_distance=float(np.nanmedian(away)),
        p95_distance=float(np.nanpercentile(away, 95)),
        aside_rms=float(np.sqrt(np.nanmean(np.square(off)))),
        kept=int((~runs.lost & (away.max(axis=1) < KEPT * reach)).sum()),
        two_crossings=crossed[0],
        two_crossings_over_2_s=crossed[1],
        beside=float((runs.distance[:, -last:] < BESIDE * reach).mean()),
    )


def aside(runs: Runs, path: str) -> NDArray[np.float64]:
    """Distance of each tag from the nearest point of the path (n, k + 1) [m]."""
    way = even(SHAPES[path], 720) * float(runs.reach[0])
    return np.stack(
        [
            np.hypot(*(place[:, None] - way).transpose(2, 0, 1)).min(axis=1)
            for place in runs.pose[..., :2]
        ]
    )


def _twice(runs: Runs, half: int) -> int:
    return int((crossings(runs, half) >= 2).sum())


def crossings(runs: Runs, half: int = AROUND) -> NDArray[np.int64]:
    """Clean passes of each swim (n,) through the middle of the eight: within 15 cm of it, moving
    within 45 deg of the target's direction there, over `half` control steps to either side."""
    unit = runs.reach[:, None, None]
    places = zip(runs.pose[..., :2] / unit, runs.target / unit, strict=True)
    return np.array([passes(place, target, half) for place, target in places])


def passes(pose: Any, target: Any, half: int = AROUND) -> int:
    """Count the target's passes through the middle that the fish repeated before the next one, at
    most `EARLY` steps before its target: of the paths (k, 2) of tag and target, one row for each
    control period, in the paper's measure."""
    at = np.hypot(*target.T)
    times = [
        k
        for k in range(1, len(at) - 1)
        if at[k] < 0.05 and at[k] <= at[k - 1] and at[k] < at[k + 1]
    ]
    begins = [max(k - EARLY, 0) for k in times]
    ends = [*begins, len(at) - 1][1:]
    return sum(
        _clean(pose, slice(first, last), target[k + 1] - target[k], half)
        for k, first, last in zip(times, begins, ends, strict=True)
    )


def _clean(pose: Any, part: slice, branch: Any, half: int) -> bool:
    """Whether a path passes the middle along the branch in a part of its rows."""
    near = np.nan_to_num(np.hypot(pose[part, 0], pose[part, 1]), nan=np.inf)
    if len(near) < 12 or not near.min() < CROSSING:
        return False
    k = part.start + int(near.argmin())
    way = pose[min(k + half, len(pose) - 1), :2] - pose[max(k - half, 0), :2]
    turn = np.arctan2(way[1], way[0]) - np.arctan2(branch[1], branch[0])
    return bool(abs(wrapped(turn)) < ALIGNED)
