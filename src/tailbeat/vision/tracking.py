"""The tracker in its own process, which is started again when it ends.

Native code may crash, but the station and its page must go on. The process is a fresh interpreter
that imports only this room, so that a restart is fast. Both ends of the pipe are our own processes;
its messages are pickled.
"""

import contextlib
import multiprocessing
import signal
import subprocess
import threading
import time
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tailbeat.files import BadInput
from tailbeat.processes import start
from tailbeat.vision.calibration import Calibration
from tailbeat.vision.camera import CameraFault, open_camera
from tailbeat.vision.tags import FISH, TARGET
from tailbeat.vision.tracker import Picture, Sighting, Tracker, TrackerLimits, check_ids

PREVIEW = 0.1  # s between two pictures for the operator page
PREVIEW_SIZE = (640, 360)  # px of each of its two halves, the fish close up and the whole pool
CLOSE = 3  # times larger than in the whole picture
QUALITY = 70  # of their JPEG
SILENT = 0.4  # s without a message from a process that has sent one: it hangs; this is reported
HUNG = 1.5  # s: it is replaced; a new one takes a second to start
LOOK = 0.05  # s between two looks at its silence
STARTING = 60.0  # s for its first message
SLOW = 5.0  # s that its first sighting may take, and its end after a fault
RUN = "import sys; from tailbeat.vision.tracking import work; work(int(sys.argv[1]))"
PAUSES = (0.1, 0.5, 1.0, 2.0)  # s before the first, second, … restart in a row


@dataclass(frozen=True)
class Watching:
    """Configuration of a tracker process, as for `open_camera` and `Tracker`."""

    camera: str
    calibration: Calibration
    ids: tuple[int, int] = (FISH, TARGET)
    limits: TrackerLimits = field(default_factory=TrackerLimits)
    exposure: float = 0.002
    latency: float = 0.0
    rate: float = 60.0


@dataclass(eq=False)
class TrackerProcess:
    """A tracker process; see `start_tracker`. `fault` says why nothing is seen, "" while frames
    arrive; `restarts` counts restarted processes."""

    watching: Watching
    fault: str = ""
    restarts: int = 0
    process: Any = None
    over: threading.Event = field(default_factory=threading.Event)
    changed: threading.Condition = field(default_factory=threading.Condition)
    seen: Sighting | None = None
    shown: bytes = b""
    heard: bool = False  # whether the present process saw anything
    due: float = 0.0  # when it is silent for too long [s]

    def newest(self) -> Sighting | None:
        """The newest sighting, None before the first. Check its time: it may be old."""
        return self.seen

    def after(self, stamp: int, patience: float) -> Sighting | None:
        """The newest sighting after a stamp [ns], waited for up to `patience` [s], or None."""
        with self.changed:
            self.changed.wait_for(
                lambda: self.seen is not None and self.seen.frame.captured > stamp, patience
            )
            fresh = self.seen is not None and self.seen.frame.captured > stamp
            return self.seen if fresh else None

    def picture(self) -> bytes:
        """The last preview, see `preview`, or b"" before the first."""
        return self.shown

    @property
    def pid(self) -> int | None:
        """Process id of the present tracker."""
        return None if self.process is None else self.process.pid

    def close(self) -> None:
        """End it, also if it hangs."""
        self.over.set()
        self.thread.join(10)

    def begin(self) -> None:
        """Start the thread that supervises; `start_tracker` calls it."""
        self.thread = threading.Thread(target=self._supervise, daemon=True)
        self.thread.start()

    # ---- supervision ----------------------------------------------------------------------------

    def _supervise(self) -> None:
        tries = 0
        while not self.over.is_set():
            heard = self._one_life()
            tries = 0 if heard else tries + 1
            if not self.over.wait(PAUSES[min(tries, len(PAUSES) - 1)]):
                self.restarts += 1

    def _one_life(self) -> bool:
        """Start a process and read its messages until it ends; returns whether it saw anything."""
        ours, theirs = multiprocessing.Pipe()
        end = theirs.fileno()
        self.process = start(["-c", RUN, str(end)], pass_fds=[end], stdin=subprocess.DEVNULL)
        theirs.close()
        self.heard, self.due = False, time.monotonic() + STARTING
        reader = threading.Thread(target=self._read, args=(ours,), daemon=True)
        reader.start()
        self._attend(reader)
        self.process.kill()  # then the reader finds the pipe's end, also within a message
        self.process.wait()
        reader.join()
        ours.close()
        return self.heard

    def _read(self, ours: Connection) -> None:
        """Handle its messages until they end."""
        with contextlib.suppress(EOFError, OSError):
            ours.send(self.watching)
            while True:
                word = ours.recv()
                self._take(word)
                steady = self.heard and not isinstance(word, str)
                self.due = time.monotonic() + (SILENT if steady else SLOW)

    def _attend(self, reader: threading.Thread) -> None:
        """Return when its messages have ended, or it has hung for too long; report why."""
        while not self.over.is_set():
            reader.join(LOOK)
            silent = time.monotonic() - self.due
            if not reader.is_alive():
                self._obituary()
                return
            if silent > HUNG - SILENT:
                self._say("the tracker's process hung; it is started again")
                return
            if silent > 0:
                self._say("the tracker's process hangs")

    def _take(self, word: Sighting | bytes | str | None) -> None:
        """Handle a sighting, a preview, a fault, or None: it waits for the camera."""
        if isinstance(word, str):
            self._say(word)
        elif isinstance(word, bytes):
            self.shown = word
        elif word is not None:
            with self.changed:
                self.seen, self.fault, self.heard = word, "", True
                self.changed.notify_all()

    def _obituary(self) -> None:
        try:
            code = self.process.wait(2)
        except subprocess.TimeoutExpired:
            code = None
        if code == 0:
            return  # it sent the reason
        how = f"code {code}"
        if code is not None and code < 0:
            how = f"signal {-code} ({signal.Signals(-code).name})"
        self._say(f"the tracker's process ended with {how}; it is started again")

    def _say(self, fault: str) -> None:
        with self.changed:
            self.fault = fault
            self.changed.notify_all()


