"""The tracker on rendered pictures: poses against the truth, and what it must not believe."""

import math
import os
import re
import signal
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("cv2", reason="the robot extra is not installed")
pytest.importorskip("pyapriltags", reason="the robot extra is not installed")

import cv2

from camera_views import FISH, TARGET, true_calibration
from support import until
from tailbeat.benchmarks.vision import APART, calibrated, errors, scattered, watch
from tailbeat.emulators.camera import Conditions, Renderer, Scene, calm
from tailbeat.emulators.camera_process import CameraProcess, start_camera
from tailbeat.emulators.film import Filming
from tailbeat.emulators.live import ASIDE
from tailbeat.emulators.optics import Optics
from tailbeat.emulators.scripted import fish_line
from tailbeat.files import BadInput
from tailbeat.link.places import POOL
from tailbeat.vision.detector import HALF, open_detector
from tailbeat.vision.moved import warning
from tailbeat.vision.tags import Tag
from tailbeat.vision.tracker import Sighting, Tracker, TrackerLimits, misshapen, planar_pose
from tailbeat.vision.tracking import TrackerProcess, preview, start_tracker

pytestmark = pytest.mark.realtime

FRAME = 1 / 60
POSE, AIM = (0.6, -0.4, 0.7), (-1.0, 0.5, 2.0)


def film(
    tracker: Tracker, renderer: Renderer, scenes: list[Scene], first: int = 0
) -> list[Sighting]:
    """Scenes a sixtieth of a second apart, from frame `first` on."""
    return [
        tracker.see(renderer.draw(scene, k * FRAME), round(1e9 * k * FRAME))
        for k, scene in enumerate(scenes, first)
    ]


@pytest.fixture
def tracker() -> Tracker:
    return Tracker(true_calibration())


@pytest.fixture
def renderer() -> Renderer:
    return Renderer(fish=FISH, target=TARGET)


def test_poses_over_the_whole_pool_are_within_five_millimetres_and_a_degree():
    """Lens, refraction, waves, glare, blur, noise, motion; a calibration made as a lab makes it."""
    optics, line = Optics(), fish_line()
    told = watch(Renderer(optics, Conditions(), FISH), Tracker(calibrated(optics)),
                 scattered(80, line, seed=3), APART)  # fmt: skip
    found = errors(told)
    assert found.position_rms_mm < 2.0 and found.target_rms_mm < 2.0  # asked: 5
    assert found.heading_rms_deg < 0.5  # asked: 1
    assert found.fish_seen > 0.95 and found.target_seen > 0.95


def test_a_tag_in_the_corner_is_seen_and_one_afloat_hides_the_fish_beneath(tracker, renderer):
    """Why `tailbeat swim` lays the target's tag aside; docs/how-to/drive.md."""
    x, y = (share * side / 2 for share, side in zip(ASIDE, POOL, strict=True))
    away = film(tracker, renderer, [Scene(fish=(1.5, 0.5, 0.7), target=(x, y, 0.0))] * 20)
    above = film(tracker, renderer, [Scene(fish=(1.5, 0.5, 0.7), target=(1.5, 0.5, 0.0))] * 20, 90)
    assert all(one.frame.fish and one.frame.target for one in away[1:])
    assert not any(one.frame.fish for one in above)


def test_real_photographs_give_the_library_s_own_corners(data: Path):
    """Photos of a robot contest with the reference detector's corners: every tag is found with the
    threshold raised, and no half pixel is lost."""
    detector, off = open_detector(), []
    for path in sorted((data / "apriltag").glob("*.jpg")):
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        found = detector.find(np.asarray(image, np.uint8))
        for line in path.with_suffix(".txt").read_text().splitlines():
            ident, *numbers = map(float, re.findall(r"-?[\d.]+", line))
            corners = np.reshape(numbers, (4, 2)) - HALF
            ours = [one.corners - corners for one in found if one.ident == ident]
            off.append(min(ours, key=lambda one: float(np.abs(one).max())))
    assert len(off) == 22
    assert np.median(np.abs(off)) < 0.3 and np.abs(np.mean(off, axis=(0, 1))).max() < 0.15  # px


def test_the_yaw_is_the_arrow_s_and_runs_counter_clockwise_from_above(tracker):
    renderer = Renderer(conditions=calm(), fish=FISH, target=TARGET)
    for k, yaw in enumerate(np.arange(-3, 3.1, 0.75)):
        pose = (0.5, -0.5, float(yaw))
        (seen,) = film(tracker, renderer, [Scene(pose, target=AIM)], 600 * k)
        assert seen.frame.fish == pytest.approx(pose, abs=0.004)
        assert seen.frame.target == pytest.approx(AIM[:2], abs=0.002)


