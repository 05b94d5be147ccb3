"""Accuracy and speed of vision: poses from rendered pictures compared with the truth.

Costs are CPU time of one core, so a busy machine has little effect. The delay from a frame's
exposure to its pose is measured with the real processes.
"""

import os
import signal
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from tailbeat.control.observation import wrapped
from tailbeat.emulators.board import board_views
from tailbeat.emulators.camera import Conditions, Renderer, Scene
from tailbeat.emulators.camera_process import CameraProcess, start_camera
from tailbeat.emulators.film import Filming
from tailbeat.emulators.optics import Optics, project
from tailbeat.emulators.scripted import MARGIN, ScriptedSwim, fish_line, placed, three
from tailbeat.link.places import LENGTH, WIDTH
from tailbeat.vision.calibration import Calibration
from tailbeat.vision.survey import Surveyed, fit_lens, hang
from tailbeat.vision.tags import Board, Tag
from tailbeat.vision.tracker import Sighting, Tracker
from tailbeat.vision.tracking import TrackerProcess, start_tracker

Array = NDArray[np.float64]
PLACES, FRAMES = 400, 300
RATE = 60.0
APART = 10.0  # s between scattered scenes: the tracker's memory is over
FISH = Tag(height=-0.03)
CORNER_NOISE = 0.1  # px rms of surveyed tags' middles


def calibrated(optics: Optics, fish: Tag = FISH, target: Tag | None = None) -> Calibration:
    """Calibrate as a lab does: twenty views of a board, nine tags surveyed at the fish's depth."""
    rng, board = np.random.default_rng(7), Board()
    lens = fit_lens(board_views(optics, board, 20, seed=7), board)
    known = np.array([[x, y, fish.height] for x in (-2.2, 0.0, 2.2) for y in (-1.0, 0.0, 1.0)])
    pixels = project(optics, known) + rng.normal(0, CORNER_NOISE, (len(known), 2))
    hung = hang(lens, [Surveyed(three(row)) for row in known], pixels)
    return Calibration(lens, hung, fish, target or Tag())


@dataclass(frozen=True, eq=False)
class Told:
    """Sightings and the truth, and CPU seconds per frame of drawing and of tracking."""

    sightings: list[Sighting]
    truth: Array  # (n, 3)
    targets: Array  # (n, 2)
    drawing: Array
    seeing: Array


@dataclass(frozen=True, kw_only=True)
class PoseErrors:
    """Errors of the fish's position [mm] and heading [deg], rms and largest, and of the target's
    position [mm]; fractions of frames in which they were seen."""

    position_rms_mm: float
    position_largest_mm: float
    heading_rms_deg: float
    heading_largest_deg: float
    target_rms_mm: float
    fish_seen: float
    target_seen: float


@dataclass(frozen=True, kw_only=True)
class Costs:
    """CPU time [ms] of drawing a picture, of searching a whole one and of searching a window, NaN
    where there was none; poses per second of one core."""

    draw_ms: float
    whole_ms: float
    window_ms: float
    poses_per_s_core: float


@dataclass(frozen=True, kw_only=True)
class VisionRow(PoseErrors, Costs):
    """Errors and costs under one condition of the pictures."""

    pictures: str


@dataclass(frozen=True)
class LiveRow:
    """Camera and tracker as processes: poses per second, delay from exposure to pose [ms], and time
    without poses after the tracker is killed [s]."""

    poses_per_s: float
    delay_ms_median: float
    delay_ms_p99: float
    blind_after_a_crash_s: float


def watch(renderer: Renderer, tracker: Tracker, scenes: Sequence[Scene], step: float) -> Told:
    """Draw scenes `step` [s] apart and track them; NaN where there is no tag."""
    nothing = (np.nan,) * 3
    sightings, costs = [], []
    for number, scene in enumerate(scenes):
        began = time.process_time()
        image = renderer.draw(scene, number * step)
        drawn = time.process_time()
        sightings.append(tracker.see(image, round(1e9 * number * step)))
        costs.append((drawn - began, time.process_time() - drawn))
    truth = np.array([scene.fish or nothing for scene in scenes])
    targets = np.array([(scene.target or nothing)[:2] for scene in scenes])
    return Told(sightings, truth, targets, *np.array(costs).T)


def errors(told: Told) -> PoseErrors:
    """Errors of the poses."""
    nothing = (np.nan,) * 3
    seen = np.array([one.frame.fish or nothing for one in told.sightings])
    aims = np.array([one.frame.target or nothing[:2] for one in told.sightings])
    off = 1e3 * np.linalg.norm(seen[:, :2] - told.truth[:, :2], axis=1)
    aside = 1e3 * np.linalg.norm(aims - told.targets, axis=1)
    turned = np.degrees(wrapped(seen[:, 2] - told.truth[:, 2]))
    return PoseErrors(
        position_rms_mm=_rms(off),
        position_largest_mm=float(np.nanmax(off)),
        heading_rms_deg=_rms(turned),
        heading_largest_deg=float(np.nanmax(np.abs(turned))),
        target_rms_mm=_rms(aside),
        fish_seen=float(np.isfinite(off).mean()),
        target_seen=float(np.isfinite(aside).mean()),
    )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.nanmean(np.square(values))))


