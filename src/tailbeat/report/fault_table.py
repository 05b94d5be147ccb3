"""The fault table as Markdown."""

from collections.abc import Sequence

from tailbeat.evaluate.faults import FaultResult
from tailbeat.report import tables


def markdown(results: Sequence[FaultResult]) -> str:
    """The table of faults in Markdown."""
    head = ("fault", "the operator reads", "safe state", "told after [s]", "safe after [s]")
    return tables.markdown(head, [_cells(one) for one in results]) + "\n"


def _cells(one: FaultResult) -> list[str]:
    state = one.safe_state if one.ok else "**not reached**"
    times = [one.told_s, None if one.safe_state == "run" else one.safe_s]
    shown = ["–" if value is None else f"{value:.2f}" for value in times]
    return [one.fault, one.operator_sees, state, *shown]