def test_windows_follow_a_fish_and_see_what_a_full_search_sees(tracker, renderer):
    scenes = [Scene((-1 + 0.01 * k, 0.3, 0.3 * math.sin(0.2 * k)), target=AIM) for k in range(40)]
    seen = film(tracker, renderer, scenes)
    assert [one.whole for one in seen].count(True) == 2  # the first, and the thirtieth
    for one, scene in zip(seen, scenes, strict=True):
        assert one.frame.fish == pytest.approx(scene.fish, abs=0.02)
    assert seen[-1].rate == pytest.approx(60, rel=1e-6) and seen[-1].rejected == {}
    assert set(seen[-1].corners) == {0, 1}


def test_an_empty_pool_shows_nothing(tracker, renderer):
    (seen,) = film(tracker, renderer, [Scene()])
    assert seen.frame.fish is None and seen.frame.target is None
    assert seen.rejected == {} and seen.corners == {}


def test_a_second_print_of_the_fish_s_tag_takes_both_from_view_until_one_is_left(tracker, renderer):
    alone, two = Scene(POSE, target=AIM), Scene(POSE, target=AIM, others=((0, (-1.5, -0.8, 0.0)),))
    assert film(tracker, renderer, [alone])[0].frame.fish is not None
    seen = film(tracker, renderer, [two] * 40, 1)
    assert seen[-1].frame.fish is None and seen[-1].rejected["seen twice"] >= 2
    assert all(one.frame.fish is None for one in seen[31:])  # noticed at the second full search
    assert all(one.frame.target is not None for one in seen)
    again = film(tracker, renderer, [alone] * 4, 41)
    assert again[-1].frame.fish is not None


def test_a_mirrored_tag_and_a_mirrored_picture_are_never_believed(tracker, renderer):
    seen = film(tracker, renderer, [Scene(POSE, target=AIM, mirrored=True)] * 3)
    assert all(one.frame.fish is None and one.frame.target is not None for one in seen)
    image = renderer.draw(Scene(POSE, target=AIM), 0.0)
    for flipped in (image[:, ::-1], image[::-1]):
        frame = Tracker(true_calibration()).see(flipped, 0).frame
        assert frame.fish is None and frame.target is None
    square = np.array([[0, 0], [0.08, 0], [0.08, 0.08], [0, 0.08]])
    assert misshapen(square, 0.08, TrackerLimits()) == ""
    assert misshapen(square[::-1], 0.08, TrackerLimits()) == "mirrored"


def test_a_tag_that_turns_over_is_not_believed_for_a_second(tracker, renderer):
    over = (POSE[0], POSE[1], POSE[2] - math.pi)
    film(tracker, renderer, [Scene(POSE, target=AIM)] * 3)
    seen = film(tracker, renderer, [Scene(over, target=AIM)] * 60, 3)
    assert all(one.frame.fish is None for one in seen[:58])
    assert seen[-1].rejected["turned too fast"] > 20
    later = film(tracker, renderer, [Scene(over, target=AIM)] * 4, 70)
    assert later[-1].frame.fish == pytest.approx(over, abs=0.02)


def test_a_tag_that_jumps_is_not_believed_and_one_that_comes_back_is(tracker, renderer):
    there = Scene((POSE[0] + 0.3, *POSE[1:]), target=AIM)
    film(tracker, renderer, [Scene(POSE, target=AIM)])
    tracker.scanned = -(10**18)  # search all of it
    (seen,) = film(tracker, renderer, [there], 1)
    assert seen.frame.fish is None and seen.rejected == {"jumped": 1}
    back = film(tracker, renderer, [Scene(POSE, target=AIM)] * 4, 2)
    assert back[-1].frame.fish is not None


@pytest.mark.parametrize("pixel", [(2.0, 300.0), (1277.0, 300.0), (640.0, 1.0), (8.0, 300.0)])
def test_a_tag_half_out_of_view_is_not_believed(tracker, pixel):
    """The last one lies inside, but a corner of it does not."""
    optics = Optics(focal=900.0)  # this one does not see the whole pool
    calibration = true_calibration(optics)
    x, y = calibration.places(np.array([pixel]), FISH.height)[0]
    renderer = Renderer(optics, calm(), FISH, TARGET)
    seen = film(Tracker(calibration), renderer, [Scene((x, y, k), target=AIM) for k in range(4)])
    assert all(one.frame.fish is None for one in seen)
    assert all(one.frame.target is not None for one in seen)


