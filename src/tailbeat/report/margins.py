"""The figure of a policy's margins: sizes over the lab's figures, one row per nuisance."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tailbeat.control.measure import Measure, centimetres
from tailbeat.evaluate.margins import Margin, Margins, by_safety
from tailbeat.files import new_file
from tailbeat.report.style import LIMIT, NEARLY, REACHED, styled

COLOURS = {"arrived": REACHED, "near": NEARLY}
HEADINGS = {"alone": "alone", "everyday": "all others everyday"}


@styled
def margins_figure(found: Margins, m: Measure, path: Path, overwrite: bool = False) -> None:
    """Factor of safety of every nuisance, alone and with all others everyday; thinnest on top. `m`
    is the fish's measure."""
    names = [row.nuisance for row in by_safety(found.margins)]
    figure = Figure(figsize=(10, 1.4 + 0.24 * len(names)), layout="constrained")
    for axes, (rest, heading) in zip(
        figure.subplots(1, 2, sharey=True), HEADINGS.items(), strict=True
    ):
        _draw(axes, [row for row in found.margins if row.rest == rest], names, m)
        axes.set(title=heading, xscale="log", xlabel="size stood over the lab's, or everyday")
    figure.axes[0].set_yticks(range(len(names)), names)
    figure.axes[0].invert_yaxis()
    figure.axes[1].legend(loc="upper right")
    with new_file(path, overwrite) as beside:
        figure.savefig(beside, dpi=130)


def _draw(axes: Axes, rows: list[Margin], names: list[str], m: Measure) -> None:
    for ring, shift in (("arrived", -0.15), ("near", 0.15)):
        label = centimetres(m.arrival if ring == "arrived" else m.near)
        own = [row for row in rows if row.ring == ring]
        high = np.array([row.size is None for row in own])
        at = np.array([names.index(row.nuisance) for row in own]) + shift
        safety = np.array([row.safety for row in own])
        ends = np.array([_ends(row) for row in own]).reshape(-1, 2)
        axes.hlines(at, *ends.T, color=COLOURS[ring], lw=1)
        axes.plot(safety[~high], at[~high], "o", ms=4, color=COLOURS[ring], label=label)
        axes.plot(safety[high], at[high], ">", ms=4, color=COLOURS[ring], fillstyle="none")
    axes.axvline(1.0, color=LIMIT, lw=0.8, ls="--")


def _ends(row: Margin) -> tuple[float, float]:
    """Ends of the interval, over the lab's figure or the everyday size."""
    own = row.lab or row.everyday
    low, high = row.interval
    return low / own, (row.most if high is None else high) / own
