"""One interface to all sources of pictures: a camera, a film, or the virtual camera's socket.

`read` gives the newest frame and the middle of its exposure, on this machine's monotonic clock (for
the virtual camera, on its own station's). A thread reads every frame and keeps the newest, because
a queue adds latency (OpenCV's holds at least four frames). If a camera is gone or its frames stop,
`read` raises CameraFault; it never blocks for ever.
"""

import contextlib
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from tailbeat.files import BadInput

Picture = NDArray[np.uint8]
Stamped = tuple[Picture, int]
HEADER = struct.Struct("<4sQQHH")  # magic, number, end of exposure [ns], columns, rows
MAGIC = b"tbF1"
LARGEST = 4096  # px, longest side
SIZE = (1280, 720)  # px, columns and rows that are requested of a device
SECOND = 1_000_000_000
PATIENCE = 1.0  # s without a frame: sixty frames
FIRST = 10.0  # s for the first frame: cameras set their exposure
BRIEF = 0.1  # s between two calls of `waiting`
FROZEN = 60  # equal pictures that are a fault: a live picture has noise


class CameraFault(Exception):
    """The camera is gone, or no frame came in time; the message says what to check."""


class Camera(Protocol):
    """A source of pictures, see `open_camera`."""

    def read(self, waiting: Callable[[], None] = lambda: None) -> Stamped:
        """The newest grey frame (rows, columns) not yet read, and the middle of its exposure [ns].
        Calls `waiting` now and then while there is none. Raises CameraFault."""

    def close(self) -> None:
        """Close it."""


@dataclass(eq=False)
class Drained:
    """A camera whose frames a thread reads; only the newest is kept. `skipped` counts frames that
    were not read."""

    name: str
    frames: Iterator[Stamped]
    shut: Callable[[], None]
    patience: float = PATIENCE
    lag: int = 0  # ns from the middle of the exposure to the stamp
    skipped: int = 0
    newest: Stamped | None = None
    fault: str = ""
    same: int = 0
    last: bytes = b""  # every eighth pixel of the last frame
    changed: threading.Condition = field(default_factory=threading.Condition)

    def __post_init__(self) -> None:
        self.wait = max(self.patience, FIRST)
        self.thread = threading.Thread(target=self._drain, daemon=True)
        self.thread.start()

    def _drain(self) -> None:
        try:
            for frame in self.frames:
                self._keep(frame, "")
            self._keep(None, "it closed")
        except (OSError, ValueError, CameraFault) as error:
            self._keep(None, str(error))

    def _keep(self, frame: Stamped | None, fault: str) -> None:
        with self.changed:
            self.skipped += self.newest is not None
            self.newest, self.fault = frame, fault
            self.changed.notify_all()

    def read(self, waiting: Callable[[], None] = lambda: None) -> Stamped:
        """See `Camera`."""
        end = time.monotonic() + self.wait
        while not self._wait(min(BRIEF, end - time.monotonic())) and time.monotonic() < end:
            waiting()
        with self.changed:
            frame, self.newest = self.newest, None
        if frame is None:
            why = self.fault or f"no frame for {self.wait:g} s"
            raise CameraFault(f"{self.name}: {why}; is the camera plugged in, and not in use?")
        self.wait = self.patience
        self._check_alive(frame[0])
        return frame[0], frame[1] - self.lag

    def _wait(self, seconds: float) -> bool:
        """Whether there is a frame or a fault, waited for up to `seconds`."""
        with self.changed:
            return self.changed.wait_for(
                lambda: self.newest is not None or bool(self.fault), seconds
            )

    def _check_alive(self, image: Picture) -> None:
        sample = image[::8, ::8].tobytes()
        self.same = self.same + 1 if sample == self.last else 0
        self.last = sample
        if self.same >= FROZEN:
            raise CameraFault(f"{self.name}: the same picture {FROZEN} times; restart the camera")

    def close(self) -> None:
        """See `Camera`."""
        self.shut()
        self.thread.join(2)


@dataclass(eq=False)
class Film:
    """A film, read frame by frame without skipping; times follow its frame rate from 0."""

    name: str
    capture: Any
    number: int = 0

    def read(self, waiting: Callable[[], None] = lambda: None) -> Stamped:
        """See `Camera`; the end of the film raises CameraFault too."""
        good, image = self.capture.read()
        if not good:
            raise CameraFault(f"{self.name}: the film is over after {self.number} frames")
        rate = self.capture.get(cv2.CAP_PROP_FPS) or 60.0
        self.number += 1
        return grey(image), round((self.number - 1) / rate * SECOND)

    def close(self) -> None:
        """See `Camera`."""
        self.capture.release()


