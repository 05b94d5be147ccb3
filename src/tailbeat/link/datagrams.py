"""Poses and orders from station to fish: small signed datagrams; only the newest is used.

A pose datagram holds the three newest frames, so that a single lost datagram loses no frame. It is
signed with a shared key (HMAC-SHA256, 16 bytes) and carries a nonce that the fish draws at its
start, so that recordings from before that start are rejected. Every start of a sender has its own
run number. Once another run has replaced it, its datagrams are ignored, so replays of it are
rejected too. Clocks are monotonic and compared by echoes over the same socket; wall clocks are not
used.
"""

import hmac
import math
import secrets
import socket
import stat
import struct
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import IntEnum
from pathlib import Path

from tailbeat.files import BadInput, write_secret
from tailbeat.link.arrival import stamp
from tailbeat.link.clock import DRIFT, SECOND, Clock, Loss
from tailbeat.link.places import POOL, is_pool

KEY_BYTES, MAC_BYTES = 32, 16
POSES, ASK, TELL, ORDER, CAMERA = b"tbP1", b"tbA1", b"tbT2", b"tbO1", b"tbC1"
FRAMES = 3
HEAD = struct.Struct("<4sQQQ")  # kind, sender's run, receiver's nonce, sequence
FRAME = struct.Struct("<QB5f")  # captured [ns], seen flags, fish x, y, yaw, target x, y
ORDERED = struct.Struct("<QB")  # sent [ns of the sender's clock], which order
TIMES = struct.Struct("<QQQ")  # of an echo: asked, received, sent back [ns]
POOL_SIZE = struct.Struct("<2f")  # length, width [m]
NO_CAMERA = bytes(32)  # instead of a calibration's SHA-256
FISH_SEEN, TARGET_SEEN = 1, 2
LENGTHS = {
    POSES: HEAD.size + FRAMES * FRAME.size + MAC_BYTES,
    ASK: HEAD.size + TIMES.size + MAC_BYTES,
    TELL: HEAD.size + TIMES.size + POOL_SIZE.size + MAC_BYTES,
    ORDER: HEAD.size + ORDERED.size + MAC_BYTES,
    CAMERA: HEAD.size + len(NO_CAMERA) + MAC_BYTES,
}
YAW = 1e4  # rad: float32 tells a larger heading to no better than a milliradian
# Share of the pool's length by which a pose may lie beyond a wall: a camera that is turned by 9 deg
# and scales 9 % wrong (three times everyday) puts a corner of the paper's pool 0.6 m outside.
MARGIN = 0.125
ORDER_AGE = 2.0  # s: an older order to arm or to swim is rejected as delayed


class Order(IntEnum):
    """The operator's orders to the fish. DISARM and STOP are accepted however late they arrive."""

    ARM = 1
    SWIM = 2
    DISARM = 3
    STOP = 4


@dataclass(frozen=True)
class Frame:
    """What one camera frame showed.

    `captured` [ns] is on the sender's monotonic clock. Fish x, y [m] and yaw [rad], and target x, y
    [m], are in the pool; None where the tag was not seen.
    """

    captured: int
    fish: tuple[float, float, float] | None
    target: tuple[float, float] | None


# ---- the key ------------------------------------------------------------------------------------


def make_key(path: Path) -> None:
    """Write a new key that only its owner may read. Raises BadInput if the file exists."""
    write_secret(path, secrets.token_bytes(KEY_BYTES))


def read_key(path: Path) -> bytes:
    """Read a key of `make_key`. Raises BadInput if it is missing, has another length, or is
    readable by others."""
    if not path.is_file():
        raise BadInput(f"{path}: no key file there; make one and copy it to both machines.")
    if path.stat().st_mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise BadInput(f"{path}: other users may read this key; chmod 600 it, or make a new one.")
    key = path.read_bytes()
    if len(key) != KEY_BYTES:
        raise BadInput(f"{path}: {len(key)} bytes; a key has {KEY_BYTES}. Make a new one.")
    return key


# ---- datagrams ----------------------------------------------------------------------------------


def sign(key: bytes, body: bytes) -> bytes:
    """The body followed by its signature."""
    return body + hmac.digest(key, body, "sha256")[:MAC_BYTES]


def pose_datagram(key: bytes, run: int, nonce: int, sequence: int, frames: list[Frame]) -> bytes:
    """A signed pose datagram with up to three frames, oldest first; a short list repeats its first
    frame."""
    frames = [frames[0]] * (FRAMES - len(frames)) + frames[-FRAMES:]
    return sign(key, HEAD.pack(POSES, run, nonce, sequence) + b"".join(map(_packed, frames)))


def _packed(frame: Frame) -> bytes:
    seen = FISH_SEEN * (frame.fish is not None) + TARGET_SEEN * (frame.target is not None)
    places = (*(frame.fish or (0.0, 0.0, 0.0)), *(frame.target or (0.0, 0.0)))
    return FRAME.pack(frame.captured, seen, *places)


