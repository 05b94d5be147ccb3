"""What bands are about: speed, distance, heading and turn rate of a swim."""

import numpy as np
from numpy.typing import NDArray

from tailbeat.identify.gait import Track, way
from tailbeat.identify.predict import JUDGED
from tailbeat.identify.runs import Run

Array = NDArray[np.float64]
UNITS = {"speed": "m/s", "distance": "m", "heading": "deg", "turn_rate": "deg/s"}
AROUND = 0.1  # s before and after, over which a heading is averaged


def measure(track: Track, run: Run, speed: float) -> Array:
    """Speed, distance, heading and turn rate (4,) of a track over the time of `run`; of a cruise
    only the speed, without a heading only speed and distance."""
    found = np.full(len(UNITS), np.nan)
    found[0] = speed
    if run.motor is None:
        return found
    end = float(run.track.time[-1] - run.track.time[0])
    time = track.time - track.time[0]
    whole = track.cut(0, int(np.searchsorted(time, end, side="right")))
    found[1] = way(whole)
    if run.track.has_heading:
        at = min(JUDGED, end - AROUND)
        turned = _yaw(whole, at) - whole.pose[0, 2]
        later = _yaw(whole, end - AROUND) - _yaw(whole, end / 2)
        found[2:] = np.degrees([turned, later / (end / 2 - AROUND)])
    return found


def _yaw(track: Track, at: float) -> float:
    """Mean heading [rad] around a time since the start."""
    near = np.abs(track.time - track.time[0] - at) <= AROUND
    return float(track.pose[near, 2].mean())
