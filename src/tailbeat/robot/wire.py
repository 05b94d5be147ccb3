"""What both serial drivers do with a port: wait for bytes until a moment, without set-up each time.

pyserial sets the whole line up anew whenever a time-out changes, eight calls of the system for one
reply; here it is one `select` and one `read`.
"""

import contextlib
import os
import select
import termios
import time

import serial

GONE = (serial.SerialException, OSError, termios.error)  # what a pulled cable raises


def reopen(port: serial.Serial) -> None:
    """Open a port anew, after its cable was out. Raises one of `GONE`."""
    with contextlib.suppress(*GONE):
        port.close()
    port.open()


def heard(port: serial.Serial, end: float, most: int = 4096) -> bytes:
    """What arrives before `end` [s], monotonic; nothing if nothing does. Raises one of `GONE`."""
    left = end - time.monotonic()
    ready, _, _ = select.select([port.fileno()], [], [], max(left, 0.0))
    if not ready:
        return b""
    data = os.read(port.fileno(), most)
    if not data:
        raise serial.SerialException("the port is ready and gives nothing")
    return data
