"""The style of all figures: colours by their meaning, and matplotlib's settings while one is drawn.

The colours are Okabe and Ito's (2008), which colour-blind eyes can tell apart. Twin, pool and
measurement have the same colour in every figure.
"""

from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec, TypeVar

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.rcsetup import cycler

matplotlib.use("Agg")
BLACK, ORANGE, SKY, GREEN, YELLOW, BLUE, RED, PURPLE = (
    "#000000", "#E69F00", "#56B4E9", "#009E73", "#F0E442", "#0072B2", "#D55E00", "#CC79A7",
)  # fmt: skip
# What is compared.
MEASURED, TWIN, POOL, IDEALISED = BLACK, BLUE, PURPLE, SKY
# What was commanded: a motor's angle, a target. Then the result.
COMMAND, TARGET = "#808080", ORANGE
REACHED, NEARLY, MISSED = GREEN, ORANGE, RED
LIMIT = "#606060"  # lines of reference: zero, an edge of the band, a threshold, an interval
WAY = "#B3B3B3"  # the whole path of a fish that is drawn upon it
WHITE = "#FFFFFF"
SERIES = (BLUE, ORANGE, GREEN, RED, PURPLE, SKY, BLACK)  # of lines without their own colour
RATES = "cividis"  # of a map of success rates: lighter is higher
SETTINGS: dict[Any, Any] = {
    "font.size": 9.5,
    "axes.titlesize": "medium",
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.prop_cycle": cycler(color=SERIES),
    "grid.alpha": 0.3,
    "legend.fontsize": "small",
    "legend.framealpha": 0.8,
    "lines.linewidth": 1.3,
    "errorbar.capsize": 2.5,
}
APART = 0.075  # of an axis' height: the least distance of two labels
Given = ParamSpec("Given")
Drawn = TypeVar("Drawn")


def styled(draw: Callable[Given, Drawn]) -> Callable[Given, Drawn]:
    """A function that draws in this style and leaves matplotlib's settings as they were."""

    @wraps(draw)
    def drawn(*given: Given.args, **named: Given.kwargs) -> Drawn:
        with matplotlib.rc_context(SETTINGS):
            return draw(*given, **named)

    return drawn


def colour_of(name: str) -> str:
    """Colour of runs by the name of their condition: swims in the twin, in the pool, or recordings
    for an identification."""
    return TWIN if name.endswith("twin") else MEASURED if name == "identification" else POOL


def label_ends(axes: Axes) -> None:
    """Write each line's label at its right end, in its colour, instead of a legend. Overlapping
    labels are moved apart."""
    lines = [line for line in axes.get_lines() if not str(line.get_label()).startswith("_")]
    ends = [_height(axes, line) for line in lines]
    low = -np.inf
    for index in np.argsort(ends):
        low = max(low + APART, ends[index])
        axes.text(1.01, low, str(lines[index].get_label()), color=lines[index].get_color(),
                  transform=axes.transAxes, va="center", fontsize="small")  # fmt: skip


def _height(axes: Axes, line: Line2D) -> float:
    """Height at which a line ends, from 0 at the axis' bottom to 1 at its top."""
    seen = np.column_stack([np.asarray(one, float) for one in line.get_data()])
    seen = seen[np.isfinite(seen).all(axis=1)]
    if not len(seen):
        return 0.5
    low, high = sorted(axes.get_xlim())
    inside = seen[(seen[:, 0] >= low) & (seen[:, 0] <= high)]
    last = inside[-1] if len(inside) else seen[-1]
    _, height = axes.transAxes.inverted().transform(axes.transData.transform(last))
    return float(np.clip(height, 0, 1))


def draw_walls(axes: Axes, walls: tuple[float, float]) -> None:
    """Draw a pool of this length and width [m] from above; the axes show a little beside it."""
    length, width = walls
    axes.add_patch(
        Rectangle((-length / 2, -width / 2), length, width, fill=False, color=LIMIT, lw=2)
    )
    x, y = 0.52 * length, 0.52 * width
    axes.set(xlim=(-x, x), ylim=(-y, y), xlabel="x [m]", ylabel="y [m]")
    axes.set_aspect("equal")
