"""What can be broken between servo and water, and in what the camera says; see `faults`."""

import math
from dataclasses import dataclass

DRIFT = (0.01, 0.0, 0.02)  # m/s, m/s, rad/s of a camera that drifts


@dataclass
class Broken:
    """Faults between servo and water: the tail bends to the other side (`reversed`); the tail gets
    a share of the shaft's angle (`slipping`); the shaft makes a share of its `stroke`."""

    reversed: bool = False
    slipping: float = 1.0
    stroke: float = 1.0


@dataclass
class TrackerFaults:
    """Faults of what the camera says: the picture is `mirrored`, or its places are at an x
    [m] and its headings stay right (`mirrored_at`); the same pose under fresh stamps
    (`frozen`); the target `jumping` [m]; the camera `drifting` since a time [s] by 1 cm/s and
    0.02 rad/s."""

    mirrored: bool = False
    mirrored_at: float = math.nan
    frozen: bool = False
    jumping: float = 0.0
    drifting: float = math.inf
    last: tuple[float, float, float] = (0.0, 0.0, 0.0)
