"""The virtual camera's pictures, and the seam that real and virtual cameras stand behind."""

import errno
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("cv2", reason="the robot extra is not installed")
pytest.importorskip("pyapriltags", reason="the robot extra is not installed")

import cv2

from camera_views import FISH, true_calibration
from support import until
from tailbeat.emulators import film
from tailbeat.emulators.camera import Conditions, Renderer, Scene, calm
from tailbeat.emulators.camera_process import start_camera
from tailbeat.emulators.film import Filming, listen, packed, serve
from tailbeat.emulators.optics import Optics, project
from tailbeat.files import BadInput
from tailbeat.vision.camera import FROZEN, CameraFault, Drained, _from_socket, open_camera
from tailbeat.vision.detector import open_detector

pytestmark = pytest.mark.realtime

SCENE = Scene((0.5, -0.4, 0.7), (0.2, 0.1, 1.0), None, (-1.0, 0.5, 2.0))
PLACES = np.array([[x, y] for x in (-2.6, -1.0, 0.05, 2.6) for y in (-1.3, -0.03, 1.3)])


# ---- what is seen -------------------------------------------------------------------------------


@pytest.mark.parametrize("height", [0.12, 0.0, -0.03, -0.2, -1.0])
def test_seen_through_water_and_followed_back_is_the_same_place(height):
    """The camera solves Snell's law for where light surfaces, the calibration follows a ray down:
    two ways, one place."""
    points = np.column_stack([PLACES, np.full(len(PLACES), height)])
    found = true_calibration().places(project(Optics(), points), height)
    assert np.abs(found - PLACES).max() < 1e-4  # OpenCV's inverse of the lens ends there


def test_water_lifts_what_lies_in_it_and_nothing_straight_below():
    optics = Optics()
    deep = np.column_stack([PLACES, np.full(len(PLACES), -0.2)])
    flat = deep * [1, 1, 0]
    dry, wet = project(Optics(index=1.0), deep), project(optics, deep)
    surface, below = project(optics, flat), project(optics, np.array([[0.05, -0.03, -0.2]]))
    assert (np.linalg.norm(wet - dry, axis=1)[[0, 2, 9, 11]] > 2).all()
    nearer = np.linalg.norm(wet - surface, axis=1) < np.linalg.norm(dry - surface, axis=1)
    assert nearer[[0, 2, 3, 5, 9, 11]].all()
    assert below == pytest.approx(project(optics, np.array([[0.05, -0.03, 0.0]])), abs=1e-6)


def test_a_plane_at_depth_over_the_index_is_off_by_millimetres_in_the_corner():
    """Why a ray is followed and no plane shifted."""
    corner = np.array([[2.6, 1.3, -0.05]])
    pixel = project(Optics(), corner)
    shifted = true_calibration(Optics(index=1.0)).places(pixel, -0.05 / 1.333)
    assert 0.003 < np.linalg.norm(shifted - corner[:, :2]) < 0.02


@pytest.mark.thorough
def test_a_seed_s_pictures_repeat_and_another_s_do_not():
    first, again, other = (Renderer(seed=seed).draw(SCENE, 1.0) for seed in (4, 4, 5))
    assert first.shape == (720, 1280) and first.dtype == np.uint8
    assert np.array_equal(first, again) and not np.array_equal(first, other)


@pytest.mark.thorough
def test_brightness_comes_in_as_many_levels_as_there_are_bits():
    coarse = Renderer(conditions=Conditions(bits=4)).draw(SCENE, 0.0)
    assert set(np.unique(coarse) % 16) == {0}


def test_waves_move_what_is_under_water_and_not_what_floats():
    """d (1 - 1 / n) times the slope; three centimetres down and two percent make a quarter of a
    millimetre, so here it is deep and rough."""
    renderer = Renderer(conditions=Conditions(slope=0.1))
    deep = np.array([renderer.seen(PLACES, -0.2, t) for t in np.arange(0, 4, 0.1)])
    flat = np.array([renderer.seen(PLACES, 0.0, t) for t in np.arange(0, 4, 0.1)])
    assert np.abs(np.diff(flat, axis=0)).max() == 0
    moved = deep[:, 4, 0].std() / 250  # m: 250 px a metre in the middle
    assert 0.2 * (1 - 1 / 1.333) * 0.1 / 4 < moved < 0.2 * (1 - 1 / 1.333) * 0.1


