"""The figure of what a fish can do: circles over speed, and stops."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tailbeat.evaluate.gaits import Gait
from tailbeat.evaluate.limit_rows import front, in_band
from tailbeat.evaluate.limits import SwimLimits
from tailbeat.files import new_file
from tailbeat.report.style import LIMIT, POOL, SKY, TARGET, TWIN, styled

COLOURS = {"pool": POOL, "twin": TWIN}
WIDEST = 3.0  # of the radius that counts as steerable: wider circles are not drawn
ABOVE = 0.6  # of it: the name of a path with a tighter curve stands below its marker


@styled
def limits_figure(found: SwimLimits, path: Path, overwrite: bool = False) -> None:
    """Circle over speed, with the paths that may be asked, and stopping distance over speed."""
    figure = Figure(figsize=(11, 4.4), layout="constrained")
    circles, stops = figure.subplots(1, 2, width_ratios=(3, 2))
    _draw_circles(circles, found)
    _draw_stops(stops, found)
    with new_file(path, overwrite) as beside:
        figure.savefig(beside, dpi=130)


def _draw_circles(axes: Axes, found: SwimLimits) -> None:
    """Every command as a marker, and the tightest circle up to each speed as a line."""
    for place in found.places:
        known = [one for one in place.gaits if in_band(one, found.band)]
        slow = [one for one in place.gaits if not in_band(one, found.band)]
        colour = COLOURS[place.where]
        if place.where == "pool":
            _mark(axes, known, "o", colour, f"{place.where}, beats in the band")
            _mark(axes, slow, "v", SKY, f"{place.where}, beats below the band")
            _mark(axes, place.bursts, "D", LIMIT, f"{place.where}, burst and rest")
            _line(axes, place.gaits, SKY, ":", f"{place.where}, tightest, all beats")
        _line(axes, known, colour, "-", f"{place.where}, tightest, beats in the band")
    for row in found.paths[: len(found.paths) // len(found.places)]:
        axes.plot(row.speed, row.radius, "*", color=TARGET, ms=8)
        above = row.radius > ABOVE * found.radius
        axes.annotate(
            row.path.removesuffix(" m/s"), (row.speed, row.radius), (0, 6 if above else -6),
            textcoords="offset points", fontsize="x-small", rotation=90, ha="center",
            va="bottom" if above else "top",
        )  # fmt: skip
    axes.axhline(found.radius, color=LIMIT, lw=0.8, ls="--")
    axes.set(xlabel="speed [m/s]", ylabel="radius of the circle [m]", xlim=(0, None),
             ylim=(0, WIDEST * found.radius), title=f"{found.fish}, default water")  # fmt: skip
    axes.legend(fontsize="x-small")


def _mark(axes: Axes, gaits: Sequence[Gait], marker: str, colour: str, label: str) -> None:
    speed, radius = np.array([(g.speed[0], g.radius[0]) for g in gaits]).reshape(-1, 2).T
    axes.plot(speed, radius, marker, ms=3.5, color=colour, fillstyle="none", label=label)


def _line(axes: Axes, gaits: Sequence[Gait], colour: str, line: str, label: str) -> None:
    speed, radius = front(gaits).T
    axes.plot(speed, radius, line, drawstyle="steps-post", color=colour, label=label)


def _draw_stops(axes: Axes, found: SwimLimits) -> None:
    """Distance until a tenth of the speed, with its range over the waters."""
    for place in found.places:
        for tail, marker in (("straight", "o"), ("bent", "s")):
            rows = [row for row in found.stops if (row.where, row.tail) == (place.where, tail)]
            ends = [row for row in rows if np.isfinite(row.distance.high)]
            low, mid, high, start = np.array(
                [(r.distance.low, r.distance.default, r.distance.high, r.start.default)
                 for r in ends], float
            ).reshape(-1, 4).T  # fmt: skip
            axes.errorbar(
                start, mid, [mid - low, high - mid], fmt=f"-{marker}", ms=4, elinewidth=0.7,
                color=COLOURS[place.where], fillstyle="none" if tail == "bent" else "full",
                label=f"{place.where}, tail {tail}",
            )  # fmt: skip
    axes.set(xlabel="speed at the start [m/s]", ylabel="distance to a tenth of it [m]",
             xlim=(0, None), ylim=(0, None), title="stops")  # fmt: skip
    axes.legend(fontsize="x-small")
