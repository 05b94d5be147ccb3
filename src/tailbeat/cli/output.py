"""Print lines, tables and one-line errors to the terminal."""

import sys
from collections.abc import Iterable
from shutil import get_terminal_size
from typing import Any

from tailbeat.cli.layout import Row, fitted, is_numeric, least_width
from tailbeat.report.tables import as_cell

LONGEST = 1200  # characters of a complaint; a path has some hundred
PIPE_WIDTH = 140  # characters, where output goes to a pipe: wide enough for most tables


def say(text: str) -> None:
    """Print one line."""
    print(text, flush=True)


def warn(sentences: Iterable[str]) -> None:
    """Print warnings, one on a line."""
    for one in sentences:
        say(f"warning: {one}")


def complain(text: str) -> None:
    """Print one line to standard error, red on a terminal. A line's end or another control
    character in it, as of a file's name, is shown by its code.
    The middle of a long line, as of a damaged table's cell, is left out."""
    shown = "".join(one if one.isprintable() else ascii(one)[1:-1] for one in text)
    if len(shown) > LONGEST:
        shown = f"{shown[: LONGEST // 2]} ... {shown[-LONGEST // 2 :]}"
    line = f"tailbeat: {shown}"
    print(f"\033[31m{line}\033[0m" if sys.stderr.isatty() else line, file=sys.stderr, flush=True)


def tables(rows_by_title: dict[str, list[Row]]) -> None:
    """Print one table per title, transposed or split if the terminal is too narrow. A title without
    rows is left out. No cell is cut, and units in brackets are shown."""
    from rich.console import Console
    from rich.text import Text

    width = get_terminal_size((PIPE_WIDTH, 24)).columns
    console = Console(width=width)
    for title, rows in rows_by_title.items():
        if rows:
            console.print(Text(title, style="italic"))
            for part in fitted(rows, width):
                console.print(_table(part))


def _table(rows: list[Row]) -> Any:
    from rich.table import Table
    from rich.text import Text

    table = Table(header_style="bold")
    for name in rows[0]:
        justify: Any = "right" if is_numeric(rows, name) else "left"
        least = least_width(rows, name)
        table.add_column(Text(name), justify=justify, min_width=least, overflow="fold")
    for row in rows:
        table.add_row(*(Text(as_cell(row.get(name))) for name in rows[0]))
    return table
