"""A pseudo-terminal as a serial line: the driver's end and ours."""

import os
import tty
from dataclasses import dataclass


@dataclass(frozen=True)
class Line:
    """Both ends of a pseudo-terminal: `master` is ours, `path` is what a driver opens. `slave`
    stays open, because otherwise a driver that closes would end the line."""

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
    """Close a line, as if its cable was unplugged."""
    for end in (line.slave, line.master):
        os.close(end)
