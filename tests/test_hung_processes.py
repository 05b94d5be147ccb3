"""The page's server and the tracker stand still (SIGSTOP): they are noticed, replaced and ended."""

import math
import os
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from threading import Event, Thread, Timer

import pytest

pytest.importorskip("cv2", reason="the robot extra is not installed")
pytest.importorskip("pyapriltags", reason="the robot extra is not installed")
pytest.importorskip("fastapi", reason="the station extra is not installed")
pytest.importorskip("websockets", reason="the station extra is not installed")

import websockets.sync.client as ws
from psutil import NoSuchProcess, Process

from camera_views import FISH, TARGET, true_calibration
from support import command, until
from tailbeat.emulators import live
from tailbeat.emulators.camera import Scene
from tailbeat.emulators.camera_process import CameraProcess, start_camera
from tailbeat.emulators.film import Filming
from tailbeat.emulators.live import Part, Pulse
from tailbeat.files import BadInput
from tailbeat.fish.store import load_fish
from tailbeat.link import datagrams as link
from tailbeat.link.sender import Sender
from tailbeat.operator.client import ANSWERS, HANGS, HUNG, OperatorClient, open_client, turn
from tailbeat.operator.station import Station, _turns
from tailbeat.vision import tracking
from tailbeat.vision.tracking import TrackerProcess, start_tracker

pytestmark = pytest.mark.realtime("robot")

KEY, ROOM = bytes(32), (5.5, 2.7)
DESCRIBED = load_fish("pulley-fish")


@contextmanager
def sender() -> Iterator[Sender]:
    made = link.bind("127.0.0.1", 0)
    yield Sender(KEY, made, ("127.0.0.1", 9))
    made.close()


@pytest.fixture
def page() -> Iterator[OperatorClient]:
    made = open_client(("127.0.0.1", 0), ROOM)
    yield made
    if made.process is not None and made.process.poll() is None:
        made.process.kill()


@pytest.fixture
def pair(tmp_path: Path) -> Iterator[tuple[CameraProcess, TrackerProcess]]:
    camera = start_camera(tmp_path / "c", Filming(fish=FISH, target=TARGET))
    camera.show(Scene((0.6, -0.4, 0.7), target=(-1.0, 0.5, 2.0)))
    tracker = start_tracker(camera.where, true_calibration())
    until(lambda: tracker.newest() is not None)
    yield camera, tracker
    tracker.close()
    camera.close()


# ---- the page's server --------------------------------------------------------------------------


@contextmanager
def serving(page: OperatorClient) -> Iterator[list[str]]:
    """A thread serves the page as a station does; gives what it says of the server."""
    said, ended = list[str](), Event()

    def serve() -> None:
        with sender() as made:
            while not ended.is_set():
                said.extend(filter(None, [turn(page, made, DESCRIBED, time.monotonic())]))
                time.sleep(0.005)

    thread = Thread(target=serve, daemon=True)
    thread.start()
    try:
        yield said
    finally:
        ended.set()
        thread.join(10)
        page.close()


@pytest.mark.thorough
def test_a_page_s_server_that_hangs_is_told_within_half_a_second_and_replaced(page):
    with serving(page) as said:
        until(lambda: time.monotonic() > page.again)
        hung, began = page.process, time.monotonic()
        os.kill(hung.pid, signal.SIGSTOP)
        until(lambda: said, seconds=10)
        assert time.monotonic() - began < 0.6
        until(lambda: page.process is not hung, seconds=10)
        assert 1.5 < time.monotonic() - began < 5
        until(lambda: len(said) > 1, seconds=10)
        assert said == [HANGS, "the operator page's server hung; it is started again"]
        assert hung.poll() == -signal.SIGKILL
        until(lambda: page.ready)
        with ws.connect(page.url.partition("#")[0].replace("http", "ws") + "live") as browser:
            assert "now" in browser.recv(30)


@pytest.mark.thorough
def test_a_page_s_server_that_was_slow_for_a_moment_goes_on(page):
    with serving(page) as said:
        until(lambda: time.monotonic() > page.again)
        slow = page.process
        os.kill(slow.pid, signal.SIGSTOP)
        until(lambda: said == [HANGS], seconds=10)
        os.kill(slow.pid, signal.SIGCONT)
        until(lambda: said == [HANGS, ANSWERS], seconds=10)
        assert page.process is slow


@pytest.mark.thorough
def test_a_station_that_stood_still_itself_does_not_blame_its_server(page):
    with sender() as made:
        turn(page, made, DESCRIBED, time.monotonic())
        time.sleep(HUNG + 0.5)  # the whole station was suspended
        before = page.process
        for _ in range(20):
            assert turn(page, made, DESCRIBED, time.monotonic()) == ""
            time.sleep(0.05)
    assert page.process is before
    page.close()


@pytest.mark.thorough
def test_a_server_that_hangs_does_not_keep_the_station_from_ending(page):
    os.kill(page.process.pid, signal.SIGSTOP)
    began = time.monotonic()
    page.close()
    assert time.monotonic() - began < 5
    assert page.process.returncode == -signal.SIGKILL


@pytest.mark.thorough
def test_a_server_that_works_ends_by_itself_however_soon(capfd):
    for _ in range(4):
        made = open_client(("127.0.0.1", 0), ROOM)
        made.close()
        assert made.process is not None and made.process.returncode in (0, -signal.SIGTERM)
    assert capfd.readouterr().err == ""