def _unpacked(body: bytes) -> list[Frame]:
    frames = []
    for captured, seen, x, y, yaw, tx, ty in FRAME.iter_unpack(body):
        fish = (x, y, yaw) if seen & FISH_SEEN else None
        frames.append(Frame(captured, fish, (tx, ty) if seen & TARGET_SEEN else None))
    return frames


def ask_datagram(key: bytes, nonce: int, sequence: int, now: int) -> bytes:
    """The fish's request for the sender's clock; it also tells the sender the fish's nonce."""
    return sign(key, HEAD.pack(ASK, 0, nonce, sequence) + TIMES.pack(now, 0, 0))


def tell_datagram(
    key: bytes, run: int, asked: bytes, received: int, sent: int, pool: tuple[float, float] = POOL
) -> bytes | None:
    """The sender's answer to a clock request: its clock's times [ns] and the length and width of
    the pool [m]. None if the request is not signed with this key."""
    if not is_signed(key, asked, ASK, LENGTHS[ASK]):
        return None
    _, _, nonce, sequence = HEAD.unpack_from(asked)
    began = TIMES.unpack_from(asked, HEAD.size)[0]
    times = TIMES.pack(began, received, sent) + POOL_SIZE.pack(*pool)
    return sign(key, HEAD.pack(TELL, run, nonce, sequence) + times)


def camera_datagram(key: bytes, run: int, nonce: int, sequence: int, calibration: bytes) -> bytes:
    """The SHA-256 of the calibration of the sender's camera, or `NO_CAMERA`; the fish logs it."""
    return sign(key, HEAD.pack(CAMERA, run, nonce, sequence) + calibration)


def order_datagram(key: bytes, run: int, nonce: int, number: int, order: Order, sent: int) -> bytes:
    """A signed order, sent at `sent` [ns] of the sender's clock. A repeated order keeps its
    number."""
    return sign(key, HEAD.pack(ORDER, run, nonce, number) + ORDERED.pack(sent, order))


def stop_datagram(key: bytes, run: int, nonce: int, number: int) -> bytes:
    """A signed order to stop."""
    return order_datagram(key, run, nonce, number, Order.STOP, 0)


def is_signed(key: bytes, data: bytes, kind: bytes, length: int) -> bool:
    """Whether a datagram is of this kind and length, and signed with this key."""
    if len(data) != length or data[:4] != kind:
        return False
    own = hmac.digest(key, data[:-MAC_BYTES], "sha256")[:MAC_BYTES]
    return hmac.compare_digest(own, data[-MAC_BYTES:])


# ---- the fish's end -----------------------------------------------------------------------------


