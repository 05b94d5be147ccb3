"""List glitches on the terminal: a line for every recording, column and kind."""

from typing import Any

SHOWN = 5  # times that a line names


def sentences(rows: list[dict[str, Any]]) -> list[str]:
    """A line for every recording, column and kind, with the first times [s] only."""
    return [_line(row) for row in rows if row["kind"] != "gap"]  # a camera has gaps every second


def _line(row: dict[str, Any]) -> str:
    times = ", ".join(f"{time:.2f}" for time in row["times"][:SHOWN])
    more = ", …" if row["count"] > SHOWN else ""
    return (
        f"{row['recording']}: {row['count']} samples of {row['column']} left out ({row['kind']})"
        f" at {times}{more} s"
    )
