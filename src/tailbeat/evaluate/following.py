"""A swim after a target that moves by the clock, in real time or in process, and what came of
it."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tailbeat.control.actions import PERIOD
from tailbeat.control.measure import Measure
from tailbeat.control.policy import Policy, decide, load_policy
from tailbeat.env.curriculum import trained_speed
from tailbeat.env.task import Scene
from tailbeat.evaluate.evaluation import EvaluationConfig, pool_of
from tailbeat.evaluate.path_start import behind, tested
from tailbeat.evaluate.runs import Runs
from tailbeat.evaluate.store import read_record
from tailbeat.evaluate.swim import Counting, Say, log_in
from tailbeat.evaluate.track import KEPT, LONG, SETTLING, passes
from tailbeat.evaluate.trial import Pool, swim
from tailbeat.files import BadInput
from tailbeat.operator.follow import FollowRecord, Hold
from tailbeat.operator.target_path import EIGHT, SLACK, PathAsked, TargetPath, target_path
from tailbeat.pool.plant import Surroundings

Array = NDArray[np.float64]
GAP = 0.3  # s without a pose over which none is guessed
COUNTED = 1.0  # s of a swim that must count (chosen)
DENSE = 0.01  # m between points of a path to which a distance is measured


@dataclass(frozen=True)
class FollowConfig:
    """A `policy` (name or file) swims as the pool's `fish` after the target `asked`. `twin` names
    the fish that it was trained on, if that is not a shipped one."""

    policy: str
    asked: PathAsked
    fish: str = "pulley-fish"
    twin: str | None = None
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Followed:
    """What a swim after a target was: the path, the record of who was where, and who swam in which
    pool; of a swim in real time the fish's `log`, of one in process its `runs`."""

    path: TargetPath
    record: FollowRecord
    log: Path | None
    config: FollowConfig
    policy: Policy
    pool: Pool
    runs: Runs | None = None


@dataclass(frozen=True, eq=False)
class Track:
    """A swim at every control period (k,): `after` the start [s], the `tag` (k, 2) [m], NaN where
    it was not seen, and the `target` (k, 2) [m]."""

    after: Array
    tag: Array
    target: Array

    @property
    def distance(self) -> Array:
        """Distance of the tag from the target (k,) [m]."""
        return np.asarray(np.hypot(*(self.tag - self.target).T))


@dataclass(frozen=True)
class FollowResult:
    """How a fish followed a target by the clock.

    The path, the time [s] that the target moved and its mean speed [m/s]. Distances [m] from the
    target after the first 5 s of the paper's fish: mean, median, 95th percentile, largest. Rms
    distance from the path [m]. Whether it `kept` the target within `kept_within` [m] for all that
    time. On a figure eight, how often it crossed the middle cleanly, with its direction over 0.4 s
    and over 2 s, `of` how many times that the target did. Its holds, and whether the target went to
    the end of its path.
    """

    path: str
    seconds: float
    target_speed: float
    mean_distance: float
    median_distance: float
    p95_distance: float
    largest_distance: float
    aside_rms: float
    kept: bool
    kept_within: float
    crossings: int | None
    crossings_over_2_s: int | None
    of: int | None
    finished: bool
    holds: tuple[Hold, ...]

    @property
    def faults(self) -> tuple[str, ...]:
        """Why this was not a swim that kept its target; empty if it was."""
        said = [f"{one.state} after {one.after:.1f} s: {one.reason}" for one in self.holds]
        if not self.finished:
            said.append("the fish did not swim to the end of the path")
        if not self.kept:
            said.append(
                f"the target was not kept: up to {self.largest_distance:.2f} m away,"
                f" {self.kept_within:g} m are allowed"
            )
        return tuple(said)


def live(config: FollowConfig, out: Path, say: Say) -> Followed:
    """Swim in real time after the target, through camera, network, servo and IMU. Everything that
    was asked for is checked before anything starts. Raises BadInput."""
    loaded, where, path = _entered(config, say)
    from tailbeat.emulators.live import Chain, follow  # needs OpenCV

    log, seen = log_in(out), out / "path.json"
    seen.unlink(missing_ok=True)
    x, y, yaw = behind(path, where.measure, where.walls)
    start = f"{x:.3f},{y:.3f},{np.degrees(yaw):.1f}"
    chain = Chain(
        config.policy, config.fish, config.seed, "127.0.0.1:0", out, start, pool=where.walls
    )
    follow(chain, config.asked, say)
    record = read_record(FollowRecord, seen)
    if record.began is None:
        raise BadInput(f"{log}: the fish never swam; its last state was {record.last or 'none'}.")
    return Followed(path, record, log, config, loaded, where)


def direct(config: FollowConfig, counting: Counting, say: Say) -> Followed:
    """Swim after the target in the pool's plant, in process and faster than real time. Raises
    BadInput.

    The fish starts at rest where the sign test of a swim in real time is assumed to end.
    """
    loaded, where, path = _entered(config, say)
    start, steps = tested(path, where), round(path.seconds / PERIOD)
    target = path.along(np.asarray(PERIOD * np.arange(steps + 1), dtype=np.float64))
    scene = Scene(start, np.zeros((1, 3)), target[None], np.array([math.inf]))
    around, seconds = Surroundings(walls=where.walls), path.seconds / where.measure.time
    given = {"around": (around,), "seconds": seconds}
    asked = where.condition("path", scene, stop=False, **given)
    with counting() as progress:
        done = iter(range(1, steps + 1))

        def choose(seen: NDArray[np.float32]) -> NDArray[np.float32]:
            progress("steps", next(done), steps)
            return decide(loaded, seen)

        runs = swim(choose, asked, [config.seed])
    return Followed(path, _seen(runs), None, config, loaded, where, runs)