@dataclass(eq=False)
class Receiver:
    """The fish's end: checks datagrams and keeps the newest frames.

    `room` (length, width) [m] is sent by the station; poses must lie inside it or little beyond,
    with the origin in the middle of the pool. `far` [m] is the place of the last one that did not,
    None once one does. `calibration` is the SHA-256 of the sender's calibration, None until it
    tells it. `rejected` counts rejected datagrams by reason. `orders` are those that the loop has
    not yet taken. `run` is the sender's run, 0 before the first. `ordered` is the number of the
    newest order of each run.
    """

    key: bytes
    room: tuple[float, float] = POOL
    nonce: int = field(default_factory=lambda: secrets.randbits(64))
    clock: Clock = field(default_factory=Clock)
    loss: Loss = field(default_factory=Loss)
    calibration: bytes | None = None
    frames: list[Frame] = field(default_factory=list)  # newest first, on the sender's clock
    orders: list[Order] = field(default_factory=list)  # oldest first
    rejected: Counter[str] = field(default_factory=Counter)
    accepted: int = 0
    far: tuple[float, float] | None = None
    run: int = 0
    followed: set[int] = field(default_factory=set)  # runs that another run has replaced
    last: int = -1  # sequence of the newest poses
    told: int = -1  # sequence of the last echo
    ordered: dict[int, int] = field(default_factory=dict)

    def take(self, data: bytes, now: int, waited: int = 0) -> None:
        """Handle one datagram at `now` [ns], which arrived `waited` [ns] before. Never raises,
        whatever it contains."""
        kind = data[:4]
        if kind not in (POSES, TELL, ORDER, CAMERA) or len(data) != LENGTHS[kind]:
            self.rejected["not ours"] += 1
        elif not is_signed(self.key, data, kind, LENGTHS[kind]):
            self.rejected["signature"] += 1
        else:
            _, run, nonce, sequence = HEAD.unpack_from(data)
            if nonce != self.nonce:
                self.rejected["another start's"] += 1
            elif kind == ORDER:
                self._order(data, run, sequence, now)
            elif run in self.followed:
                self.rejected["old"] += 1
            elif kind == TELL:
                self._echo(data, run, sequence, now - waited)
            elif kind == CAMERA:
                self._camera(data, run)
            else:
                self._poses(data, run, sequence)

    @property
    def stopped(self) -> bool:
        """Whether an order to stop is among the orders not yet taken."""
        return Order.STOP in self.orders

    def take_orders(self) -> list[Order]:
        """Return the orders not yet taken, oldest first, and clear the list."""
        taken, self.orders = self.orders, []
        return taken

    def _follow(self, run: int) -> None:
        """Switch to a sender's new run: its clock may be another machine's."""
        if run != self.run:
            self.followed |= {self.run}
            self.run, self.last = run, -1
            self.frames, self.clock, self.loss = [], Clock(), Loss()
            self.calibration = None

    def _echo(self, data: bytes, run: int, sequence: int, now: int) -> None:
        asked, received, sent = TIMES.unpack_from(data, HEAD.size)
        if sequence <= self.told or not (asked <= now and received <= sent):
            self.rejected["old"] += 1
            return
        pool = POOL_SIZE.unpack_from(data, HEAD.size + TIMES.size)
        whole = (now - asked) * (1 + DRIFT)  # a longer stay at the sender would give a false offset
        if sent - received > whole or not is_pool(*pool):
            self.rejected["implausible"] += 1
            return
        self._follow(run)
        self.told, self.room = sequence, pool
        self.clock.add(asked, received, sent, now)

    def _camera(self, data: bytes, run: int) -> None:
        if run == self.run:
            self.calibration = data[HEAD.size : -MAC_BYTES]
        else:
            self.rejected["old"] += 1

    def _order(self, data: bytes, run: int, number: int, now: int) -> None:
        """STOP is accepted from any run; all other orders only from the current run."""
        sent, which = ORDERED.unpack_from(data, HEAD.size)
        newest = self.ordered.get(run, 0)
        if number == newest:
            return  # a repetition
        if which not in tuple(Order):
            self.rejected["implausible"] += 1
        elif number < newest or (which != Order.STOP and run != self.run):
            self.rejected["old"] += 1
        elif which in (Order.ARM, Order.SWIM) and self._late(sent, now):
            self.rejected["late"] += 1
        else:
            self.ordered[run] = number
            self.orders.append(Order(which))

    def _late(self, sent: int, now: int) -> bool:
        """Whether an order was delayed. While the clocks are not compared, nothing is late; see
        `safety`."""
        offset = self.clock.offset(now)
        return offset is not None and abs(now - (sent - offset[0])) > ORDER_AGE * SECOND

    def _poses(self, data: bytes, run: int, sequence: int) -> None:
        if run == self.run and sequence <= self.last:
            self.rejected["old"] += 1
            return
        frames = _unpacked(data[HEAD.size : -MAC_BYTES])
        if not all(map(_plausible, frames)):
            self.rejected["implausible"] += 1
            return
        if far := [place for frame in frames for place in _places(frame) if self._far(place)]:
            self.rejected["outside the pool"] += 1
            self.far = far[-1]
            return
        self._follow(run)
        if self.frames and frames[-1].captured < self.frames[0].captured:
            self.rejected["time runs backwards"] += 1
            return
        self.last, self.accepted, self.far = sequence, self.accepted + 1, None
        self.loss.add(sequence)
        self.frames = frames[::-1]

    def _far(self, place: tuple[float, float]) -> bool:
        """Whether a place lies farther beyond the pool's walls than a camera could err."""
        margin = MARGIN * max(self.room)
        return any(abs(x) > side / 2 + margin for x, side in zip(place, self.room, strict=True))

    def age(self, frame: Frame, now: int) -> float | None:
        """Age of a frame [s], or None while the clocks are not compared."""
        offset = self.clock.offset(now)
        return None if offset is None else (now - (frame.captured - offset[0])) / SECOND


def _places(frame: Frame) -> list[tuple[float, float]]:
    return [place for place in (frame.fish and frame.fish[:2], frame.target) if place]


def _plausible(frame: Frame) -> bool:
    numbers = [*(frame.fish or ()), *(frame.target or ())]
    turned = abs(frame.fish[2]) <= YAW if frame.fish else True
    return all(map(math.isfinite, numbers)) and turned


# ---- sockets ------------------------------------------------------------------------------------


def bind(host: str, port: int) -> socket.socket:
    """Open a non-blocking datagram socket on one address. Raises BadInput."""
    if host in ("", "0.0.0.0"):
        raise BadInput(f"link address {host!r}: this means all networks; give the address of one.")
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.setblocking(False)
    stamp(made)
    try:
        made.bind((host, port))
    except OSError as error:
        made.close()
        raise BadInput(
            f"{host}:{port}: {error.strerror}; choose another address or port."
        ) from None
    return made


def free_address() -> tuple[str, int]:
    """A free address on this machine: host and port."""
    with bind("127.0.0.1", 0) as probe:
        host, port = probe.getsockname()
    return host, port


def drain(made: socket.socket, most: int = 1000) -> Iterator[tuple[bytes, tuple[str, int]]]:
    """Read the datagrams that have arrived, oldest first, at most `most`."""
    for _ in range(most):
        try:
            yield made.recvfrom(2048)
        except (BlockingIOError, ConnectionRefusedError):
            return
