"""Poses from laptop to fish: small signed datagrams, the newest wins, strangers are counted.

A pose datagram holds the three newest frames, so one lost costs nothing; it is signed with a shared
key (HMAC-SHA256, 16 bytes) and carries the fish's own nonce, drawn at its start, so that nothing
recorded earlier is taken. Clocks are monotonic and compared by echoes in the same socket; wall
clocks are never asked.
"""

import hmac
import math
import secrets
import socket
import stat
import struct
from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from tailbeat.files import BadInput, new_file

KEY_BYTES, MAC_BYTES = 32, 16
POSES, ASK, TELL, STOP = b"tbP1", b"tbA1", b"tbT1", b"tbS1"
FRAMES = 3
HEAD = struct.Struct("<4sQQQ")  # kind, sender's run, receiver's nonce, sequence
FRAME = struct.Struct("<QB5f")  # captured [ns], what was seen, fish x, y, yaw, target x, y
TIMES = struct.Struct("<QQQ")  # of an echo: asked, received, sent back [ns]
FISH_SEEN, TARGET_SEEN = 1, 2
LENGTHS = {
    POSES: HEAD.size + FRAMES * FRAME.size + MAC_BYTES,
    ASK: HEAD.size + TIMES.size + MAC_BYTES,
    TELL: HEAD.size + TIMES.size + MAC_BYTES,
    STOP: HEAD.size + MAC_BYTES,
}
SECOND = 1_000_000_000  # ns
OFFSET_MEMORY = 20 * SECOND
DRIFT = 50e-6  # of two quartz clocks, largest


@dataclass(frozen=True)
class Frame:
    """What one camera frame showed: `captured` [ns] of the sender's monotonic clock; fish x, y [m],
    yaw [rad] and target x, y [m] in the pool, None where the tag was not seen."""

    captured: int
    fish: tuple[float, float, float] | None
    target: tuple[float, float] | None


# ---- the key ------------------------------------------------------------------------------------


def make_key(path: Path) -> None:
    """Write a new key that only its owner may read. Raises BadInput if the file exists."""
    with new_file(path) as beside:
        beside.write_bytes(secrets.token_bytes(KEY_BYTES))
        beside.chmod(0o600)


def read_key(path: Path) -> bytes:
    """A key of `make_key`. Raises BadInput if it is missing, short, or open to others."""
    if not path.is_file():
        raise BadInput(f"{path}: no key; make one and copy it to both machines.")
    if path.stat().st_mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise BadInput(f"{path}: others may read this key; chmod 600 it, or make a new one.")
    key = path.read_bytes()
    if len(key) != KEY_BYTES:
        raise BadInput(f"{path}: {len(key)} bytes; a key has {KEY_BYTES}. Make a new one.")
    return key


# ---- datagrams ----------------------------------------------------------------------------------


def sign(key: bytes, body: bytes) -> bytes:
    """The body with its signature behind it."""
    return body + hmac.digest(key, body, "sha256")[:MAC_BYTES]


def pose_datagram(key: bytes, run: int, nonce: int, sequence: int, frames: list[Frame]) -> bytes:
    """Up to three frames, oldest first; a short list repeats its first."""
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
    """The fish's question for the sender's clock; it also tells the sender the nonce."""
    return sign(key, HEAD.pack(ASK, 0, nonce, sequence) + TIMES.pack(now, 0, 0))


def tell_datagram(key: bytes, run: int, asked: bytes, received: int, sent: int) -> bytes | None:
    """The sender's answer to a question, None if it is not a signed one."""
    if not _signed(key, asked, ASK):
        return None
    _, _, nonce, sequence = HEAD.unpack_from(asked)
    began = TIMES.unpack_from(asked, HEAD.size)[0]
    return sign(key, HEAD.pack(TELL, run, nonce, sequence) + TIMES.pack(began, received, sent))


def stop_datagram(key: bytes, run: int, nonce: int, sequence: int) -> bytes:
    """The order to stop."""
    return sign(key, HEAD.pack(STOP, run, nonce, sequence))


def _signed(key: bytes, data: bytes, kind: bytes) -> bool:
    if len(data) != LENGTHS[kind] or data[:4] != kind:
        return False
    own = hmac.digest(key, data[:-MAC_BYTES], "sha256")[:MAC_BYTES]
    return hmac.compare_digest(own, data[-MAC_BYTES:])


# ---- the fish's end -----------------------------------------------------------------------------