def test_a_fast_tag_is_blurred():
    """A metre per second over twenty milliseconds of exposure: five pixels."""
    sharp, blurred = (
        Renderer(conditions=Conditions(exposure=exposure, noise=0.0, flicker=0.0)).draw(
            Scene((0.05, 0.0, 0.0), (1.0, 0.0, 0.0)), 0.0
        )
        for exposure in (0.0, 0.02)
    )
    window = np.s_[300:380, 600:690]
    steep = [np.abs(np.diff(image[window].astype(int), axis=1)).max() for image in (sharp, blurred)]
    assert steep[1] < 0.6 * steep[0]


def test_a_rolling_shutter_moves_what_moves_at_the_top_and_bottom_alone():
    """A metre a second, 16 ms from top to bottom: eight millimetres early at the top."""
    detector, calibration = open_detector(), true_calibration()
    for y, late in ((1.2, -0.0075), (-0.03, 0.0), (-1.2, 0.0065)):
        places = []
        for rolling in (0.0, 0.016):
            renderer = Renderer(conditions=replace(calm(), rolling=rolling), fish=FISH)
            (seen,) = detector.find(renderer.draw(Scene((0.2, y, 0.0), (1.0, 0.0, 0.0)), 0.0))
            places.append(calibration.places(seen.corners, FISH.height).mean(axis=0))
        assert places[1] - places[0] == pytest.approx([late, 0.0], abs=0.0015)


def test_a_tag_under_a_lamp_is_the_harder_to_see():
    detector = open_detector()
    assert detector.fast  # else the binding's layout has changed
    margins = []
    for glare in (0.0, 150.0):
        renderer = Renderer(conditions=Conditions(glare=glare, slope=0.0), fish=FISH)
        (seen,) = detector.find(renderer.draw(Scene((0.3, -0.8, 0.2)), 0.0))
        margins.append(seen.margin)
    assert margins[1] < 0.6 * margins[0]


# ---- the seam -----------------------------------------------------------------------------------


@pytest.fixture
def filmed(tmp_path: Path) -> Iterator[str]:
    """A camera in a thread of this process."""
    path, ended = tmp_path / "c", threading.Event()
    filming = Filming(conditions=calm(), ahead=37_000_000_000)
    thread = threading.Thread(
        target=serve, args=(listen(path), filming, lambda: SCENE, ended.is_set), daemon=True
    )
    thread.start()
    yield f"unix:{path}"
    ended.set()
    thread.join(5)


def test_frames_come_newest_first_and_never_queue(filmed):
    camera = open_camera(filmed, patience=5.0)
    assert isinstance(camera, Drained)
    _, first = camera.read()
    until(lambda: camera.skipped > 15, lambda: f"{camera.skipped} frames were not read")
    image, stamp = camera.read()
    assert stamp - first > 15 * 0.8e9 / 60  # and not the second frame
    ages = time.monotonic_ns() + 37_000_000_000 - stamp  # on the station's clock
    assert 0 < ages < 5e9
    assert {one.ident for one in open_detector().find(image)} == {0, 1}
    camera.close()


def silent(path: Path, frames: list[bytes], hang_up: bool) -> None:
    """A device that sends these bytes and no more."""
    listening = listen(path)

    def work() -> None:
        client, _ = listening.accept()
        for frame in frames:
            client.sendall(frame)
        if hang_up:
            client.close()
        else:
            kept.append(client)

    threading.Thread(target=work, daemon=True).start()


kept: list[socket.socket] = []
PICTURE = np.arange(48, dtype=np.uint8).reshape(6, 8)


@pytest.mark.parametrize(
    "tail, hang_up, why",
    [
        (b"", False, "no frame for 0.2 s"),
        (b"", True, "it closed"),
        (packed(PICTURE, 2, 0)[:40], True, "it closed"),
        (b"x" * 100, False, "it sends something else than frames"),
    ],
)
def test_a_camera_that_stops_goes_or_talks_nonsense_is_one_fault(tmp_path, tail, hang_up, why):
    silent(tmp_path / "c", [packed(PICTURE, 1, 9_000_000), tail], hang_up)
    camera = open_camera(f"unix:{tmp_path / 'c'}", exposure=0.002, patience=0.2)
    began = time.monotonic()
    with pytest.raises(CameraFault, match=why):
        for _ in range(3):
            image, stamp = camera.read()
            assert np.array_equal(image, PICTURE)
            assert stamp == 8_000_000  # half the exposure earlier
    assert time.monotonic() - began < 5
    camera.close()


