"""What is constant and wrong on one robot, from its swims alone: tag, gyro, shaft's zero, current.

No twin is used, only symmetry: a fish that is built straight swims mirrored under mirrored
commands. So over many turns its sideways speed is odd in its turning, and what is left over is the
tag's angle. Within a beat its forward speed does not follow its turning, unless the tag sits beside
the midline. All of this is ours; tests/test_offsets.py counts how often the intervals hold.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from tailbeat.files import BadInput
from tailbeat.identify.swim_columns import MADE, STEP, Logged, beating

Array = NDArray[np.float64]
BLOCK = 500  # samples of a block of the bootstrap: 10 s, as long as eddies last
DRAWS = 200
SLOW = (40, 60, 90)  # samples over which a beat is averaged: each is tried
FAST = ((6, 50), (10, 50), (10, 80))  # samples: noise is averaged over the first, beats pass
FEWEST = 2  # blocks
USUAL = 15  # blocks of three swims of a minute, with which the widths in `KINDS` were set
ASTERN = 0.975  # share of draws in which a beat drives a tag back, beyond which it looks astern
SHORTEST = STEP * (BLOCK + 2 * max(SLOW))  # s of a stretch that is read
GAP = 0.25  # s without a pose: it is not bridged


@dataclass(frozen=True)
class Offset:
    """One number with its 95 % interval, in `unit`. `told`: the interval is narrow enough to act
    on; its half width must be below `enough`."""

    name: str
    unit: str
    value: float
    interval: tuple[float, float]
    enough: float
    what: str

    @property
    def told(self) -> bool:
        """Whether the swims tell it."""
        return self.interval[1] - self.interval[0] <= 2 * self.enough


@dataclass(frozen=True)
class Offsets:
    """What was found, over `seconds` of swimming in `runs` swims, and what no swim alone tells."""

    offsets: tuple[Offset, ...]
    seconds: float
    runs: int
    untold: tuple[str, ...]
    damage: tuple[str, ...] = ()
    """What the logs lack, a sentence each."""


# Name, unit, factor from SI, largest half width to act on, and by how much the bootstrap's interval
# is widened: blocks do not tell what a fish that is not built straight does to the symmetry. The
# factors make 95 % intervals hold in 30 made labs in open water, those of tag askew and current y
# in 180 within the paper's walls, those of shaft and command in 90 there whose tails are straight;
# other labs test them.
KINDS = (
    ("tag askew", "deg", 180 / np.pi, 2.0, 1.5, "the tag is turned by this, left positive"),
    ("tag sideways", "mm", 1e3, 12.0, 1.7, "the tag is this far left of the midline"),
    ("shaft at straight", "deg", 180 / np.pi, 4.0, 2.5, "angle of the shaft, going straight"),
    ("command at straight", "deg", 180 / np.pi, 4.0, 3.0, "command that holds it there"),
    (
        "gyro bias",
        "rad/s",
        1.0,
        0.03,
        1.0,
        "gyro minus the camera's turning, in these swims",
    ),
    ("gyro drift", "rad/s/min", 60.0, 0.05, 1.0, "change of that"),
    ("current x", "cm/s", 100.0, 2.0, 2.0, "steady current along the pool"),
    ("current y", "cm/s", 100.0, 2.0, 2.8, "steady current across the pool"),
)
UNTOLD = (
    "tag ahead: it cannot be told from where the fish turns about",
    "scale of the camera: it cannot be told from how fast the fish is",
    "slack, stiffness and servo: `identify logs` fits some of it, the test bench tells more",
)


def offsets(swims: Sequence[Logged]) -> Offsets:
    """Offsets of one robot from a few swims. Raises BadInput if they are too short."""
    pieces = [piece for swim in swims for piece in _pieces(swim)]
    seconds = STEP * sum(len(piece.time) for piece in pieces)
    blocks = sum((len(piece.time) - 2 * max(SLOW)) // BLOCK for piece in pieces)
    if blocks < FEWEST:
        raise BadInput(
            f"{math.floor(seconds)} s of swimming with poses, in stretches without a gap of"
            f" {SHORTEST:.0f} s or more; give"
            f" {STEP * (FEWEST * BLOCK + 2 * max(SLOW)):.0f} s or more without a gap, with turns to"
            f" both sides."
        )
    found = [_estimates(pieces, slow, *fast) for slow, fast in zip(SLOW, FAST, strict=True)]
    each = np.array([values for values, _ in found])
    each = _about(each[0], each)
    values, apart = np.mean(each, axis=0), np.var(each, axis=0)
    half = 2 * np.sqrt(np.mean([(_few(blocks) * s) ** 2 for _, s in found], axis=0) + apart)
    rows = tuple(
        Offset(name, unit, v * by, ((v - wide * h) * by, (v + wide * h) * by), enough, what)
        for (name, unit, by, enough, wide, what), v, h in zip(
            KINDS, values.tolist(), half.tolist(), strict=True
        )
    )
    return Offsets(rows, seconds, len(swims), UNTOLD)


def _about(middle: Array, values: Array) -> Array:
    """Rows of `KINDS` (n, 8) whose angle of the tag is within half a turn of the middle one's."""
    near = values.copy()
    near[:, 0] = middle[0] + np.remainder(values[:, 0] - middle[0] + np.pi, 2 * np.pi) - np.pi
    return near


