"""Tables: values as cells, records as rows, rows as Markdown."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any


def as_cell(value: Any, digits: int = 4) -> str:
    """A value as a cell; None is a dash."""
    if value is None:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.{digits}g}"
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {as_cell(one, digits)}" for name, one in value.items())
    if isinstance(value, list | tuple):
        return " … ".join(as_cell(one, digits) for one in value)
    return str(value)


def as_rows(records: Iterable[Any], *left_out: str) -> list[dict[str, Any]]:
    """Dataclass records as rows by field name, without the fields `left_out`."""
    return [{k: v for k, v in vars(one).items() if k not in left_out} for one in records]


def percent(rate: float, interval: Sequence[float]) -> str:
    """A success rate with its interval (low, high), in percent without the sign."""
    return f"{100 * rate:.1f} ({100 * interval[0]:.1f} … {100 * interval[1]:.1f})"


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table."""
    rule = "|" + "---|" * len(head)
    return "\n".join([f"| {' | '.join(head)} |", rule, *(f"| {' | '.join(r)} |" for r in rows)])