def test_a_frozen_picture_is_told_from_a_still_pool(tmp_path):
    rng, number = np.random.default_rng(0), FROZEN + 20
    noisy = [rng.integers(0, 255, (48, 64), np.uint8) for _ in range(number)]
    for name, pictures in {"still": noisy, "frozen": noisy[:1] * number}.items():
        ours, theirs = socket.socketpair()
        camera = Drained(name, _from_socket(theirs), theirs.close, patience=5.0)
        for k, picture in enumerate(pictures):
            ours.sendall(packed(picture, k, k))
            if name == "frozen" and k == FROZEN:
                with pytest.raises(CameraFault, match="the same picture 60 times"):
                    camera.read()
                break
            assert np.array_equal(camera.read()[0], picture)
        ours.close()
        camera.close()


def test_a_film_is_read_frame_by_frame(tmp_path):
    path = tmp_path / "swim.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 50.0, (64, 48))
    for level in range(5):
        writer.write(np.full((48, 64, 3), 40 * level, np.uint8))
    writer.release()
    camera = open_camera(str(path))
    frames = [camera.read() for _ in range(5)]
    assert [stamp for _, stamp in frames] == [k * 20_000_000 for k in range(5)]
    assert [round(float(image.mean()) / 40) for image, _ in frames] == list(range(5))
    with pytest.raises(CameraFault, match="over after 5 frames"):
        camera.read()
    camera.close()


def test_cameras_that_are_none_are_refused(tmp_path):
    (tmp_path / "notes.txt").write_text("no film")
    for where, complaint in {
        f"unix:{tmp_path / 'none'}": "start the virtual camera first",
        str(tmp_path / "none.avi"): "no such camera",
        str(tmp_path / "notes.txt"): "cannot read this film",
        "/dev/video77": "no camera answers",
        "/dev/v4l/by-id/usb-none": "no camera answers",
    }.items():
        with pytest.raises(BadInput, match=complaint):
            open_camera(where)
    (tmp_path / "taken").touch()
    with pytest.raises(BadInput, match="does not exist"):
        listen(tmp_path / "taken")


def test_a_slow_reader_holds_up_nobody_and_skips():
    newest, (ours, theirs) = film.Newest(), socket.socketpair()
    threading.Thread(target=film._feed, args=(ours, newest), daemon=True).start()
    big = np.zeros((720, 1280), np.uint8)
    time.sleep(0.05)
    for number in range(1, 31):
        newest.put(packed(big, number, number))  # never waits for the reader
        time.sleep(0.002)
    frames: list[int] = []
    theirs.settimeout(5)
    while not frames or frames[-1] != 30:
        data, size = b"", len(packed(big, 0, 0))
        while len(data) < size:
            data += theirs.recv(size - len(data))
        frames.append(int.from_bytes(data[4:12], "little"))
    assert len(frames) <= 3
    newest.put(b"", over=True)
    theirs.close()


# ---- in a process of its own --------------------------------------------------------------------

STARTS = """
import sys, time
from pathlib import Path
from tailbeat.emulators.camera_process import start_camera
from tailbeat.emulators.film import Filming
start_camera(Path(sys.argv[1]), Filming())
print("filming", flush=True)
time.sleep(600)
"""


@pytest.mark.thorough
def test_a_camera_that_hangs_holds_nobody_up_and_goes_on_with_the_newest_scene(tmp_path):
    made = start_camera(tmp_path / "c", Filming(fish=FISH))
    os.kill(made.process.pid, signal.SIGSTOP)
    for _ in range(5000):  # more than the pipe holds
        made.show(Scene())
    os.kill(made.process.pid, signal.SIGCONT)
    camera = open_camera(made.where, patience=30.0)

    def seen() -> bool:
        made.show(Scene((0.3, -0.8, 0.2)))
        return {one.ident for one in open_detector().find(camera.read()[0])} == {0}

    until(seen)
    camera.close()
    made.close()
    made.show(Scene())  # it is gone, and that is no error


def test_a_camera_ends_with_the_process_that_started_it(tmp_path):
    at = str(tmp_path / "c")
    with subprocess.Popen([sys.executable, "-c", STARTS, at], stdout=subprocess.PIPE) as parent:
        assert parent.stdout is not None and parent.stdout.readline() == b"filming\n"
        parent.kill()

    def gone() -> bool:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as asked:
            return asked.connect_ex(at) == errno.ECONNREFUSED

    until(gone)


def test_a_camera_that_cannot_start_says_so(tmp_path):
    (tmp_path / "taken").touch()
    with pytest.raises(BadInput, match="does not exist"):
        start_camera(tmp_path / "taken", Filming())
    broken = Filming(optics=None)  # type: ignore[arg-type]
    with pytest.raises(BadInput, match="did not start"):
        start_camera(tmp_path / "c", broken)
    assert not (tmp_path / "c").exists()
