"""What is constant and wrong on one robot, from its swims alone: tag, gyro, shaft's zero, current.

No twin is used, only symmetry: a fish that is built straight swims mirrored under mirrored
commands. So over many turns its sideways speed is odd in its turning, and what is left over is the
tag's angle. Within a beat its forward speed does not follow its turning, unless the tag sits beside
the midline. All of this is ours; tests/test_offsets.py counts how often the intervals hold.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from tailbeat.files import BadInput

Array = NDArray[np.float64]
STEP = 0.02  # s, of the grid that swims are put on
BLOCK = 500  # samples of a block of the bootstrap: 10 s, as long as eddies last
DRAWS = 200
SLOW = (40, 60, 90)  # samples over which a beat is averaged: each is tried
FAST = ((6, 50), (10, 50), (10, 80))  # samples: noise is averaged over the first, beats pass
FEWEST = 2  # blocks
USUAL = 15  # blocks of three swims of a minute, with which the widths in `KINDS` were set
GAP = 0.25  # s without a pose: it is not bridged


@dataclass(frozen=True, eq=False)
class Logged:
    """A swim of k samples as a robot logged it.

    `time` [s] of the samples and `pose_time` of the newest pose at each; `pose` (k, 3): x, y [m]
    and heading [rad] in the pool; `yaw_rate` [rad/s] of the gyro; `angle` [rad] and `speed` [rad/s]
    of the shaft, as it counts them, and its `command` [rad].
    """

    time: Array
    pose_time: Array
    pose: Array
    yaw_rate: Array
    angle: Array
    speed: Array
    command: Array


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


# Name, unit, factor from SI, largest half width to act on, and by how much the bootstrap's interval
# is widened: blocks do not tell what a fish that is not built straight does to the symmetry. The
# factors make 95 % intervals hold in 30 made labs; other labs test them.
KINDS = (
    ("tag askew", "deg", 180 / np.pi, 2.0, 1.2, "the tag is turned by this, left positive"),
    ("tag sideways", "mm", 1e3, 12.0, 1.7, "the tag is this far left of the midline"),
    ("shaft at straight", "deg", 180 / np.pi, 4.0, 1.3, "mean angle of the shaft, going straight"),
    ("command at straight", "deg", 180 / np.pi, 4.0, 1.3, "mean command, going straight"),
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
    ("current y", "cm/s", 100.0, 2.0, 2.0, "steady current across the pool"),
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
            f"{seconds:.0f} s of swimming with poses; give"
            f" {STEP * (FEWEST * BLOCK + 2 * max(SLOW)):.0f} s or more without a gap, with turns to"
            f" both sides."
        )
    found = [_estimates(pieces, slow, *fast) for slow, fast in zip(SLOW, FAST, strict=True)]
    values = np.mean([values for values, _ in found], axis=0)
    apart = np.var([values for values, _ in found], axis=0)
    half = 2 * np.sqrt(np.mean([(_few(blocks) * s) ** 2 for _, s in found], axis=0) + apart)
    rows = tuple(
        Offset(name, unit, v * by, ((v - wide * h) * by, (v + wide * h) * by), enough, what)
        for (name, unit, by, enough, wide, what), v, h in zip(
            KINDS, values.tolist(), half.tolist(), strict=True
        )
    )
    return Offsets(rows, seconds, len(swims), UNTOLD)


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
        if last - first < 2 or at[last - 1] - at[first] < STEP * (BLOCK + 2 * max(SLOW)):
            continue
        time = np.arange(at[first], at[last - 1], STEP)
        own = np.column_stack([pose[first:last, :2], np.unwrap(pose[first:last, 2])])
        poses = np.column_stack([np.interp(time, at[first:last], c) for c in own.T])
        signals = swim.yaw_rate, swim.angle, swim.speed, swim.command
        rest = (np.interp(time, swim.time, c) for c in signals)
        found.append(Logged(time - swim.time[0], time, poses, *rest))
    return found


def _smooth(values: Array, width: int) -> Array:
    """Mean over a Hann window of so many samples."""
    window = np.hanning(width + 2)[1:-1]
    return np.convolve(values, window / window.sum(), mode="same")


def _motion(piece: Logged, width: int) -> tuple[Array, Array, Array]:
    """Speeds forward and left in the tag's own frame, and turning, after noise is averaged over
    `width` samples."""
    x, y, yaw = (_smooth(c, width) for c in piece.pose.T)
    vx, vy, turning = (np.gradient(c, STEP) for c in (x, y, yaw))
    cos, sin = np.cos(yaw), np.sin(yaw)
    return cos * vx + sin * vy, cos * vy - sin * vx, turning


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
    speed = float(np.mean(np.concatenate([_beating(one, slow)[edge:-edge] for one in pieces])))
    blocks, rng = len(fits[0].right), np.random.default_rng(0)
    drawn = [rng.integers(blocks, size=blocks) for _ in range(DRAWS)]
    draws = [_values([fit.solved(some) for fit in fits], speed) for some in drawn]
    return _values([fit.solved(np.arange(blocks)) for fit in fits], speed), np.std(draws, axis=0)


def _values(fits: Sequence[Array], speed: float) -> Array:
    """The numbers of `KINDS` from the coefficients of `MADE`."""
    lateral, within, shaft, setpoint, gyro = fits
    askew = -lateral[0]
    forward, crossed = within[0]
    sideways = -(forward - askew * crossed)
    straight = [-(c[2] + c[3] * speed) / (c[0] + c[1] * speed) for c in (shaft, setpoint)]
    return np.array([askew, sideways, *straight, gyro[0], gyro[1], lateral[4], lateral[5]])


Columns = tuple[list[Array], Array]


def _lateral(one: Logged, slow: int, noise: int, beat: int, edge: int) -> Columns:
    """Sideways speed over a beat: of the tag's angle, of turning, of the current."""
    ahead, left, turning = _averaged(one, slow)
    cos, sin = (_smooth(f(one.pose[:, 2]), slow) for f in (np.cos, np.sin))
    columns = [ahead, turning, turning * np.abs(turning), turning * ahead, -sin, cos]
    return [c[edge:-edge] for c in columns], left[edge:-edge]


