"""Read a target's path from a CSV file: columns `x`, `y` [m] in the pool, and perhaps `time` [s].

Names with a unit, as in recordings, are the same: `x_m`, `y_m`, `time_s`. Another column is
refused: it could be a time that is not understood. Lines that begin with # are comments.
"""

import csv
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tailbeat.files import BadInput

Array = NDArray[np.float64]
FEWEST, MOST = 4, 100_000  # points
LARGEST = 1e10  # of any number: beyond, squares of products overflow
UNITS = {"x": "metres", "y": "metres", "time": "seconds"}
NAMES = {"x": "x", "x_m": "x", "y": "y", "y_m": "y", "time": "time", "time_s": "time", "t": "time"}


@dataclass(frozen=True, eq=False)
class FilePath:
    """A path as the file has it: `places` (k, 2) [m], `time` (k,) [s] or None, and the number of
    each point's line in the file."""

    name: str
    places: Array
    time: Array | None
    lines: tuple[int, ...]

    def line(self, point: int) -> str:
        """Where a point stands."""
        return f"{self.name}, line {self.lines[point]}"

    def between(self, point: int) -> str:
        """Where a point and the next one stand."""
        return f"{self.name}, lines {self.lines[point]} and {self.lines[point + 1]}"


def read_path_file(name: str) -> FilePath:
    """Read a path's file; its times rise strictly. Raises BadInput."""
    rows = list(_rows(name))
    if len(rows) < FEWEST:
        raise BadInput(f"{name}: {len(rows)} points; a path needs {FEWEST} or more.")
    if len(rows) > MOST:
        raise BadInput(f"{name}: more than {MOST} points; give fewer.")
    lines, points = zip(*rows, strict=True)
    table = np.array(points, float)
    time = table[:, 2] if table.shape[1] > 2 else None
    found = FilePath(name, table[:, :2], time, lines)
    if time is not None and (bad := np.flatnonzero(np.diff(time) <= 0)).size:
        k = int(bad[0])
        raise BadInput(
            f"{found.between(k)}: time goes from {time[k]:g} to {time[k + 1]:g} s; it must rise"
            f" from line to line."
        )
    return found


def _rows(name: str) -> Iterator[tuple[int, list[float]]]:
    """Number of the line and numbers x, y, and time if there is one, of every point."""
    try:
        with Path(name).open(encoding="utf-8-sig", newline="") as file:
            reader = csv.reader(file)
            head = _head(name, next(_written(reader), []))
            columns = {column: head.index(column) for column in UNITS if column in head}
            for count, words in enumerate(_written(reader)):
                if count > MOST:
                    return
                numbers = [_number(name, reader.line_num, words, *one) for one in columns.items()]
                yield reader.line_num, numbers
    except FileNotFoundError:
        raise BadInput(
            f"--path {name}: no such file; give a CSV file, or circle, figure-eight or square."
        ) from None
    except OSError as error:
        raise BadInput(f"--path {name}: {error.strerror}; give a CSV file.") from None
    except (UnicodeDecodeError, csv.Error, ValueError) as error:
        if isinstance(error, BadInput):
            raise
        raise BadInput(f"--path {name}: not a CSV file; give one with columns x and y.") from None


def _written(reader: Iterator[list[str]]) -> Iterator[list[str]]:
    """Lines that are neither empty nor comments."""
    lines = ([word.strip() for word in words] for words in reader)
    return (words for words in lines if any(words) and not words[0].startswith("#"))


def _head(name: str, words: list[str]) -> list[str]:
    """Names of the columns as in `UNITS`; one may have none. Raises BadInput for a column that is
    missing, unknown or there twice."""
    head = [NAMES.get(word.lower(), word) for word in words]
    for column in ("x", "y"):
        if column not in head:
            found = ", ".join(head)[:80] or "nothing"
            raise BadInput(
                f"{name}: no column {column}; its first line must name the columns x, y and"
                f" perhaps time, but has {found}."
            )
    for column in filter(None, head):
        if column not in UNITS:
            raise BadInput(
                f"{name}: unknown column {column[:40]!r}; allowed are x or x_m, y or y_m, and"
                f" time, time_s or t, so rename it or leave it out."
            )
        if head.count(column) > 1:
            raise BadInput(f"{name}: two columns {column}; leave one out.")
    return head


def _number(name: str, line: int, words: list[str], column: str, place: int) -> float:
    word = words[place] if place < len(words) else ""
    try:
        number = float(word)
    except ValueError:
        number = math.nan
    if not abs(number) <= LARGEST:
        raise BadInput(
            f"{name}, line {line}: {column} is {word[:40]!r}; give a finite number of"
            f" {UNITS[column]}, at most {LARGEST:g} in size."
        )
    return number