def _seen(runs: Runs) -> FollowRecord:
    """The record of a swim in process, one row for each control step."""
    time = PERIOD * np.arange(runs.pose.shape[1])
    rows = np.column_stack([time, runs.pose[0], runs.target[0]]).tolist()
    return FollowRecord(0.0, not runs.lost[0], (), tuple(map(tuple, rows)))


def _entered(config: FollowConfig, say: Say) -> tuple[Policy, Pool, TargetPath]:
    """Check the configuration and say what the policy was not trained for; returns the policy, the
    pool and the path. Raises BadInput."""
    loaded = load_policy(config.policy)
    measure = loaded.contract.measure
    given = EvaluationConfig(config.fish, config.twin, "full", episodes=2, seed=config.seed)
    pool, trained = pool_of(loaded, given), trained_speed(loaded.contract)
    path = target_path(config.asked, pool.walls, measure)
    _check_time(path, measure)
    if path.fastest > SLACK * trained:
        say(
            f"--path {path.name}: the target moves at up to {path.fastest:.2f} m/s; {config.policy}"
            f" was trained with {_targets(trained)}, so it may fall behind."
        )
    return loaded, pool, path


def _targets(speed: float) -> str:
    return f"at most {speed:.2g} m/s" if speed else "targets that stay"


def _check_time(path: TargetPath, measure: Measure) -> None:
    """Check that some of the swim counts. Raises BadInput."""
    settling = SETTLING * measure.time
    if path.seconds < settling + COUNTED:
        raise BadInput(
            f"--path {path.name}: the target moves for {path.seconds:.3g} s, of which the first"
            f" {settling:.3g} s do not count; let it move for {settling + COUNTED:.3g} s or more."
        )


# ---- what came of it ----------------------------------------------------------------------------


def track(path: TargetPath, record: FollowRecord) -> Track:
    """The swim at every control period, from the frames that the station saw."""
    frames = np.array(record.seen, float).reshape(-1, 6)  # None becomes NaN
    frames = frames[np.isfinite(frames[:, 1])]
    last = float(frames[-1, 0]) if len(frames) else 0.0
    after = np.arange(0.0, min(last, path.seconds) + 1e-9, PERIOD)
    tag = np.full((len(after), 2), np.nan)
    if len(frames):
        at = frames[:, 0]
        tag = np.stack([np.interp(after, at, frames[:, 1 + k]) for k in (0, 1)], axis=1)
        later = np.clip(np.searchsorted(at, after), 1, max(len(at) - 1, 1))
        hidden = np.diff(at, append=at[-1])[later - 1] > GAP
        tag[hidden | (after < at[0])] = np.nan
    return Track(after, tag, path.along(after))


def result(followed: Followed) -> FollowResult:
    """The numbers of a swim after a target. Raises BadInput if nothing was seen that counts."""
    path, record, m = followed.path, followed.record, followed.pool.measure
    whole = track(path, record)
    settled = whole.after >= SETTLING * m.time
    away = whole.distance[settled]
    if not np.isfinite(away).any():
        raise BadInput(
            f"{followed.log or '--direct'}: the fish was not seen after the first"
            f" {SETTLING * m.time:.3g} s, which do not count; let the target move for longer."
        )
    passed, slowly, of = crossings(path, whole, m)
    return FollowResult(
        path=path.name,
        seconds=float(whole.after[-1]),
        target_speed=path.speed,
        mean_distance=float(np.nanmean(away)),
        median_distance=float(np.nanmedian(away)),
        p95_distance=float(np.nanpercentile(away, 95)),
        largest_distance=float(np.nanmax(away)),
        aside_rms=float(np.sqrt(np.nanmean(np.square(aside(path, whole.tag[settled]))))),
        kept=bool(np.nanmax(away) < KEPT * m.reach),
        kept_within=KEPT * m.reach,
        crossings=passed,
        crossings_over_2_s=slowly,
        of=of,
        finished=record.finished,
        holds=record.holds,
    )


def crossings(path: TargetPath, whole: Track, measure: Measure) -> tuple[int | None, ...]:
    """Clean passes through the middle of a figure eight, with directions over 0.4 s and over 2 s,
    and the target's own; None elsewhere."""
    if path.name != EIGHT:
        return None, None, None
    target = whole.target / measure.reach
    tag = np.nan_to_num(whole.tag / measure.reach, nan=1e6)  # not seen: far away
    return passes(tag, target), passes(tag, target, LONG), passes(target, target)


def aside(path: TargetPath, places: Array) -> Array:
    """Distance of each place (k, 2) [m] from the path (k,) [m]."""
    way = np.append(0.0, np.cumsum(np.hypot(*np.diff(path.places, axis=0).T)))
    points = np.arange(0.0, way[-1] + DENSE, DENSE)
    line = np.stack([np.interp(points, way, column) for column in path.places.T], axis=1)
    return np.array([np.hypot(*(one - line).T).min() for one in places])
