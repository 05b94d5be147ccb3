"""Reading bytes until a deadline, for both serial drivers.

pyserial configures the whole line again whenever a time-out changes, eight system calls for one
reply. Here it is one `select` and one `read`.
"""

import contextlib
import os
import select
import termios
import time

import serial

GONE = (serial.SerialException, OSError, termios.error)  # raised when the cable is unplugged


def reopen(port: serial.Serial) -> None:
    """Open a port again after its cable was unplugged. Raises one of `GONE`."""
    with contextlib.suppress(*GONE):
        port.close()
    port.open()


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
