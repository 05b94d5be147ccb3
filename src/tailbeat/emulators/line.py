"""A pseudo-terminal as a serial line: what a driver opens, and our end of it."""

import os
import tty
from dataclasses import dataclass


@dataclass(frozen=True)
class Line:
    """Both ends of a pseudo-terminal: `master` is ours, `path` what a driver opens. The slave end
    is kept open: a driver that closes would else end the line."""

    master: int
    slave: int
    path: str


def open_line() -> Line:
    """A raw line, no echo."""
    master, slave = os.openpty()
    tty.setraw(master)
    tty.setraw(slave)
    return Line(master, slave, os.ttyname(slave))


def close_line(line: Line) -> None:
    """As if the cable was pulled."""
    for end in (line.slave, line.master):
        os.close(end)