def open_camera(
    where: str,
    size: tuple[int, int] = SIZE,
    rate: float = 60.0,
    exposure: float = 0.002,
    latency: float = 0.0,
    patience: float = PATIENCE,
) -> Camera:
    """Open `unix:/path` of a virtual camera, a device (`/dev/video0`, 0, or its name below
    `/dev/v4l/by-id`), or a film's file.

    `size` (columns, rows) and `rate` [Hz] are requested from a device. `exposure` [s] and `latency`
    [s], from the end of the exposure to the time stamp, are subtracted from the stamps. Raises
    BadInput.
    """
    lag = round((exposure / 2 + latency) * SECOND)
    if where.startswith("unix:"):
        return _open_socket(where.removeprefix("unix:"), lag, patience)
    if is_device(where):
        return _open_device(where, size, rate, lag, patience)
    if not Path(where).is_file():
        raise BadInput(f"{where}: no such camera; give unix:/path, /dev/video0 or a film's file.")
    capture = cv2.VideoCapture(where)
    if not capture.isOpened():
        raise BadInput(f"{where}: OpenCV cannot read this film; try another format.")
    return Film(where, capture)


def is_device(where: str) -> bool:
    """Whether this names a camera of the computer, by number or path."""
    return where.isdigit() or where.startswith("/dev/")


def grey(image: Any) -> Picture:
    """Convert a picture to grey, one byte a pixel."""
    if image.ndim == 3:
        image = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    return np.asarray(image, np.uint8)


# ---- the virtual camera's socket ----------------------------------------------------------------


def _open_socket(path: str, lag: int, patience: float) -> Drained:
    made = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        made.connect(path)
    except OSError as error:
        made.close()
        raise BadInput(f"unix:{path}: {error.strerror}; start the virtual camera first.") from None

    def shut() -> None:
        with contextlib.suppress(OSError):
            made.shutdown(socket.SHUT_RDWR)
        made.close()

    return Drained(f"unix:{path}", _from_socket(made), shut, patience, lag)


def _from_socket(made: socket.socket) -> Iterator[Stamped]:
    head = bytearray(HEADER.size)
    while _fill(made, head):
        magic, _, stamp, columns, rows = HEADER.unpack(head)
        if magic != MAGIC or not (0 < columns <= LARGEST and 0 < rows <= LARGEST):
            raise CameraFault("it sends something else than frames")
        image = np.empty((rows, columns), np.uint8)
        if not _fill(made, image.reshape(-1)):
            return
        yield image, stamp


def _fill(made: socket.socket, room: Any) -> bool:
    """Read until `room` is full; False where the sender has closed."""
    left = memoryview(room)
    while left:
        count = made.recv_into(left)
        if not count:
            return False
        left = left[count:]
    return True


# ---- a real camera ------------------------------------------------------------------------------


def _open_device(
    where: str, size: tuple[int, int], rate: float, lag: int, patience: float
) -> Drained:
    number = int(where) if where.isdigit() else where
    capture = cv2.VideoCapture(number, cv2.CAP_V4L2)
    if not capture.isOpened():
        raise BadInput(f"{where}: no camera answers; check its plug, and that you may read it.")
    for setting, value in (
        (cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*"MJPG")),  # raw 720p is too much for USB 2
        (cv2.CAP_PROP_FRAME_WIDTH, size[0]),
        (cv2.CAP_PROP_FRAME_HEIGHT, size[1]),
        (cv2.CAP_PROP_FPS, rate),
        (cv2.CAP_PROP_BUFFERSIZE, 1),
    ):
        capture.set(setting, value)
    ended = threading.Event()
    return Drained(where, _from_device(capture, ended), ended.set, patience, lag)


def _from_device(capture: Any, ended: threading.Event) -> Iterator[Stamped]:
    """Grab and release in one thread: OpenCV's captures are not thread-safe."""
    try:
        while not ended.is_set() and capture.grab():
            now = time.monotonic_ns()
            good, image = capture.retrieve()
            if good:
                yield grey(image), _stamp(capture, now)
    finally:
        capture.release()


def _stamp(capture: Any, now: int) -> int:
    """The driver's time stamp if it is on the monotonic clock, else the time of the grab."""
    driver = round(1e6 * capture.get(cv2.CAP_PROP_POS_MSEC))
    return driver if 0 <= now - driver < SECOND else now