def test_a_tag_that_touches_the_picture_s_edge_is_not_believed(tracker):
    """It decodes, but a corner there may be wrong."""
    x, y = tracker.calibration.places(np.array([[10.0, 300.0]]), FISH.height)[0]
    renderer = Renderer(conditions=calm(), fish=FISH, target=TARGET)
    (seen,) = film(tracker, renderer, [Scene((x, y, 0.0), target=AIM)])
    assert seen.frame.fish is None and seen.rejected == {"at the edge": 1}


def test_a_hidden_tag_is_missed_and_found_again(tracker, renderer):
    hidden = Renderer(conditions=Conditions(hidden=1.0), fish=FISH, target=TARGET)
    scenes = [Scene(POSE, target=AIM)] * 3
    film(tracker, renderer, scenes)
    assert film(tracker, hidden, scenes, 3)[-1].frame.fish is None
    assert film(tracker, renderer, scenes, 6)[-1].frame.fish is not None


def test_strangers_and_prints_of_another_size_are_counted_and_dropped(tracker):
    other = Renderer(fish=FISH, target=TARGET, ids=(5, 1))
    (seen,) = film(tracker, other, [Scene(POSE, target=AIM)])
    assert seen.frame.fish is None and seen.rejected == {"unexpected tag": 1}
    large = Renderer(fish=Tag(0.12, -0.03), target=TARGET)
    (seen,) = film(Tracker(true_calibration()), large, [Scene(POSE, target=AIM)])
    assert seen.frame.fish is None and seen.rejected == {"another size": 1}


def test_a_camera_mode_or_ids_that_do_not_fit_are_refused(tracker):
    with pytest.raises(BadInput, match="640 x 480 pixels, but the calibration is for 1280 x 720"):
        tracker.see(np.zeros((480, 640), np.uint8), 0)
    with pytest.raises(BadInput, match="give two different ones"):
        Tracker(true_calibration(), ids=(3, 3))
    surveyed = replace(true_calibration(), fixed={1: (0.0, 0.0, 0.0), 12: (1.0, 0.0, 0.0)})
    for make in (lambda: Tracker(surveyed), lambda: start_tracker("unix:/none", surveyed)):
        with pytest.raises(BadInput, match="tag 1 is one of those surveyed in the pool"):
            make()


def test_a_pose_is_the_corners_middle_and_lower_edge():
    corners = np.array([[1.0, 2.0], [1.08, 2.0], [1.08, 2.08], [1.0, 2.08]])
    assert planar_pose(corners) == pytest.approx((1.04, 2.04, 0.0))
    assert planar_pose(np.roll(corners, -1, axis=0))[2] == pytest.approx(math.pi / 2)
    bent = replace(TrackerLimits(), size=1.0)
    corners[2] += 0.04
    assert misshapen(corners, 0.08, bent) == "no square"


# ---- in a process of its own --------------------------------------------------------------------