def start_tracker(
    camera: str, calibration: Calibration, ids: tuple[int, int] = (FISH, TARGET), **more: Any
) -> TrackerProcess:
    """Watch a camera (see `open_camera`) for the tags of fish and target; `more` as in `Watching`.

    Returns at once. A problem with the camera is reported in `fault`, and the camera is opened
    again. Raises BadInput for ids that are equal or of the survey.
    """
    check_ids(ids, calibration)
    made = TrackerProcess(Watching(camera, calibration, ids, **more))
    made.begin()
    return made


# ---- the process --------------------------------------------------------------------------------


def work(end: int) -> None:
    """The process: gets its configuration through the pipe with descriptor `end`."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends it
    cv2.setNumThreads(1)
    speak: Connection = Connection(end)
    try:
        _watch(speak.recv(), speak)
    except (BadInput, CameraFault) as fault:
        speak.send(str(fault))
    except (EOFError, ConnectionError):
        pass  # the parent has ended


def _watch(made: Watching, speak: Connection) -> None:
    tracker = Tracker(made.calibration, made.ids, made.limits)
    camera = open_camera(
        made.camera, made.calibration.lens.size, made.rate, made.exposure, made.latency
    )
    due, middle = 0.0, np.array(made.calibration.lens.size) / 2
    try:
        while True:
            image, stamp = camera.read(lambda: speak.send(None))
            sighting = tracker.see(image, stamp)
            speak.send(sighting)
            if made.ids[0] in sighting.corners:
                middle = sighting.corners[made.ids[0]].mean(axis=0)
            if time.monotonic() >= due:
                due = time.monotonic() + PREVIEW
                speak.send(preview(image, middle))
    except CameraFault as fault:
        speak.send(str(fault))  # before the camera is closed, which takes time
    finally:
        camera.close()


def preview(image: Picture, middle: NDArray[np.float64]) -> bytes:
    """A small JPEG for the operator page. It shows the surroundings of `middle` (x, y) [px], where
    the fish was last seen, and below them the whole frame with these surroundings outlined."""
    rows, columns = image.shape
    size = np.array([columns, rows]) // (2 * CLOSE)  # half of it
    x, y = np.clip(np.asarray(middle, int), size, np.array([columns, rows]) - size).tolist()
    half, high = size.tolist()
    part = image[y - high : y + high, x - half : x + half]
    close = cv2.resize(part, PREVIEW_SIZE, interpolation=cv2.INTER_LINEAR)
    small = cv2.resize(image, PREVIEW_SIZE, interpolation=cv2.INTER_AREA)
    scale = np.array(PREVIEW_SIZE) / [columns, rows]
    ends = [
        tuple(np.round(scale * [x + s * half, y + s * high]).astype(int).tolist()) for s in (-1, 1)
    ]
    cv2.rectangle(small, ends[0], ends[1], 255)
    both = np.vstack([close, small])
    _, data = cv2.imencode(".jpg", both, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    return bytes(np.asarray(data, np.uint8))