def _few(blocks: int) -> float:
    """How much wider an interval by a bootstrap over so few blocks must be than over `USUAL` ones:
    Student's t, and the variance that a bootstrap misses."""
    reach = stats.t.ppf(0.975, np.array([blocks, USUAL]) - 1)
    lost = np.sqrt(np.array([blocks, USUAL]) / (np.array([blocks, USUAL]) - 1))
    few, usual = reach * lost
    return float(few / usual)


# ---- swims on a grid ----------------------------------------------------------------------------


def _pieces(swim: Logged) -> list[Logged]:
    """Parts of a swim without gaps, on a grid of `STEP`, each long enough for a block. The shaft
    and the gyro are taken at the poses' times."""
    fresh = np.r_[True, np.diff(swim.pose_time) > 1e-4] & np.isfinite(swim.pose).all(axis=1)
    at, pose = swim.pose_time[fresh], swim.pose[fresh]
    cuts = np.flatnonzero(np.diff(at) > GAP) + 1
    edges = [0, *cuts.tolist(), len(at)]
    found = []
    for first, last in pairwise(edges):
        if last - first < 2 or at[last - 1] - at[first] < SHORTEST:
            continue
        time = np.arange(at[first], at[last - 1], STEP)
        own = np.column_stack([pose[first:last, :2], np.unwrap(pose[first:last, 2])])
        poses = np.column_stack([np.interp(time, at[first:last], c) for c in own.T])
        signals = swim.yaw_rate, swim.angle, swim.speed, swim.command
        rest = (np.interp(time, swim.time, c) for c in signals)
        found.append(Logged(time - swim.time[0], time, poses, *rest))
    return found


# ---- least squares by blocks --------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Normal:
    """Normal equations of a fit, a block of time each: (b, p, p), and (b, p) or, with r right
    sides, (b, p, r)."""

    matrix: Array
    right: Array

    def solved(self, drawn: NDArray[np.int64]) -> Array:
        """Coefficients (p,) or (p, r) over the drawn blocks."""
        matrix, right = self.matrix[drawn].sum(axis=0), self.right[drawn].sum(axis=0)
        return np.asarray(np.linalg.lstsq(matrix, right, rcond=None)[0])


def _normal(pieces: Sequence[tuple[list[Array], Array]]) -> Normal:
    """Normal equations of columns and their sum, in blocks."""
    matrices, rights = [], []
    for columns, right in pieces:
        a = np.column_stack(columns)
        for k in range(len(right) // BLOCK):
            own = slice(k * BLOCK, (k + 1) * BLOCK)
            matrices.append(a[own].T @ a[own])
            rights.append(a[own].T @ right[own])
    return Normal(np.array(matrices), np.array(rights))


def _estimates(pieces: Sequence[Logged], slow: int, noise: int, beat: int) -> tuple[Array, Array]:
    """Values of `KINDS` in SI, and their deviations by a bootstrap over blocks."""
    edge = max(SLOW)
    fits = [_normal([make(one, slow, noise, beat, edge) for one in pieces]) for make in MADE]
    speed = float(np.mean(np.concatenate([beating(one, slow)[edge:-edge] for one in pieces])))
    blocks, rng = len(fits[0].right), np.random.default_rng(0)
    drawn = [rng.integers(blocks, size=blocks) for _ in range(DRAWS)]
    solved = [[fit.solved(some) for fit in fits] for some in drawn]
    sense = -1.0 if np.mean([ahead[0] < 0 for _, ahead, *_ in solved]) > ASTERN else 1.0
    draws = np.array([_values(some, speed, sense) for some in solved])
    values = _values([fit.solved(np.arange(blocks)) for fit in fits], speed, sense)
    return values, np.std(_about(values, draws), axis=0)


def _values(fits: Sequence[Array], speed: float, sense: float) -> Array:
    """The numbers of `KINDS` from the coefficients of `MADE` and the shaft's mean beating speed;
    `sense` is -1 under a tag that looks astern."""
    lateral, _, within, shaft, setpoint, gyro = fits
    askew = math.atan2(-lateral[0] * sense, sense)
    forward, crossed = within[0]
    sideways = -(math.cos(askew) * forward - math.sin(askew) * crossed)
    straight = -(shaft[2] + shaft[3] * speed) / (shaft[0] + shaft[1] * speed)
    sent = setpoint[0] + setpoint[1] * straight
    return np.array([askew, sideways, straight, sent, gyro[0], gyro[1], lateral[4], lateral[5]])
