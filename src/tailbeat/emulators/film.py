"""The virtual camera as a device: a process that draws a scene and sends frames through a socket.

Frames are made at absolute deadlines, on the station's own clock. They leave after a readout, at
uneven times, and some are dropped. Each client gets the newest frame when it has taken the last
one: there is no queue.
"""

import contextlib
import socket
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tailbeat.emulators.camera import Conditions, Renderer, Scene
from tailbeat.emulators.optics import Optics, above
from tailbeat.files import BadInput
from tailbeat.fish.description import Fish
from tailbeat.link.places import POOL
from tailbeat.vision.calibration import Calibration, Hung, Lens
from tailbeat.vision.camera import HEADER, MAGIC
from tailbeat.vision.tags import FISH, SIDE, TARGET, Tag

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]
SECOND = 1_000_000_000


@dataclass(frozen=True)
class Filming:
    """The virtual camera and its timing; chosen. The station's clock is `ahead` of this machine's
    [ns] and runs `fast` (relative)."""

    optics: Optics = field(default_factory=Optics)
    conditions: Conditions = field(default_factory=Conditions)
    fish: Tag = field(default_factory=lambda: Tag(height=-0.03))
    target: Tag = field(default_factory=Tag)
    ids: tuple[int, int] = (FISH, TARGET)
    rate: float = 60.0  # Hz
    drift: float = 0.001  # relative error of the rate: a camera's quartz is not exact
    readout: float = 0.006  # s, least time from the end of the exposure until a frame leaves
    jitter: float = 0.002  # s, uniform on top
    ahead: int = 0
    fast: float = 0.0
    seed: int = 0

    def clock(self, now: float) -> int:
        """The station's monotonic clock [ns] at time `now` [s] of this machine."""
        return round(now * (1 + self.fast) * SECOND) + self.ahead


def filming_of(fish: Fish, pool: tuple[float, float] = POOL, seed: int = 0) -> Filming:
    """The camera above a pool of this length and width [m], and the fish's own tag, 3 cm below the
    surface; the target's is as large. A small tag gets a camera with more pixels."""
    side = fish.tag or SIDE
    return Filming(above(pool, side), fish=Tag(side, -0.03), target=Tag(side), seed=seed)


def known_calibration(filming: Filming) -> Calibration:
    """The exact calibration of this camera, for emulation and to check measured ones."""
    optics = filming.optics
    (x, y), focal = optics.centre, optics.focal
    matrix = np.array([[focal, 0, x], [0, focal, y], [0, 0, 1.0]])
    lens = Lens(optics.size, matrix, np.array([*optics.radial, *optics.tangential, 0.0]), 0.0)
    hung = Hung(optics.rotation, np.array(optics.position), 0.0)
    made = datetime.now(UTC).isoformat(timespec="seconds")
    known = {"known": "the virtual camera's own"}
    tags = filming.fish, filming.target
    return Calibration(lens, hung, *tags, optics.index, made, optics.pool, provenance=known)


# ---- the device ---------------------------------------------------------------------------------


@dataclass(eq=False)
class Newest:
    """The newest frame's bytes, and a condition to wait for it."""

    data: bytes = b""
    number: int = 0
    over: bool = False
    changed: threading.Condition = field(default_factory=threading.Condition)

    def put(self, data: bytes, over: bool = False) -> None:
        """Set a frame, or the end."""
        with self.changed:
            self.data, self.number, self.over = data, self.number + 1, over
            self.changed.notify_all()

    def after(self, number: int) -> tuple[bytes, int] | None:
        """Wait for a frame newer than `number`; None at the end."""
        with self.changed:
            self.changed.wait_for(lambda: self.number > number or self.over)
            return None if self.over else (self.data, self.number)


def packed(image: Picture, number: int, stamp: int) -> bytes:
    """A frame as bytes; `stamp` [ns] is the end of its exposure."""
    rows, columns = image.shape
    return HEADER.pack(MAGIC, number, stamp, columns, rows) + image.tobytes()


def listen(path: Path) -> socket.socket:
    """Open the socket of a camera. Raises BadInput."""
    made = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        made.bind(str(path))
    except OSError as error:
        made.close()
        raise BadInput(f"{path}: {error}; choose a short path that does not exist.") from None
    made.listen()
    return made


def serve(
    listening: socket.socket, filming: Filming, look: Callable[[], Scene], stop: Callable[[], bool]
) -> None:
    """Film what `look` returns until `stop` returns True."""
    newest = Newest()
    threading.Thread(target=_accept, args=(listening, newest), daemon=True).start()
    try:
        _film(filming, newest, look, stop)
    finally:
        newest.put(b"", over=True)
        with contextlib.suppress(OSError):
            listening.shutdown(socket.SHUT_RDWR)
        listening.close()


def _film(
    filming: Filming, newest: Newest, look: Callable[[], Scene], stop: Callable[[], bool]
) -> None:
    made = Renderer(filming.optics, filming.conditions, filming.fish, filming.target, filming.ids,
                    filming.seed)  # fmt: skip
    rng = np.random.default_rng([filming.seed, 1])
    half, period = filming.conditions.exposure / 2, (1 + filming.drift) / filming.rate
    due, number = time.monotonic(), 0
    while not stop():
        number += 1
        middle = time.monotonic()
        image = made.draw(look(), middle)
        leaves = middle + half + filming.readout + filming.jitter * rng.uniform()
        time.sleep(max(leaves - time.monotonic(), 0.0))
        if rng.uniform() >= filming.conditions.dropped:
            newest.put(packed(image, number, filming.clock(middle + half)))
        due = max(due + period, time.monotonic() - period)  # a late camera does not catch up
        time.sleep(max(due - time.monotonic(), 0.0))


def _accept(listening: socket.socket, newest: Newest) -> None:
    with contextlib.suppress(OSError):
        while True:
            client, _ = listening.accept()
            threading.Thread(target=_feed, args=(client, newest), daemon=True).start()


def _feed(client: socket.socket, newest: Newest) -> None:
    """Serve one client: send the newest frame when it has taken the last."""
    number = newest.number
    with contextlib.suppress(OSError), client:
        while (found := newest.after(number)) is not None:
            data, number = found
            client.sendall(data)
