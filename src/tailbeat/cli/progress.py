"""Progress with an ETA: bars on a terminal, a line every 30 s in a pipe."""

import math
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Event, Thread
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tailbeat.train.progress import Report, TrainingRow

SHARE_OF_SEARCH = 0.6  # fraction of a seed's time; the polish takes the rest
EVERY, MINUTE = 30.0, 60.0  # s between two lines in a pipe, and between two signs of life


def now_and_then(
    every: float = EVERY, clock: Callable[[], float] = time.monotonic
) -> Callable[..., None]:
    """Print `text`, the fraction done and an ETA to standard error: at once, then `every` so many
    seconds, and when all is done. NaN means that the fraction is not known; a smaller one than
    before begins other work, with a time of its own, unless the work is said to have `grown`."""
    due, began, before = [-math.inf], [clock()], [0.0]

    def report(text: str, done: float = math.nan, grown: bool = False) -> None:
        now = clock()
        if done < before[0] and not grown:
            began[0] = now
        before[0] = done
        if now >= due[0] or done >= 1:
            due[0] = now + every
            print(text + _eta(now - began[0], done), file=sys.stderr, flush=True)

    return report


def _eta(elapsed: float, done: float) -> str:
    if math.isnan(done):
        return ""
    left = f", {_clock(elapsed * (1 - done) / done)} left" if 0 < done < 1 else ""
    return f": {100 * done:.0f} %, {_clock(elapsed)} elapsed{left}"


def _clock(seconds: float) -> str:
    minutes, seconds = divmod(round(seconds), 60)
    return f"{minutes // 60}:{minutes % 60:02d}:{seconds:02d}"


@contextmanager
def search_progress() -> Iterator[Callable[[int, str, float, float], None]]:
    """Progress of a search: seed, stage, fraction of the stage done, best cost so far."""
    if not sys.stderr.isatty():
        lines = now_and_then()
        with _alive():
            yield lambda seed, stage, share, best: lines(
                f"seed {seed} {stage}, cost {best:.2f}", _of_seed(stage, share)
            )
        return
    who = "seed {task.fields[seed]} {task.fields[stage]:>6}"
    with _bars(who, "cost {task.fields[best]:8.2f}") as bars:
        tasks: dict[int, Any] = {}

        def report(seed: int, stage: str, share: float, best: float) -> None:
            if seed not in tasks:
                tasks[seed] = bars.add_task("", total=1.0, seed=seed, stage=stage, best=best)
            done = _of_seed(stage, share)
            bars.update(tasks[seed], completed=done, stage=stage, best=best)

        yield report


@contextmanager
def _alive() -> Iterator[None]:
    """Print a line a minute, whatever the work reports: a first generation takes minutes."""
    began, over = time.monotonic(), Event()

    def tell() -> None:
        while not over.wait(MINUTE):
            said = f"at work: {_clock(time.monotonic() - began)} elapsed"
            print(said, file=sys.stderr, flush=True)

    teller = Thread(target=tell, daemon=True)
    teller.start()
    try:
        yield
    finally:
        over.set()
        teller.join()


def _of_seed(stage: str, share: float) -> float:
    """Fraction of a seed's time that is over after the fraction `share` of a stage."""
    if stage == "draws":  # they come after all seeds
        return share
    first = stage == "search"
    return SHARE_OF_SEARCH * share if first else SHARE_OF_SEARCH + (1 - SHARE_OF_SEARCH) * share


@contextmanager
def counting() -> Iterator[Callable[[str, int, int], None]]:
    """Progress by counting: name of the current part, number done, total number. A part whose
    total grows is the same work as long as its name stays and its number done does not fall."""
    if not sys.stderr.isatty():
        yield _counted(now_and_then())
        return
    with _bars("{task.description:<28}", "{task.completed}/{task.total}") as bars:
        bar = bars.add_task("")
        yield lambda name, done, total: bars.update(
            bar, description=name, completed=done, total=total
        )


def _counted(lines: Callable[[str, float, bool], None]) -> Callable[[str, int, int], None]:
    """Lines of `now_and_then` for the counts of `counting`."""
    before = [("", 0)]

    def report(name: str, done: int, total: int) -> None:
        part, most = before[0]
        before[0] = name, done
        lines(f"{name} {done}/{total}", done / max(total, 1), name == part and done >= most)

    return report


def _bars(before: str, after: str) -> Any:
    """Bars with a text on either side, elapsed time and ETA, on standard error."""
    from rich import progress
    from rich.console import Console

    columns = [
        progress.TextColumn(before),
        progress.BarColumn(),
        progress.TextColumn(after),
        progress.TimeElapsedColumn(),
        progress.TextColumn("left"),
        progress.TimeRemainingColumn(),
    ]
    return progress.Progress(*columns, console=Console(stderr=True))


@contextmanager
def training() -> Iterator["Report"]:
    """Progress of a training: a live table on a terminal, a line every 30 s in a pipe."""
    if not sys.stdout.isatty():
        lines = now_and_then()
        yield lambda row: lines(", ".join(f"{n} {v}" for n, v in _cells(row).items()), math.nan)
        return
    from rich.live import Live

    with Live(refresh_per_second=2) as live:
        yield lambda row: live.update(_course(row))


def _course(row: "TrainingRow") -> Any:
    from rich.table import Table
    from rich.text import Text

    table = Table(title="training", title_justify="left", show_header=False)
    for name, value in _cells(row).items():
        table.add_row(name, Text(value))
    return table


def _polish(row: "TrainingRow") -> str:
    return "" if row.polished is None else f", {100 * row.polished:.0f} % polished"


def _gain(row: "TrainingRow") -> str:
    """The third term: a bonus, or beside a target that keeps moving a loss (`env/reward.py`)."""
    return f"{'nearness and velocity' if row.bonus < 0 else 'bonus'} {row.bonus:.0f}"


def _cells(row: "TrainingRow") -> dict[str, str]:
    eta, awaited = row.promotion_in, "ready in" if row.polished is not None else "promotion in"
    return {
        "time": f"{row.seconds / 60:.1f} min",
        "stage": f"{row.stage} {row.name}" + _polish(row),
        "success": f"{100 * row.success:.0f} %",
        awaited: "-" if eta is None else f"{eta / 60:.1f} min",
        "episode": f"{row.episode_seconds:.1f} s",
        "reward": f"distance {row.distance:.0f} effort {row.effort:.0f} {_gain(row)}",
        "control steps": f"{row.control_steps:,} ({row.steps_per_s:.0f}/s)",
        "updates": f"{row.updates:,} ({row.updates_per_s:.0f}/s)",
        "fish lost": str(row.lost),
    }
