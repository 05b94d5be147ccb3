"""Track fish and target live: report what is seen, and summarise."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tailbeat.processes import told_to_end
from tailbeat.vision.calibration import OLDEST, read_calibration
from tailbeat.vision.camera import open_camera
from tailbeat.vision.tracking import TrackerProcess, start_tracker

Say = Callable[[str], None]
EVERY = 0.5  # s between two lines
STARTING = 20.0  # s that the tracker may take to start


@dataclass(frozen=True)
class TrackConfig:
    """A tracker: the camera, its calibration file of at most `oldest` days, the tags of fish and
    target, and the camera's `exposure` and `latency` [s]."""

    camera: str
    calibration: Path
    ids: tuple[int, int]
    exposure: float
    latency: float
    oldest: float = OLDEST


@dataclass(frozen=True)
class TrackSummary:
    """Summary of tracking.

    `seconds` since the first sighting; frames and their rate [Hz]; fractions of frames in which
    fish and target were seen; tags rejected by reason; restarts of the tracker; its last fault.
    """

    camera: str
    seconds: float
    frames: int
    rate_hz: float
    fish_seen: float
    target_seen: float
    rejected: dict[str, int]
    restarts: int
    fault: str


def watch(config: TrackConfig) -> TrackerProcess:
    """Start a tracker. Raises BadInput for a camera or a calibration that cannot be used."""
    made = read_calibration(config.calibration, config.oldest)
    # a camera that cannot be opened is refused here, once
    open_camera(config.camera, made.lens.size).close()
    return start_tracker(
        config.camera, made, config.ids, exposure=config.exposure, latency=config.latency
    )


def track(config: TrackConfig, seconds: float, say: Say) -> TrackSummary:
    """Track for `seconds` (0: until told to stop), report now and then, and summarise. Raises
    BadInput."""
    tracker = watch(config)
    ended = told_to_end()
    try:
        took = _follow(tracker, seconds, lambda: bool(ended), say)
    finally:
        tracker.close()
    return summary(tracker, config, took)


def _follow(tracker: Any, seconds: float, stop: Callable[[], bool], say: Say) -> float:
    """Report what is seen; returns the seconds from the first sighting to the end."""
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


def summary(tracker: Any, config: TrackConfig, took: float) -> TrackSummary:
    """Summarise tracking."""
    last = tracker.newest()
    frames = last.frames if last else 0
    seen = [(last.believed.get(ident, 0) / frames if frames else 0.0) for ident in config.ids]
    return TrackSummary(
        camera=config.camera,
        seconds=took,
        frames=frames,
        rate_hz=last.rate if last else 0.0,
        fish_seen=seen[0],
        target_seen=seen[1],
        rejected=last.rejected if last else {},
        restarts=tracker.restarts,
        fault=tracker.fault,
    )
