"""Check that the camera sees the fish: the doctor's checks of camera, light and tags."""

import time
from pathlib import Path

import numpy as np

from tailbeat.files import BadInput
from tailbeat.robot.findings import Finding, finding
from tailbeat.vision.calibration import Calibration, read_calibration
from tailbeat.vision.camera import CameraFault, Picture, open_camera
from tailbeat.vision.field_of_view import blind
from tailbeat.vision.tags import of_other_size
from tailbeat.vision.tracker import Sighting, Tracker

WATCHED = 120  # frames: two seconds
SLOW, SLOWEST = 50.0, 25.0  # frames per second: below, a warning, and a failed check
DARK, BRIGHT = 30.0, 0.05  # mean grey level, fraction of pixels that are white
SMALL = 14.0  # px, side of the smallest tag that was found in every rendered picture
SEEN = 0.9  # fraction of frames
WHITE = 250
OTHER_TAG = "size of the fish's tag"
DO = {
    "camera": "plug it in; end other programs that use it; v4l2-ctl --list-devices",
    "calibration": "tailbeat calibrate; see docs/how-to/calibrate-the-camera.md",
    "frames per second": "lock the exposure at 2 ms or less, use MJPG, end other programs",
    "exposure": "lock it so that white paper is below 250 of 255: v4l2-ctl -l; move the lamps",
    "fish's tag": "check its id; show it whole, flat, without glare; run tailbeat track",
    "target's tag": "show it whole in view; or drag a target on the operator page",
    "size of the tags": "hang the camera lower, or print them larger",
    OTHER_TAG: "print it with tailbeat tags --fish, and calibrate with the same --fish",
    "pool in view": "hang the camera higher or over the middle; a fish that swims there is lost",
}


def check_camera(
    camera: str, calibration: Path, ids: tuple[int, int], tag: float | None = None
) -> list[Finding]:
    """Check two seconds of frames with this calibration: rate, light, tags. `tag` is the side of
    the fish's tag [m] by its description."""
    try:
        made = read_calibration(calibration)
        found = [finding("calibration", f"of {made.made}, {1e3 * made.hung.rms:.1f} mm rms")]
        strips, name = blind(made), "pool in view"
        found.append(finding(name, strips or "all of it", warn=bool(strips), do=DO[name]))
        if other := of_other_size(made.fish, tag):
            found.append(finding(OTHER_TAG, other, bad=True, do=DO[OTHER_TAG]))
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
    """Check the tags of the fish (required) and of the target (which the operator may set
    instead)."""
    found = []
    for name, ident in zip(("fish's tag", "target's tag"), ids, strict=True):
        share = sighting.believed.get(ident, 0) / sighting.frames
        gone = share < SEEN
        said = f"id {ident} accepted in {100 * share:.0f} % of frames{_why(sighting, gone)}"
        fish = ident == ids[0]
        found.append(finding(name, said, bad=gone and fish, warn=gone and not fish, do=DO[name]))
    sides = [float(np.hypot(*(c[1] - c[0]))) for c in sighting.corners.values()]
    if sides:
        name, least = "size of the tags", min(sides)
        found.append(finding(name, f"{least:.0f} px a side", warn=least < SMALL, do=DO[name]))
    return found


def _why(sighting: Sighting, gone: bool) -> str:
    """What was rejected, if a tag is missing."""
    reasons = ", ".join(f"{why} {count}" for why, count in sighting.rejected.items())
    return f"; rejected: {reasons}" if gone and reasons else ""
