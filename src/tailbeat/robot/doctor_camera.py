"""What keeps the camera from seeing the fish: the doctor's questions above the pool."""

import time
from pathlib import Path

import numpy as np

from tailbeat.files import BadInput
from tailbeat.robot.findings import Finding, finding
from tailbeat.vision.calibration import Calibration, read_calibration
from tailbeat.vision.camera import CameraFault, Picture, open_camera
from tailbeat.vision.tracker import Sighting, Tracker

WATCHED = 120  # frames: two seconds
SLOW, SLOWEST = 50.0, 25.0  # frames per second: below, it may swim badly, or not at all
DARK, BRIGHT = 30.0, 0.05  # mean grey level, share of pixels that are white
SMALL = 14.0  # px of a tag's side: the least that were found in every rendered picture
SEEN = 0.9  # share of frames
WHITE = 250
DO = {
    "camera": "plug it in; end what else uses it; v4l2-ctl --list-devices",
    "calibration": "tailbeat calibrate; docs/how-to/calibrate-the-camera.md says how",
    "frames per second": "exposure locked, 2 ms or less? MJPG? nothing else on the station?",
    "exposure": "lock it so that white is not quite white: v4l2-ctl -l; move lamps that shine back",
    "fish's tag": "its own id, whole, flat and without glare in view; tailbeat track says why not",
    "target's tag": "float it, whole and in view; or drag a target on the page",
    "size of the tags": "hang the camera lower, or print them larger",
}


def check_camera(camera: str, calibration: Path, ids: tuple[int, int]) -> list[Finding]:
    """Two seconds of frames: rate, light, tags, through the calibration that will be used."""
    try:
        made = read_calibration(calibration)
        found = [finding("calibration", f"of {made.made}, {1e3 * made.hung.rms:.1f} mm rms")]
    except BadInput as error:
        return [finding("calibration", str(error), bad=True, do=DO["calibration"])]
    try:
        return [*found, *_watch(camera, made, ids)]
    except (BadInput, CameraFault) as error:
        return [*found, finding("camera", str(error), bad=True, do=DO["camera"])]


def _watch(camera: str, made: Calibration, ids: tuple[int, int]) -> list[Finding]:
    opened, tracker = open_camera(camera, made.lens.size), Tracker(made, ids)
    try:
        image, stamp = opened.read()
        began = time.monotonic()
        for _ in range(WATCHED):
            sighting = tracker.see(image, stamp)
            image, stamp = opened.read()
        rate = WATCHED / (time.monotonic() - began)
    finally:
        opened.close()
    return [
        finding("camera", f"{camera}, {image.shape[1]} x {image.shape[0]}"),
        *_rate_and_light(rate, image),
        *_tags(sighting, ids),
    ]


def _rate_and_light(rate: float, image: Picture) -> list[Finding]:
    name, white = "frames per second", float(np.mean(image >= WHITE))
    return [
        finding(name, f"{rate:.0f}", bad=rate < SLOWEST, warn=rate < SLOW, do=DO[name]),
        finding(
            "exposure",
            f"mean {image.mean():.0f} of 255, {100 * white:.1f} % white",
            warn=image.mean() < DARK or white > BRIGHT,
            do=DO["exposure"],
        ),
    ]


def _tags(sighting: Sighting, ids: tuple[int, int]) -> list[Finding]:
    """Of fish (without it nothing swims) and target (which may be a dragged one)."""
    found = []
    for name, ident in zip(("fish's tag", "target's tag"), ids, strict=True):
        share = sighting.believed.get(ident, 0) / sighting.frames
        gone = share < SEEN
        said = f"id {ident} believed in {100 * share:.0f} % of frames{_why(sighting, gone)}"
        fish = ident == ids[0]
        found.append(finding(name, said, bad=gone and fish, warn=gone and not fish, do=DO[name]))
    sides = [float(np.hypot(*(c[1] - c[0]))) for c in sighting.corners.values()]
    if sides:
        name, least = "size of the tags", min(sides)
        found.append(finding(name, f"{least:.0f} px a side", warn=least < SMALL, do=DO[name]))
    return found


def _why(sighting: Sighting, gone: bool) -> str:
    """What was refused, where something is missing."""
    reasons = ", ".join(f"{why} {count}" for why, count in sighting.rejected.items())
    return f"; refused: {reasons}" if gone and reasons else ""