@dataclass(eq=False)
class Clock:
    """Sender's clock less ours, from echoes; the one with the shortest way counts."""

    echoes: deque[tuple[int, int, int]] = field(default_factory=deque)  # when, offset, round trip

    def add(self, asked: int, received: int, sent: int, now: int) -> None:
        """One echo [ns]: asked and heard on our clock, received and sent on theirs."""
        offset = ((received - asked) + (sent - now)) // 2
        self.echoes.append((now, offset, (now - asked) - (sent - received)))
        while now - self.echoes[0][0] > OFFSET_MEMORY:
            self.echoes.popleft()

    def offset(self, now: int) -> tuple[int, int] | None:
        """Offset and how far it may be off [ns], or None before the first echo."""
        if not self.echoes:
            return None
        when, offset, trip = min(self.echoes, key=lambda echo: echo[2])
        return offset, trip // 2 + round(DRIFT * abs(now - when))


@dataclass(eq=False)
class Receiver:
    """Takes datagrams and keeps the newest frames. `room` (length, width) [m] bounds poses about
    the pool's middle; `rejected` counts what was dropped, by reason; `stopped` latches."""

    key: bytes
    room: tuple[float, float]
    nonce: int = field(default_factory=lambda: secrets.randbits(64))
    clock: Clock = field(default_factory=Clock)
    frames: list[Frame] = field(default_factory=list)  # newest first, of the sender's clock
    rejected: Counter[str] = field(default_factory=Counter)
    accepted: int = 0
    last: tuple[int, int] = (0, -1)  # the sender's run and its sequence
    told: int = -1  # sequence of the last echo
    stopped: bool = False

    def take(self, data: bytes, now: int) -> None:
        """One datagram, heard at `now` [ns]; never raises, whatever it holds."""
        kind = data[:4]
        if kind not in (POSES, TELL, STOP) or len(data) != LENGTHS[kind]:
            self.rejected["not ours"] += 1
        elif not _signed(self.key, data, kind):
            self.rejected["signature"] += 1
        else:
            _, run, nonce, sequence = HEAD.unpack_from(data)
            if nonce != self.nonce:
                self.rejected["another start's"] += 1
            elif kind == STOP:
                self.stopped = True
            elif kind == TELL:
                self._echo(data, sequence, now)
            else:
                self._poses(data, run, sequence)

    def _echo(self, data: bytes, sequence: int, now: int) -> None:
        asked, received, sent = TIMES.unpack_from(data, HEAD.size)
        if sequence <= self.told or not (asked <= now and received <= sent):
            self.rejected["old"] += 1
            return
        self.told = sequence
        self.clock.add(asked, received, sent, now)

    def _poses(self, data: bytes, run: int, sequence: int) -> None:
        if run == self.last[0] and sequence <= self.last[1]:
            self.rejected["old"] += 1
            return
        frames = _unpacked(data[HEAD.size : -MAC_BYTES])
        if not all(map(self._plausible, frames)):
            self.rejected["implausible"] += 1
            return
        newest = self.frames[0].captured if self.frames and run == self.last[0] else -1
        if frames[-1].captured < newest:
            self.rejected["time runs backwards"] += 1
            return
        self.last, self.accepted = (run, sequence), self.accepted + 1
        self.frames = frames[::-1]

    def _plausible(self, frame: Frame) -> bool:
        places = [frame.fish[:2]] if frame.fish else []
        places += [frame.target] if frame.target else []
        numbers = [*(frame.fish or ()), *(frame.target or ())]
        inside = all(abs(x) <= self.room[0] / 2 and abs(y) <= self.room[1] / 2 for x, y in places)
        return all(map(math.isfinite, numbers)) and inside

    def age(self, frame: Frame, now: int) -> float | None:
        """Seconds since a frame was captured, or None while the clocks are not compared."""
        offset = self.clock.offset(now)
        return None if offset is None else (now - (frame.captured - offset[0])) / SECOND


# ---- sockets ------------------------------------------------------------------------------------


def bind(host: str, port: int) -> socket.socket:
    """A datagram socket on a chosen address, never waiting. Raises BadInput."""
    if host in ("", "0.0.0.0"):
        raise BadInput("link: give the address of one network, not all of them.")
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.setblocking(False)
    try:
        made.bind((host, port))
    except OSError as error:
        made.close()
        raise BadInput(
            f"{host}:{port}: {error.strerror}; choose another address or port."
        ) from None
    return made


def drain(made: socket.socket, most: int = 1000) -> Iterator[tuple[bytes, tuple[str, int]]]:
    """What has arrived, oldest first, at most so many."""
    for _ in range(most):
        try:
            yield made.recvfrom(2048)
        except (BlockingIOError, ConnectionRefusedError):
            return
