"""When a datagram arrived, by the kernel's stamp.

The fish's loop reads its socket once in 20 ms. An echo of the station's clock lies there until
then, and would shift the clock by half of that time.
"""

import socket
import struct
import time
from collections.abc import Iterator

from tailbeat.link.clock import SECOND

STAMPED = 35  # SO_TIMESTAMPNS of Linux, which Python does not name
STAMP = struct.Struct("@ll")  # s, ns
ROOM = socket.CMSG_SPACE(STAMP.size)


def stamp(made: socket.socket) -> None:
    """Have the kernel stamp what a socket receives. Elsewhere than on Linux nothing changes."""
    try:
        made.setsockopt(socket.SOL_SOCKET, STAMPED, 1)
    except OSError:
        return


def arrived(made: socket.socket, most: int = 1000) -> Iterator[tuple[bytes, int]]:
    """Read the datagrams that have arrived, oldest first, at most `most`, and how long [ns] each of
    them waited; 0 without a stamp."""
    for _ in range(most):
        try:
            data, notes, _, _ = made.recvmsg(2048, ROOM)
        except (BlockingIOError, ConnectionRefusedError):
            return
        stamps = [STAMP.unpack(held) for *kind, held in notes if _is_stamp(kind, held)]
        seconds, rest = stamps[0] if stamps else (0, 0)
        yield data, max(time.time_ns() - seconds * SECOND - rest, 0) if stamps else 0


def _is_stamp(kind: list[int], held: bytes) -> bool:
    return kind == [socket.SOL_SOCKET, STAMPED] and len(held) == STAMP.size
