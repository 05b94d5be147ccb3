"""What the policy sees: 24 numbers from raw sensor samples, one table for training and robot.

The observation is the paper's. The paper does not print the scales; they are chosen so that each
number is of order one. The table is the definition: `observe` fills it in its order, a test checks
each row against its sample, and the policy's contract holds it. A policy may see four more numbers
(ours), the filtered velocities of target and fish, and fourteen averages besides.
"""

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.control import motion
from tailbeat.control.measure import PAPER, Measure

Array = NDArray[np.float64]
FRAMES = 3  # most recent camera frames
COMMANDS = 3  # last commands


@dataclass(frozen=True)
class Entry:
    """One number of the observation: the raw number divided by `scale`."""

    name: str
    """What is observed."""
    unit: str
    """Unit of the raw number."""
    scale: float
    """Divisor of the raw number, in its unit."""
    source: str
    """Sensor that the raw number comes from."""


@dataclass(frozen=True)
class Samples:
    """Raw samples of n fish, newest first along the second axis.

    `motor_angle` [rad], `motor_velocity` [rad/s], `yaw_rate` [rad/s], `phase` [rad] (n,);
    `commands` (n, 3, 2) frequency [rad/s] and centre [rad]; `frames` (n, 3, 6) fish x, y [m], yaw
    [rad], target x, y [m] in the pool, staleness [s]: the time since the frame was taken. `motion`
    (n, 4) are the velocities of `motion.observed`, `averages` (n, 2, 7) those of
    `averages.update`; None for a policy that does not see them.
    """

    motor_angle: Array
    motor_velocity: Array
    yaw_rate: Array
    phase: Array
    commands: Array
    frames: Array
    motion: Array | None = None
    averages: Array | None = None


def _table() -> tuple[Entry, ...]:
    rows = [
        Entry("cos motor angle", "1", 1.0, "servo's encoder"),
        Entry("sin motor angle", "1", 1.0, "servo's encoder"),
        Entry("motor velocity", "rad/s", 5.0, "servo's encoder"),
        Entry("yaw rate", "rad/s", 2.0, "IMU"),
        Entry("cos phase", "1", 1.0, "generator"),
        Entry("sin phase", "1", 1.0, "generator"),
    ]
    for i in range(COMMANDS):
        age = f"command {i}" + (" (newest)" if i == 0 else "")
        rows += [
            Entry(f"{age}: frequency", "rad/s", 8 * np.pi, "generator"),
            Entry(f"{age}: centre", "rad", 1.0, "generator"),
        ]
    for i in range(FRAMES):
        age = f"frame {i}" + (" (newest)" if i == 0 else "")
        rows += [
            Entry(f"{age}: target distance", "m", 2.0, "camera"),
            Entry(f"{age}: target ahead", "m", 2.0, "camera"),
            Entry(f"{age}: target left", "m", 2.0, "camera"),
            Entry(f"{age}: staleness", "s", 0.1, "camera's time stamp and the robot's clock"),
        ]
    return tuple(rows)


TABLE = _table()  # of the paper's fish
VELOCITIES = tuple(
    Entry(name, "m/s", 0.5, "camera, filtered")
    for name in (
        "target's velocity ahead",
        "target's velocity left",
        "own velocity ahead",
        "own velocity left",
    )
)
FOLLOWING = TABLE + VELOCITIES  # of the paper's fish, for a policy that sees velocities
AVERAGED = (  # signals, and what their averages are divided by (chosen)
    Entry("yaw rate", "rad/s", 1.0, "IMU"),
    Entry("commanded centre", "rad", 0.5, "generator"),
    Entry("sine of the motor angle", "1", 0.5, "servo's encoder"),
    Entry("own velocity ahead", "m/s", 0.5, "camera, filtered"),
    Entry("own velocity left", "m/s", 0.5, "camera, filtered"),
    Entry("motor speed", "rad/s", 5.0, "servo's encoder"),
    Entry("lag of the motor angle", "rad", 0.3, "generator and servo's encoder"),
)
AVERAGES = tuple(
    replace(one, name=f"{one.name}, {span} average")
    for span in ("fast", "slow")
    for one in AVERAGED
)
REMEMBERING = FOLLOWING + AVERAGES  # of the paper's fish, for a policy that sees averages too
assert len(VELOCITIES) == motion.OBSERVED


