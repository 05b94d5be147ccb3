"""A pseudo-terminal as a serial line: the driver's end and ours."""

import os
import tty
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

NAMES = ("servo", "imu")  # of a robot's lines


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


def link_lines(lines: Iterable[Line], folder: Path) -> None:
    """Link a robot's lines to constant names in a folder, as udev does."""
    unlink_lines(folder)
    for name, line in zip(NAMES, lines, strict=True):
        os.symlink(line.path, folder / name)


def unlink_lines(folder: Path, names: Iterable[str] = NAMES) -> None:
    """Take names away before their lines close, as udev does: the next line to open, of whomever,
    gets the same number, and a watchdog that still tries would turn its torque off."""
    for name in names:
        (folder / name).unlink(missing_ok=True)