@pytest.mark.parametrize(("x", "y"), [(700, 300), (3, 715)])  # px; the second in a corner
def test_the_page_s_picture_shows_the_fish_close_up_above_the_whole_pool(x, y):
    image = np.full((720, 1280), 40, np.uint8)
    image[max(y - 4, 0) : y + 5, max(x - 4, 0) : x + 5] = 250
    both = cv2.imdecode(np.frombuffer(preview(image, np.array([x, y])), np.uint8), 0)
    assert both is not None
    close, whole = both[:360], both[360:]
    assert close.shape == whole.shape == (360, 640) and whole[y // 2, x // 2] > 150
    bright = np.argwhere(close > 150)
    if x == 700:
        assert bright.mean(axis=0) == pytest.approx([180, 320], abs=3)  # in the middle
        assert len(bright) == pytest.approx(81 * 1.5**2, rel=0.2)  # three times as wide as below
    else:
        assert bright.mean(axis=0) == pytest.approx([353, 5], abs=6)  # in the same corner


@pytest.fixture
def pair(tmp_path: Path) -> Iterator[tuple[CameraProcess, TrackerProcess]]:
    camera = start_camera(tmp_path / "c", Filming(fish=FISH, target=TARGET))
    camera.show(Scene(POSE, target=AIM))
    tracker = start_tracker(camera.where, true_calibration())
    yield camera, tracker
    tracker.close()
    camera.close()


@pytest.mark.thorough
def test_a_crash_in_the_native_code_is_told_and_the_process_started_anew(pair):
    """Then the camera goes away, and that is told too."""
    camera, tracker = pair
    until(lambda: tracker.newest() is not None and tracker.newest().frame.fish is not None)
    assert tracker.newest().frame.fish == pytest.approx(POSE, abs=0.02)
    assert abs(time.monotonic_ns() - tracker.newest().frame.captured) < 10e9
    first, stamp = tracker.pid, tracker.newest().frame.captured
    os.kill(first, signal.SIGSEGV)
    until(lambda: "signal 11 (SIGSEGV)" in tracker.fault)
    until(lambda: tracker.fault == "" and tracker.newest().frame.captured > stamp)
    assert tracker.restarts == 1 and tracker.pid != first
    until(lambda: tracker.picture()[:2] == b"\xff\xd8")  # a JPEG
    camera.close()
    until(lambda: "is the camera plugged in" in tracker.fault or "start the" in tracker.fault)


@pytest.mark.thorough
def test_a_process_that_hangs_is_replaced(pair):
    _, tracker = pair
    until(lambda: tracker.newest() is not None)
    first = tracker.pid
    os.kill(first, signal.SIGSTOP)
    until(lambda: "hung" in tracker.fault)
    until(lambda: tracker.fault == "" and tracker.pid != first)


# ---- tags that are fixed to the pool ------------------------------------------------------------

EDGE = {10: (-2.2, 1.0), 11: (2.2, 1.0), 12: (2.2, -1.0)}


def pinned(shift: float, renderer: Renderer, tracker: Tracker) -> Sighting:
    """Two seconds of fish, target and fixed tags under a camera that moved sideways by `shift`:
    all that it films is shifted to the other side."""
    others = tuple((ident, (x - shift, y, 0.0)) for ident, (x, y) in EDGE.items())
    scene = Scene(fish=(0.6 - shift, -0.4, 0.7), target=(-1.0 - shift, 0.5, 2.0), others=others)
    return film(tracker, renderer, [scene] * 120)[-1]


@pytest.mark.thorough
@pytest.mark.parametrize(("shift", "told"), [(0.0, False), (0.005, False), (0.03, True)])
def test_fixed_tags_tell_a_camera_that_moved_from_one_that_did_not(renderer, shift, told):
    places = {ident: (x, y, FISH.height) for ident, (x, y) in EDGE.items()}
    tracker = Tracker(replace(true_calibration(), fixed=places))
    last = pinned(shift, renderer, tracker)
    assert bool(warning(last.moved)) is told
    assert abs(last.moved - shift) < 0.006  # waves of the surface move a tag too
    assert last.frame.fish and "unexpected tag" not in last.rejected


def told_after(rate: float, course: float) -> float:
    """Time [s] until a camera at `rate` [Hz] that begins to drift by 1 cm/s in a direction [rad] is
    told by two fixed tags; infinite after 5 s."""
    places = {ident: (x, y, FISH.height) for ident, (x, y) in EDGE.items() if ident != 11}
    tracker, optics = Tracker(replace(true_calibration(), fixed=places)), Optics()
    renderer, begin = Renderer(optics, fish=FISH, target=TARGET), 1.9
    others = tuple((ident, (x, y, 0.0)) for ident, (x, y, _) in places.items())
    scene = Scene(fish=POSE, target=AIM, others=others)
    (x, y, z), way = optics.position, np.array([math.cos(course), math.sin(course)])
    for k in range(round((begin + 5.0) * rate)):
        now = k / rate
        x1, y1 = np.array([x, y]) + 0.01 * max(now - begin, 0.0) * way
        renderer.optics = replace(optics, position=(x1, y1, z))
        if warning(tracker.see(renderer.draw(scene, now), round(1e9 * now)).moved):
            return now - begin
    return math.inf


@pytest.mark.thorough
@pytest.mark.parametrize("rate", [60.0, 15.0])
@pytest.mark.parametrize("course", [0.3, 2.2, 4.4])
def test_a_camera_that_drifts_slowly_is_told_within_three_seconds_at_any_frame_rate(rate, course):
    assert 1.0 < told_after(rate, course) < 3.0


def test_without_fixed_tags_nothing_is_said(renderer, tracker):
    assert pinned(0.03, renderer, tracker).moved == 0.0