def rows(velocities: bool, averages: bool) -> tuple[Entry, ...]:
    """The table of the paper's fish for a policy that sees velocities, and averages too."""
    return REMEMBERING if averages else FOLLOWING if velocities else TABLE


@cache
def table(
    measure: Measure, yaw_rate: str = "imu", velocities: bool = False, averages: bool = False
) -> tuple[Entry, ...]:
    """The table of a fish: distances are divided by its reach, yaw rates by its turning, velocities
    by its speed. `yaw_rate` is the source of the yaw rate, "imu" or "camera"; with `velocities` and
    `averages` (which need velocities) it has their rows too."""
    factors = {"m": measure.reach, "yaw rate": 1 / measure.time, "m/s": measure.speed}
    sources = {"yaw rate": "camera"} if yaw_rate == "camera" else {}
    found = []
    for one in rows(velocities, averages):
        signal = one.name.split(",")[0]
        scale = one.scale * factors.get(one.unit, factors.get(signal, 1.0))
        found.append(replace(one, scale=scale, source=sources.get(signal, one.source)))
    return tuple(found)


@cache
def scales(measure: Measure, velocities: bool = False, averages: bool = False) -> Array:
    """The table's scales (24,), (28,) with `velocities`, or (42,) with `averages` too; not to be
    written to."""
    return np.array([one.scale for one in table(measure, "imu", velocities, averages)])


def observe(samples: Samples, measure: Measure = PAPER) -> NDArray[np.float32]:
    """The observation (n, 24) of raw samples, in the table's order and divided by its scales; (n,
    28) if they have velocities, (n, 42) with averages too. Shapes and values are not checked."""
    count, kinds = len(samples.phase), (samples.motion is not None, samples.averages is not None)
    seen = np.empty((count, len(rows(*kinds))))
    seen[:, 0], seen[:, 1] = np.cos(samples.motor_angle), np.sin(samples.motor_angle)
    seen[:, 2], seen[:, 3] = samples.motor_velocity, samples.yaw_rate
    seen[:, 4], seen[:, 5] = np.cos(samples.phase), np.sin(samples.phase)
    seen[:, 6:12] = samples.commands.reshape(count, -1)
    seen[:, 12:24] = relative(samples.frames).reshape(count, -1)
    if samples.motion is not None:
        seen[:, 24:28] = samples.motion
    if samples.averages is not None:
        seen[:, 28:] = samples.averages.reshape(count, -1)
    return np.divide(
        seen, scales(measure, *kinds), out=np.empty(seen.shape, np.float32), casting="same_kind"
    )


def relative(frames: Array) -> Array:
    """Of frames (n, k, 6), see `Samples`: distance of the target, its distance ahead and to the
    left [m], staleness [s]: (n, k, 4)."""
    apart = frames[..., 3:5] - frames[..., :2]
    seen = np.empty((*apart.shape[:-1], 4))
    seen[..., 0] = np.hypot(apart[..., 0], apart[..., 1])
    seen[..., 1:3] = motion.ahead_and_left(apart, frames[..., 2])
    seen[..., 3] = frames[..., 5]
    return seen


def wrapped(angle: Any) -> Any:
    """Angles [rad], of any shape, from -pi up to pi."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


def bearing(pose: Any, place: Any) -> Any:
    """Bearings (n,) [rad] of places (n, 2) [m] seen from poses (n, 3) x, y, yaw [m, rad]. 0 is
    straight ahead, positive is to the left, from -pi up to pi."""
    offset = place - pose[:, :2]
    return wrapped(np.arctan2(offset[:, 1], offset[:, 0]) - pose[:, 2])


def as_markdown() -> str:
    """The table as the docs print it, with velocities and averages at its end."""
    lines = ["| # | observed | unit | divided by | from |", "|---|---|---|---|---|"]
    lines += [
        f"| {i} | {e.name} | {e.unit} | {e.scale:.4g} | {e.source} |"
        for i, e in enumerate(REMEMBERING)
    ]
    return "\n".join(lines)
