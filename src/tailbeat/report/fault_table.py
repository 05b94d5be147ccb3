"""The fault table as Markdown."""

from typing import Any

from tailbeat.report import tables

Row = dict[str, Any]


def markdown(rows: list[Row]) -> str:
    """The table as docs/deploy.md has it."""
    head = ("fault", "the operator reads", "safe state", "told after [s]", "safe after [s]")
    return tables.markdown(head, [_cells(row) for row in rows]) + "\n"


def _cells(row: Row) -> list[str]:
    state = row["safe state"] if row["ok"] else "**not reached**"
    times = [row["told_s"], None if row["safe state"] == "run" else row["safe_s"]]
    shown = ["–" if value is None else f"{value:.2f}" for value in times]
    return [row["fault"], row["operator sees"], state, *shown]
