"""The fault table as Markdown."""

from typing import Any

Row = dict[str, Any]


def markdown(rows: list[Row]) -> str:
    """The table as docs/deploy.md has it."""
    head = "| fault | the operator reads | safe state | told after [s] | safe after [s] |"
    lines = [head, "|---|---|---|---|---|"]
    for row in rows:
        state = row["safe state"] if row["ok"] else "**not reached**"
        cells = [row["fault"], row["operator sees"], state]
        times = [row["told_s"], None if row["safe state"] == "run" else row["safe_s"]]
        cells += ["–" if value is None else f"{value:.2f}" for value in times]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"