def _averaged(one: Logged, slow: int) -> tuple[Array, Array, Array]:
    """Speeds in the tag's own frame and turning, over a beat."""
    yaw = one.pose[:, 2]
    vx, vy = (np.gradient(c, STEP) for c in one.pose[:, :2].T)
    ahead, left = np.cos(yaw) * vx + np.sin(yaw) * vy, np.cos(yaw) * vy - np.sin(yaw) * vx
    return _smooth(ahead, slow), _smooth(left, slow), np.gradient(_smooth(yaw, slow), STEP)


def _within(one: Logged, slow: int, noise: int, beat: int, edge: int) -> Columns:
    """Speeds forward and sideways within a beat, two right sides: of a tag beside the midline, of a
    turn. Of the sideways speed, a turned tag shows a part ahead."""
    ahead, left, turning = _motion(one, noise)
    over = [_smooth(c, beat) for c in (ahead, left, turning)]
    ahead, left, turning = ahead - over[0], left - over[1], turning - over[2]
    columns = [turning, turning * over[2], left * over[2]]
    return [c[edge:-edge] for c in columns], np.column_stack([ahead, left])[edge:-edge]


def _beating(one: Logged, slow: int) -> Array:
    """Rms speed of the shaft over a beat."""
    return np.sqrt(np.maximum(_smooth(one.speed**2, slow), 0.0))


def _shaft(one: Logged, slow: int, noise: int, beat: int, edge: int) -> Columns:
    """Turning over a beat: of the shaft's mean angle, the more the faster it beats."""
    return _turning(one, one.angle, slow, edge)


def _setpoint(one: Logged, slow: int, noise: int, beat: int, edge: int) -> Columns:
    """The same of the mean command: a wrong encoder does not change it."""
    return _turning(one, one.command, slow, edge)


def _turning(one: Logged, angle: Array, slow: int, edge: int) -> Columns:
    """Turning over a beat: of a mean angle, the more the faster the shaft beats."""
    mean, beating = _smooth(angle, slow), _beating(one, slow)
    turning = np.gradient(_smooth(one.pose[:, 2], slow), STEP)
    columns = [mean, mean * beating, np.ones_like(mean), beating]
    return [c[edge:-edge] for c in columns], turning[edge:-edge]


def _gyro(one: Logged, slow: int, noise: int, beat: int, edge: int) -> Columns:
    """Gyro minus the camera's turning, over time from 30 s on: so the first is its mean."""
    turning = np.gradient(_smooth(one.pose[:, 2], slow), STEP)
    off = _smooth(one.yaw_rate, slow) - turning
    columns = [np.ones_like(off), one.time - 30.0]
    return [c[edge:-edge] for c in columns], off[edge:-edge]


MADE = (_lateral, _within, _shaft, _setpoint, _gyro)
