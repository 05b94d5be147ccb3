"""Track fish and target live: say what is seen, and sum up."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tailbeat.processes import told_to_end
from tailbeat.vision.calibration import OLDEST, read_calibration
from tailbeat.vision.camera import open_camera
from tailbeat.vision.tracking import TrackerProcess, start_tracker

Say = Callable[[str], None]
EVERY = 0.5  # s between two lines
STARTING = 20.0  # s that the tracker may take on top


def watch(
    camera: str,
    calibration: Path,
    ids: tuple[int, int],
    exposure: float,
    latency: float,
    oldest: float = OLDEST,
) -> TrackerProcess:
    """Start a tracker with a calibration file that is at most `oldest` days old. `ids` are those of
    fish and target, `exposure` and `latency` are the camera's [s]. Raises BadInput."""
    made = read_calibration(calibration, oldest)
    open_camera(camera, made.lens.size).close()  # refused here if it is none, not again and again
    return start_tracker(camera, made, ids, exposure=exposure, latency=latency)


def track(
    camera: str, calibration: Path, ids: tuple[int, int], seconds: float, oldest: float,
    exposure: float, latency: float, say: Say,
) -> dict[str, Any]:  # fmt: skip
    """Watch so long (0: until told to stop), say a line now and then, sum up."""
    tracker = watch(camera, calibration, ids, exposure, latency, oldest)
    ended = told_to_end()
    try:
        took = _follow(tracker, seconds, lambda: bool(ended), say)
    finally:
        tracker.close()
    return {"camera": camera, **summary(tracker, ids, took)}


def _follow(tracker: Any, seconds: float, stop: Callable[[], bool], say: Say) -> float:
    """Say what is seen; seconds from the first sighting to the end."""
    began, due, fault, first = time.monotonic(), 0.0, "", None
    while not stop():
        now = time.monotonic()
        sighting = tracker.newest()
        first = first or (now if sighting is not None else None)
        if tracker.fault != fault:
            fault = tracker.fault
            say(fault or "frames come again")
        if "the film is over" in fault or (
            seconds and now - (first or began + STARTING) >= seconds
        ):
            break
        if now >= due and sighting is not None and not fault:
            due = now + EVERY
            say(line(sighting))
        time.sleep(0.01)
    return time.monotonic() - (first or began)


def line(sighting: Any) -> str:
    """One sighting in words."""
    fish, target = sighting.frame.fish, sighting.frame.target
    swims = (
        f"{fish[0]:+.3f} {fish[1]:+.3f} m {np.degrees(fish[2]):+6.1f} deg" if fish else "not seen"
    )
    floats = f"{target[0]:+.3f} {target[1]:+.3f} m" if target else "not seen"
    rejects = ", ".join(f"{why} {count}" for why, count in sighting.rejected.items()) or "nothing"
    return f"fish {swims}; target {floats}; {sighting.rate:.1f} frames/s; rejected: {rejects}"


def summary(tracker: Any, ids: tuple[int, int], took: float) -> dict[str, Any]:
    """What a watch comes to."""
    last = tracker.newest()
    frames = last.frames if last else 0
    shares = [(last.believed.get(ident, 0) / frames if frames else 0.0) for ident in ids]
    return {
        "seconds": took,
        "frames": frames,
        "rate_hz": last.rate if last else 0.0,
        "fish_seen": shares[0],
        "target_seen": shares[1],
        "rejected": last.rejected if last else {},
        "restarts": tracker.restarts,
        "fault": tracker.fault,
    }