@pytest.mark.thorough
def test_a_station_whose_page_hangs_ends_at_ctrl_c_without_a_traceback(tmp_path):
    link.make_key(tmp_path / "fish.key")
    robot, listen = ("{}:{}".format(*link.free_address()) for _ in range(2))
    words = command("station", "--robot", robot, "--listen", listen, "--page", "127.0.0.1:0",
                    "--key", tmp_path / "fish.key")  # fmt: skip
    errors = tmp_path / "errors"
    with errors.open("w") as file:
        process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=file, text=True)
    assert process.stdout is not None and "operator page" in process.stdout.readline()
    (server,) = Process(process.pid).children()
    server.suspend()
    try:
        process.send_signal(signal.SIGINT)
        assert process.wait(8) == 0 and errors.read_text() == ""
        assert not server.is_running()
    finally:
        process.kill()
        with suppress(NoSuchProcess):
            server.kill()
        process.communicate()


# ---- the station --------------------------------------------------------------------------------


@pytest.fixture
def station(tmp_path: Path) -> Iterator[tuple[Part, Pulse]]:
    """A station without camera, fish and page, as `swim` starts it."""
    link.make_key(tmp_path / "fish.key")
    robot, listen = ("{}:{}".format(*link.free_address()) for _ in range(2))
    words = ["station", "--robot", robot, "--listen", listen, "--page", ""]
    words += ["--key", str(tmp_path / "fish.key")]
    with live.pulse(tmp_path) as beats:
        with live.started(words, tmp_path / "station.log", True, beats.address) as part:
            until(lambda: beats.silent() >= 0)
            yield part, beats


@pytest.mark.thorough
def test_a_swim_whose_station_hangs_is_ended_in_a_sentence(station):
    part, beats = station
    os.kill(part.process.pid, signal.SIGSTOP)
    began = time.monotonic()
    with pytest.raises(BadInput, match=r"`station` gave no sign of life for \d+ s; try it"):
        live._listen(part, (), beats, print)
    assert time.monotonic() - began < live.HUNG + 1.5
    assert part.process.wait(5) == -signal.SIGKILL


@pytest.mark.thorough
def test_a_swim_whose_station_hangs_is_interrupted_by_ctrl_c(station, monkeypatch):
    part, beats = station
    monkeypatch.setattr(live, "HUNG", 60.0)
    # a shell starts what runs in its background without Ctrl-C
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    os.kill(part.process.pid, signal.SIGSTOP)
    Timer(1.0, signal.raise_signal, [signal.SIGINT]).start()
    with pytest.raises(KeyboardInterrupt):
        live._listen(part, (), beats, print)
    signal.signal(signal.SIGINT, before)
    assert part.process.returncode == -signal.SIGKILL


@pytest.mark.thorough
def test_a_station_that_is_asked_to_end_does_not_hang_however_long_that_takes(station):
    part, beats = station
    part.process.send_signal(signal.SIGINT)
    live._listen(part, (), beats, print)
    assert part.process.returncode == 0 and beats.silent() == -math.inf


# ---- the tracker --------------------------------------------------------------------------------


@pytest.mark.thorough
def test_a_tracker_that_hangs_is_noticed_within_half_a_second_and_replaced(pair):
    _, tracker = pair
    first, began = tracker.pid, time.monotonic()
    os.kill(first, signal.SIGSTOP)
    until(lambda: "hangs" in tracker.fault, seconds=10)
    assert time.monotonic() - began < 0.6
    until(lambda: "it is started again" in tracker.fault)
    until(lambda: tracker.fault == "" and tracker.pid != first)
    assert tracker.restarts == 1


@pytest.mark.thorough
def test_a_tracker_that_was_slow_for_a_moment_goes_on(pair):
    _, tracker = pair
    first = tracker.pid
    os.kill(first, signal.SIGSTOP)
    until(lambda: "hangs" in tracker.fault, seconds=10)
    os.kill(first, signal.SIGCONT)
    until(lambda: tracker.fault == "")
    assert tracker.pid == first and tracker.restarts == 0


@pytest.mark.thorough
def test_a_camera_without_frames_is_not_taken_for_a_tracker_that_hangs(pair):
    camera, tracker = pair
    heard = tracker.newest().frame.captured
    os.kill(camera.process.pid, signal.SIGSTOP)
    try:
        until(lambda: tracker.fault != "")
    finally:
        os.kill(camera.process.pid, signal.SIGCONT)
    assert "no frame for 1 s" in tracker.fault
    until(lambda: tracker.fault == "" and tracker.newest().frame.captured > heard)


@pytest.mark.thorough
def test_the_station_says_that_its_tracker_hangs_and_that_frames_arrive_again(pair):
    _, tracker = pair
    said, ended = list[str](), Event()
    with sender() as made:
        station = Station(made, tracker, None, DESCRIBED)
        words = (station, None, ended.is_set, said.append)
        serving = Thread(target=_turns, args=words, daemon=True)
        serving.start()
        os.kill(tracker.pid, signal.SIGSTOP)
        until(lambda: said[-1:] == ["camera: frames arrive"], what=lambda: said)
        ended.set()
        serving.join(10)
    assert said[:2] == [
        "camera: the tracker's process hangs",
        "camera: the tracker's process hung; it is started again",
    ]


STUCK = "import os, sys, time; os.write(int(sys.argv[1]), b'\\0\\1\\0\\0x'); time.sleep(600)"


@pytest.mark.thorough
def test_a_tracker_that_hangs_within_a_message_does_not_keep_the_station_from_ending(monkeypatch):
    """The message says that it has 65536 bytes, and one comes."""
    monkeypatch.setattr(tracking, "RUN", STUCK)
    tracker = start_tracker("nowhere", true_calibration())
    until(lambda: tracker.pid is not None)
    time.sleep(0.5)
    process, began = tracker.process, time.monotonic()
    tracker.close()
    assert time.monotonic() - began < 3
    assert process.poll() == -signal.SIGKILL and not tracker.thread.is_alive()
