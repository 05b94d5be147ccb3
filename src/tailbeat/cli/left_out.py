"""What the terminal says about glitches: a line for every recording, column and kind."""

from typing import Any

SHOWN = 5  # times that a line names


def sentences(rows: list[dict[str, Any]]) -> list[str]:
    """A line of the terminal for every recording, column and kind; the first times alone."""
    return [
        f"{row['recording']}: {_said(row)} at {', '.join(f'{t:.2f}' for t in row['times'][:SHOWN])}"
        f"{', …' if row['count'] > SHOWN else ''} s"
        for row in rows
    ]


def _said(row: dict[str, Any]) -> str:
    if row["kind"] == "gap":
        return f"frames are missing in {row['count']} places, after the samples"
    return f"{row['count']} samples of {row['column']} left out ({row['kind']})"