CONDITIONS: dict[str, Callable[[], Conditions]] = {
    "usual": Conditions,
    "dim, noisy": lambda: Conditions(noise=5.0, blur=0.9, bits=6),
    "waves, glare": lambda: Conditions(slope=0.1, glare=160.0),
}


def scattered(count: int, line: Array | None, seed: int = 0) -> list[Scene]:
    """Scenes with fish and target anywhere in the pool, the fish swimming and turning."""
    rng = np.random.default_rng(seed)
    reach = np.array([LENGTH, WIDTH]) / 2 - MARGIN
    scenes = []
    for _ in range(count):
        fish, target = (np.append(reach * rng.uniform(-1, 1, 2), yaw)
                        for yaw in rng.uniform(-np.pi, np.pi, 2))  # fmt: skip
        speed = rng.normal(0, [0.3, 0.3, 2.0])
        scenes.append(Scene(three(fish), three(speed), placed(line, fish), three(target)))
    return scenes


def vision_bench(places: int = PLACES, frames: int = FRAMES) -> tuple[VisionRow, ...]:
    """Measure a row per condition: errors over the pool, and the cost of pictures and poses of a
    swim."""
    cv2.setNumThreads(1)
    optics, line, scripted = Optics(), fish_line(), ScriptedSwim()
    calibration = calibrated(optics)
    swim = [scripted.scene(number / RATE, line) for number in range(frames)]
    rows = []
    for name, made in CONDITIONS.items():
        apart = watch(Renderer(optics, made(), FISH), Tracker(calibration),
                      scattered(places, line), APART)  # fmt: skip
        told = watch(Renderer(optics, made(), FISH), Tracker(calibration), swim, 1 / RATE)
        rows.append(VisionRow(pictures=name, **vars(errors(apart)), **vars(_costs(told))))
    return tuple(rows)


def _costs(told: Told) -> Costs:
    whole = np.array([one.whole for one in told.sightings])
    return Costs(
        draw_ms=1e3 * float(np.median(told.drawing)),
        whole_ms=1e3 * float(np.median(told.seeing[whole])),
        window_ms=1e3 * float(np.median(told.seeing[~whole])) if (~whole).any() else np.nan,
        poses_per_s_core=float(len(told.seeing) / told.seeing.sum()),
    )


def live_bench(seconds: float = 5.0) -> LiveRow:
    """Measure camera and tracker as processes.

    Frames per second; the delay from the middle of an exposure to the pose in this process; the
    time without poses after the tracker is killed.
    """
    line, scripted, filming = fish_line(), ScriptedSwim(), Filming()
    calibration = calibrated(filming.optics)
    with tempfile.TemporaryDirectory(prefix="tailbeat-") as folder:
        camera = start_camera(Path(folder) / "camera", filming)
        tracker = start_tracker(camera.where, calibration)
        try:
            ages = _follow(camera, tracker, scripted, line, seconds)
            back = _revived(tracker)
        finally:
            tracker.close()
            camera.close()
    late = 1e3 * np.array(ages) if ages else np.array([np.nan])
    return LiveRow(
        poses_per_s=len(ages) / seconds,
        delay_ms_median=float(np.median(late)),
        delay_ms_p99=float(np.quantile(late, 0.99)),
        blind_after_a_crash_s=back,
    )


def _follow(
    camera: CameraProcess,
    tracker: TrackerProcess,
    scripted: ScriptedSwim,
    line: Array,
    seconds: float,
) -> list[float]:
    """Ages [s] of poses on arrival, from the first one on."""
    ages: list[float] = []
    stamp, end = -1, time.monotonic() + 60.0
    while time.monotonic() < end:
        camera.show(scripted.scene(time.monotonic() % scripted.seconds, line))
        sighting = tracker.after(stamp, 0.01)
        if sighting is None:
            continue
        if stamp < 0:
            end = time.monotonic() + seconds
        stamp = sighting.frame.captured
        ages.append((time.monotonic_ns() - stamp) / 1e9)
    return ages


def _revived(tracker: TrackerProcess) -> float:
    """Time [s] from the kill to the next pose; NaN if none comes within a minute."""
    assert tracker.pid is not None
    began = time.monotonic()
    os.kill(tracker.pid, signal.SIGKILL)
    killed = time.monotonic_ns() + 50_000_000  # later than poses of the killed process
    back = tracker.after(killed, 60.0)
    return time.monotonic() - began if back is not None else float("nan")
