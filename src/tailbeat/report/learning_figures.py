"""Curves of trainings. Draws what the runs kept; computes nothing."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tailbeat.files import new_file
from tailbeat.report.style import LIMIT, SERIES, label_ends, styled
from tailbeat.train.progress import TrainingRow

FEW = 4  # curves that are labelled at their ends


@styled
def courses(curves: Mapping[str, Sequence[TrainingRow]], path: Path) -> None:
    """Rolling success rate and stage over the minutes of each training."""
    figure = Figure(figsize=(8, 5), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=[2, 1])
    for colour, (label, rows) in zip(SERIES, curves.items(), strict=False):
        _draw(above, below, rows, label, colour)
    above.axhline(95, color=LIMIT, lw=0.8)
    above.set(ylabel="targets acquired [%]", ylim=(0, 102))
    below.set(xlabel="training [min]", ylabel="stage [-]")
    if len(curves) > FEW:
        above.legend(loc="lower right")
    else:
        label_ends(above)
    with new_file(path, overwrite=True) as beside:
        figure.savefig(beside, dpi=130)


def _draw(above: Axes, below: Axes, rows: Sequence[TrainingRow], label: str, colour: str) -> None:
    minutes = [row.seconds / 60 for row in rows]
    shares = [100 * row.success or np.nan for row in rows]  # 0: a stage without a verdict yet
    above.plot(minutes, shares, color=colour, lw=1, label=label)
    below.step(minutes, [row.stage for row in rows], color=colour, where="post")
