"""What a lab has put together wrong: constant errors of one robot that its policy does not know.

`World` applies them to commands and readings; rewards and arrivals use the true positions.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from tailbeat.control.actions import PERIOD
from tailbeat.env.sensors import SensorState
from tailbeat.files import BadInput

Array = NDArray[np.float64]
Rows = NDArray[np.void]
BURSTS = 1.0  # Hz, mean rate at which bursts of lost frames begin; chosen


@dataclass(frozen=True)
class Errors:
    """Errors of one robot, or the half widths from which they are drawn.

    World and fish frame as everywhere: ahead is towards the nose, left and turns counter-clockwise
    are positive. The shaft's angle is the servo's plus `horn`, for commands and readings;
    `encoder` is added to readings alone. The tag sits `ahead` and `left` of its described place,
    turned by `askew`. Camera positions, of fish and target, are (1 + `scale`) times the true ones,
    turned by `turn`; the lens moves a point at r from the pool's middle outwards by `lens` r^3.
    """

    horn: float = 0.0  # rad
    encoder: float = 0.0  # rad
    ahead: float = 0.0  # m
    left: float = 0.0  # m
    askew: float = 0.0  # rad
    scale: float = 0.0  # fraction
    turn: float = 0.0  # rad
    lens: float = 0.0  # 1/m^2
    yaw_rate_bias: float = 0.0  # rad/s
    yaw_rate_drift: float = 0.0  # rad/s, gained over an episode
    late: float = 0.0  # s, added to the camera's latency
    dark: float = 0.0  # s, length of each burst of lost frames


NAMES = tuple(field.name for field in fields(Errors))
ROW = np.dtype([(name, float) for name in NAMES])
ONE_SIDED = ("late", "dark")
LATEST = 0.15  # s: a quarter of a second of frames is kept, and the model's latency is in it
FRAME = ("scale", "turn", "lens")
NONE = Errors()


def check(errors: Errors) -> None:
    """Raises BadInput for a value that is not finite, a scale of -1 or less, a negative `late` or
    `dark`, or a `late` above `LATEST`."""
    for name in NAMES:
        value = float(getattr(errors, name))
        low = 0.0 if name in ONE_SIDED else -0.99 if name == "scale" else -np.inf
        high = LATEST if name == "late" else np.inf
        if not low <= value <= high or not np.isfinite(value):
            raise BadInput(f"errors: {name} = {value:g}; allowed is {low:g} to {high:g}.")


def check_widths(widths: Errors) -> None:
    """Check half widths for training. Raises BadInput for a negative one, or one of the camera's
    frame: relabelled targets are in the true frame."""
    check(widths)
    for name in NAMES:
        value = float(getattr(widths, name))
        if value < 0 or (value and name in FRAME):
            allowed = "0, because relabelled targets are in the true frame" if name in FRAME else ""
            raise BadInput(f"errors: {name} = {value:g}; allowed is {allowed or '0 or more'}.")


def draw(widths: Errors, rng: np.random.Generator) -> Errors:
    """One robot's errors: uniform within the widths, to both sides where a side has a meaning."""
    sides = {name: rng.uniform(0.0 if name in ONE_SIDED else -1.0, 1.0) for name in NAMES}
    return replace(widths, **{name: getattr(widths, name) * side for name, side in sides.items()})


def true_frame(wrong: Errors) -> Errors:
    """The same errors, but for those of the camera's frame."""
    return replace(wrong, **dict.fromkeys(FRAME, 0.0))


def rows(each: Sequence[Errors]) -> Rows:
    """Rows (n,) of `ROW`. Raises BadInput."""
    for errors in set(each):
        check(errors)
    return np.array([tuple(getattr(one, name) for name in NAMES) for one in each], ROW)


def filmed(wrong: Rows, pose: Array) -> Array:
    """Poses (n, 3) that a camera finds, from the true poses of the described tag."""
    x, y, yaw = pose.T
    cos, sin = np.cos(yaw), np.sin(yaw)
    ahead, left = wrong["ahead"], wrong["left"]
    tag = np.stack([x + cos * ahead - sin * left, y + sin * ahead + cos * left], axis=1)
    return np.column_stack([seen(wrong, tag), yaw + wrong["askew"] + wrong["turn"]])


def seen(wrong: Rows, place: Array) -> Array:
    """Positions (n, 2) that a camera finds, from true ones."""
    bent = (1 + wrong["scale"] + wrong["lens"] * (place**2).sum(axis=1))[:, None] * place
    cos, sin = np.cos(wrong["turn"]), np.sin(wrong["turn"])
    x, y = bent.T
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=1)


def begin(wrong: np.void, state: SensorState, fish: int, rng: np.random.Generator) -> None:
    """Put one fish's errors of IMU and camera into its sensors, after their own `begin`."""
    steps = state.noise.shape[1]
    state.bias[fish] += wrong["yaw_rate_bias"]
    state.drift[fish] += wrong["yaw_rate_drift"] / steps
    state.late[fish] = wrong["late"]
    state.dark[fish] = dark_steps(float(wrong["dark"]), steps, rng) if wrong["dark"] else False


def dark_steps(seconds: float, steps: int, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Control steps (steps,) whose frames are lost, in bursts of this length."""
    begins = rng.uniform(size=steps) < BURSTS * PERIOD
    found = np.zeros(steps, bool)
    for first in np.flatnonzero(begins):
        found[first : first + round(seconds / PERIOD)] = True
    return found
