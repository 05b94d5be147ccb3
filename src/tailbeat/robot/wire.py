"""Writing bytes, and reading them until a deadline, for all serial drivers.

pyserial configures the whole line again whenever a time-out changes, eight system calls for one
reply. Here it is one `select` and one `read`. After a write it looks at the clock, and takes a
process that stood still for a cable that is out; here a write fails if the line takes nothing.
"""

import contextlib
import os
import select
import termios
import time
from collections.abc import Iterator
from typing import Protocol, TypeVar

import serial

from tailbeat.files import BadInput

P = TypeVar("P")  # a packet
WRITING = 0.1  # s in which a line must take bytes
GONE = (serial.SerialException, OSError, termios.error)  # raised when the cable is unplugged


class Feeding(Protocol[P]):
    """A parser: `held` are bytes of an unfinished packet."""

    held: bytearray

    def feed(self, data: bytes) -> list[P]:
        """Packets that `data` completes."""


def open_port(path: str, baud: int, deadline: float) -> serial.Serial:
    """Open a servo's port for this process alone; `deadline` [s] is for a read. Raises BadInput."""
    try:
        port = serial.Serial(path, baud, timeout=deadline, exclusive=True)
    except (serial.SerialException, OSError, ValueError) as error:
        raise BadInput(
            f"{path}: {error}; give the servo's port, closed in other programs."
        ) from None
    hurry(port)
    return port


def hurry(port: serial.Serial) -> None:
    """Ask the adapter to pass on bytes at once: many wait 16 ms for more. A pty cannot."""
    with contextlib.suppress(ValueError, OSError, NotImplementedError):
        port.set_low_latency_mode(True)


def reopen(port: serial.Serial) -> None:
    """Open a port again after its cable was unplugged. Raises one of `GONE`."""
    with contextlib.suppress(*GONE):
        port.close()
    port.open()
    hurry(port)


def send(port: serial.Serial, data: bytes) -> None:
    """Write all bytes. Raises one of `GONE`, if for 0.1 s the line takes none."""
    while data:
        _, ready, _ = select.select([], [port.fileno()], [], WRITING)
        if not ready:
            raise serial.SerialTimeoutException(f"the line took no bytes for {WRITING:g} s")
        data = data[os.write(port.fileno(), data) :]


def heard(port: serial.Serial, end: float, most: int = 4096) -> bytes:
    """Read what arrives before `end` [s], monotonic; b"" if nothing does. Raises one of `GONE`."""
    left = end - time.monotonic()
    ready, _, _ = select.select([port.fileno()], [], [], max(left, 0.0))
    if not ready:
        return b""
    data = os.read(port.fileno(), most)
    if not data:
        raise serial.SerialException("the port reports data but gives none")
    return data


def replies(port: serial.Serial, sent: bytes, parser: Feeding[P], deadline: float) -> Iterator[P]:
    """Send a request and yield the packets that come within `deadline` [s]. What came before is
    dropped, because it may be a late reply to an earlier request. Raises one of `GONE`."""
    port.reset_input_buffer()
    parser.held.clear()
    send(port, sent)
    end = time.monotonic() + deadline
    while time.monotonic() < end and (data := heard(port, end)):
        yield from parser.feed(data)
