"""What the terminal shows: lines, tables, progress with an ETA, one-line complaints."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.live import Live
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

# A pipe has no width: wide enough that no number is cut.
OUT = Console(width=None if sys.stdout.isatty() else 140)
ERRORS = Console(stderr=True)
SHARE_OF_SEARCH = 0.6  # of a seed's time; the polish takes the rest


def say(text: str) -> None:
    """One line."""
    OUT.print(text, highlight=False, soft_wrap=True)


def complain(text: str) -> None:
    """One line to standard error."""
    ERRORS.print(f"tailbeat: {text}", style="red", highlight=False, soft_wrap=True, markup=False)


def tables(rows_by_title: dict[str, list[dict[str, Any]]]) -> None:
    """One table per title; an empty one is left out."""
    for title, rows in rows_by_title.items():
        if len(rows) == 1:  # a single wide row reads better downwards
            rows = [{"": name, "value": value} for name, value in rows[0].items()]
        if rows:
            OUT.print(_table(title, rows))


def _table(title: str, rows: list[dict[str, Any]]) -> Table:
    table = Table(title=escape(title), title_justify="left", header_style="bold")
    for name in rows[0]:
        numeric = all(isinstance(row.get(name), int | float | None) for row in rows)
        table.add_column(escape(name), justify="right" if numeric else "left")
    for row in rows:
        table.add_row(*(_cell(row.get(name)) for name in rows[0]))
    return table


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, list | tuple):
        return " … ".join(_cell(item) for item in value)
    return str(value)


@contextmanager
def search_progress() -> Iterator[Callable[[int, str, float, float], None]]:
    """A bar per seed with best cost, elapsed time and ETA."""
    columns = [
        TextColumn("seed {task.fields[seed]} {task.fields[stage]:>6}"),
        BarColumn(),
        TextColumn("cost {task.fields[best]:8.2f}"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    ]
    bars: dict[int, Any] = {}
    with Progress(*columns, console=ERRORS) as progress:

        def report(seed: int, stage: str, share: float, best: float) -> None:
            if seed not in bars:
                bars[seed] = progress.add_task("", total=1.0, seed=seed, stage=stage, best=best)
            first = stage == "search"
            done = SHARE_OF_SEARCH * share if first else SHARE_OF_SEARCH + 0.4 * share
            progress.update(bars[seed], completed=done, stage=stage, best=best)

        yield report


@contextmanager
def counting() -> Iterator[Callable[[str, int, int], None]]:
    """A bar over all swims, with the arm at hand, elapsed time and ETA."""
    columns = [
        TextColumn("{task.description:<28}"),
        BarColumn(),
        TextColumn("{task.completed}/{task.total}"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    ]
    with Progress(*columns, console=ERRORS) as progress:
        bar = progress.add_task("")
        yield lambda name, done, total: progress.update(
            bar, description=name, completed=done, total=total
        )


@contextmanager
def training() -> Iterator[Callable[[dict[str, Any]], None]]:
    """A table that follows a training on a terminal; in a pipe a line every half minute."""
    if not OUT.is_terminal:
        yield _line_now_and_then()
        return
    with Live(console=OUT, refresh_per_second=2) as live:
        yield lambda row: live.update(_course(row))


def _line_now_and_then(every: float = 30.0) -> Callable[[dict[str, Any]], None]:
    due = [0.0]

    def report(row: dict[str, Any]) -> None:
        if row["seconds"] >= due[0]:
            due[0] = row["seconds"] + every
            cells = [f"{name} {value}" for name, value in _cells(row).items()]
            print(", ".join(cells), flush=True)

    return report


def _course(row: dict[str, Any]) -> Table:
    table = Table(title="training", title_justify="left", show_header=False)
    for name, value in _cells(row).items():
        table.add_row(name, escape(value))
    return table


def _cells(row: dict[str, Any]) -> dict[str, str]:
    eta = row["promotion_in"]
    return {
        "time": f"{row['seconds'] / 60:.1f} min",
        "stage": f"{row['stage']} {row['name']}",
        "success": f"{100 * row['success']:.0f} %",
        "promotion in": "-" if eta is None else f"{eta / 60:.1f} min",
        "episode": f"{row['episode_seconds']:.1f} s",
        "reward": " ".join(f"{name} {row[name]:.0f}" for name in ("distance", "effort", "bonus")),
        "control steps": f"{row['control_steps']:,} ({row['steps_per_s']:.0f}/s)",
        "updates": f"{row['updates']:,} ({row['updates_per_s']:.0f}/s)",
        "fish lost": str(row["lost"]),
    }
