"""Fit a table to the terminal: as it is, transposed, or split. Nothing is printed here."""

from typing import Any

from tailbeat.report.tables import as_cell

Row = dict[str, Any]  # a cell by its column's name
PROSE = 24  # characters at which a column of text may wrap; a number never wraps


def fitted(rows: list[Row], width: int) -> list[list[Row]]:
    """The tables that show `rows` in `width` characters without cutting a cell. A single row is
    transposed: it is easier to read downwards. A table that is too wide is transposed if it then
    fits, else it is split into tables that all begin with the first column."""
    if len(rows) == 1 and len(rows[0]) > 1:
        rows = [{"": name, "value": value} for name, value in rows[0].items()]
    if needed(rows) <= width:
        return [rows]
    if len(turned := _turned(rows)) and needed(turned) <= width:
        return [turned]
    return _split(rows, width)


def needed(rows: list[Row]) -> int:
    """Smallest width of a table of `rows`, with its frame [characters]."""
    return 1 + sum(3 + least_width(rows, name) for name in rows[0])


def least_width(rows: list[Row], name: str) -> int:
    """Smallest width of a column [characters]: numbers never wrap, text wraps at `PROSE`."""
    widest = max(len(name), *(len(as_cell(row.get(name))) for row in rows))
    return widest if is_numeric(rows, name) else min(widest, PROSE)


def is_numeric(rows: list[Row], name: str) -> bool:
    """Whether a column holds only numbers."""
    return all(isinstance(row.get(name), int | float | None) for row in rows)


def _turned(rows: list[Row]) -> list[Row]:
    """Columns as rows; empty where the first column does not name its rows."""
    first, *others = rows[0]
    heads = [as_cell(row[first]) for row in rows]
    if len(set(heads)) < len(heads) or first in heads:
        return []
    cells = zip(heads, rows, strict=True)
    by_head = dict(cells)
    return [{first: name, **{head: by_head[head].get(name) for head in heads}} for name in others]


def _split(rows: list[Row], width: int) -> list[list[Row]]:
    """Tables of as many columns as fit beside the first."""
    first, *others = rows[0]
    parts: list[list[str]] = [[first]]
    for name in others:
        if len(parts[-1]) > 1 and needed(_only(rows, [*parts[-1], name])) > width:
            parts.append([first])
        parts[-1].append(name)
    return [_only(rows, names) for names in parts]


def _only(rows: list[Row], names: list[str]) -> list[Row]:
    return [{name: row.get(name) for name in names} for row in rows]
