"""Pieces of a robot's logged swims, and how far a twin's shaft and path are from them.

A piece begins in full swing. The tail's bend is unknown then, so the twin swims `WARM` seconds
before it is compared. Ours.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tailbeat.files import BadInput
from tailbeat.fish.description import Fish
from tailbeat.fish.period import PERIOD
from tailbeat.fish.rollout import Start, Swim, swim
from tailbeat.fish.twin import compile_twin
from tailbeat.identify.fluid import without_first_pose
from tailbeat.identify.swim_columns import Logged
from tailbeat.identify.tag_pose import root_pose, tracked_pose

Array = NDArray[np.float64]
Found = Mapping[
    str, float
]  # `setpoint`, `encoder` [rad], `late` [s], `current x`, `current y` [m/s]
WARM, SPAN = 1.5, 4.0  # s: not compared, compared (chosen)
NEAR = 0.2  # s about a piece's start, over which its first velocity is fitted
GAP = 0.25  # s without a pose that no piece holds
FEWEST, MOST = 8, 32  # pieces
# s from a piece's start: the compared samples of the shaft and of the path
SHAFT, PATH = np.arange(WARM, WARM + SPAN, 0.1), np.arange(WARM, WARM + SPAN - 0.2, 0.2)
# rad, m, rad: about what a good twin of the paper's fish errs by. The fit scales them all together;
# of a small fish the shaft thus counts more than the path.
ANGLE, POSITION, YAW = 0.03, 0.03, 0.07
FIRST = (0.3 * POSITION, 0.3 * POSITION, 0.4 * YAW)  # of the pose from which a path is compared


@dataclass(frozen=True, eq=False)
class Piece:
    """A piece of a swim: what the servo was sent, and its `angle` (k,) [rad] at every period;
    `pose` (m, 3) at `pose_time` (m,) [s] from the start; the first pose and its velocity in the
    pool [m/s, rad/s]; the shaft's first angle [rad] and speed [rad/s]."""

    command: Array
    angle: Array
    pose_time: Array
    pose: Array
    first: Array
    velocity: Array
    shaft: tuple[float, float]


def pieces(swims: Sequence[Logged]) -> list[Piece]:
    """Pieces without gaps, at most `MOST`, spread over all swims. Raises BadInput for too few."""
    found = [piece for one in swims for piece in _cut(one)]
    if len(found) < FEWEST:
        raise BadInput(
            f"{len(found)} pieces of {WARM + SPAN:g} s in which the camera saw the fish; give logs"
            f" with {FEWEST} or more: about {FEWEST * (WARM + SPAN):.0f} s of swimming."
        )
    kept = np.linspace(0, len(found) - 1, min(MOST, len(found))).round().astype(int)
    return [found[i] for i in kept]


def _cut(one: Logged) -> list[Piece]:
    fresh = np.r_[True, np.diff(one.pose_time) > 1e-4] & np.isfinite(one.pose).all(axis=1)
    when = one.pose_time[fresh]
    pose = np.column_stack([one.pose[fresh, :2], np.unwrap(one.pose[fresh, 2])])
    size, found = round((WARM + SPAN) / PERIOD), []
    for k in range(round(NEAR / PERIOD), len(one.time) - size, size):
        begin, end = one.time[k], one.time[k + size]
        near, held = np.abs(when - begin) < NEAR, (when >= begin) & (when <= end)
        edges = np.r_[begin, when[held], end]
        if near.sum() < 4 or np.diff(edges).max() > GAP or end - begin > (size + 1) * PERIOD:
            continue
        velocity, first = np.polyfit(when[near] - begin, pose[near], 1)
        own, shaft = slice(k, k + size + 1), (float(one.angle[k]), float(one.speed[k]))
        told = one.command[own], one.angle[own], when[held] - begin, pose[held]
        found.append(Piece(*told, first, velocity, shaft))
    return found


def repeat(
    fishes: Sequence[Fish], cut: Sequence[Piece], found: Sequence[Found]
) -> list[list[Swim]]:
    """Each fish swims every piece with what was `found` beside it; result[i][j] is fish i on
    piece j."""
    twins = [compile_twin(fish) for fish in fishes]
    step = twins[0].model.opt.timestep
    done = swim(
        [twin for twin in twins for _ in cut],
        [
            _start(twin.fish, one, own)
            for twin, own in zip(twins, found, strict=True)
            for one in cut
        ],
        [_sent(one, own["setpoint"], step) for own in found for one in cut],
        max(round(PERIOD / step), 1),
    )
    return [done[i * len(cut) : (i + 1) * len(cut)] for i in range(len(fishes))]


def _start(fish: Fish, piece: Piece, found: Found) -> Start:
    flow = [found["current x"], found["current y"], 0.0]
    angle, speed = piece.shaft
    first = root_pose(fish, piece.first)
    return Start(first, piece.velocity - flow, angle - found["encoder"], speed)


def _sent(piece: Piece, zero: float, step: float) -> Array:
    """Setpoints at every step: each is held until the next is sent."""
    steps = np.arange(round((len(piece.command) - 1) * PERIOD / step))
    return np.asarray(piece.command[(steps * step / PERIOD + 1e-9).astype(int)] - zero)


def errors(fish: Fish, piece: Piece, done: Swim, found: Found) -> tuple[Array, Array]:
    """Errors of the shaft (a,) [rad], and of the path (b, 3) [m, m, rad] from the pose that was
    recorded at `WARM`, the twin's turned onto it."""
    shaft = np.interp(SHAFT, done.time, done.qpos[:, done.twin.motor]) + found["encoder"]
    measured = np.interp(SHAFT, np.arange(len(piece.angle)) * PERIOD, piece.angle)
    track = tracked_pose(fish, done.qpos[:, :3])
    track[:, :2] += done.time[:, None] * [found["current x"], found["current y"]]
    seen = _seen(piece)
    own = np.column_stack([np.interp(PATH - found["late"], done.time, c) for c in track.T])
    turn = seen[0, 2] - own[0, 2]
    onto = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    there = seen[0, :2] + (own[:, :2] - own[0, :2]) @ onto
    return shaft - measured, np.column_stack([there, own[:, 2] + turn]) - seen


def _seen(piece: Piece) -> Array:
    """The recorded path (b, 3) at the times that are compared."""
    return np.column_stack([np.interp(PATH, piece.pose_time, c) for c in piece.pose.T])


def residuals(fish: Fish, piece: Piece, done: Swim, found: Found) -> Array:
    """The errors in about their deviations, (r,); of the path without what a small error of its
    first pose does. All infinite if the twin diverged."""
    with np.errstate(all="ignore"):
        shaft, path = errors(fish, piece, done, found)
        weight = np.ones_like(path) / [POSITION, POSITION, YAW]
        seen = _seen(piece)
        rest = without_first_pose((path * weight).ravel(), seen - seen[0], weight, FIRST)
        rows = np.concatenate([shaft / ANGLE, rest])
    return np.full_like(rows, np.inf) if done.diverged else rows
