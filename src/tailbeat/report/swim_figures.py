"""Figures of the trials. Draws what others computed; computes nothing.

Every function returns a figure; `save` writes it as SVG and PNG.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from tailbeat.control.actions import PERIOD
from tailbeat.control.measure import ARRIVAL, NEAR, centimetres
from tailbeat.control.motion import ahead_and_left
from tailbeat.evaluate.comparison import Kind
from tailbeat.evaluate.rates import ConditionResult
from tailbeat.evaluate.reach import Cell, Group, ReachResult
from tailbeat.evaluate.runs import Runs, surge
from tailbeat.evaluate.spectrum import SpectrumRow
from tailbeat.evaluate.track import TrackResult
from tailbeat.files import new_file
from tailbeat.fish.description import Fish
from tailbeat.fish.outline import outline
from tailbeat.report.style import (
    BLACK,
    COMMAND,
    LIMIT,
    MEASURED,
    MISSED,
    NEARLY,
    POOL,
    RATES,
    REACHED,
    RED,
    SERIES,
    TARGET,
    WAY,
    WHITE,
    colour_of,
    styled,
)


def save(figure: Figure, stem: Path) -> list[Path]:
    """Write `stem`.svg and `stem`.png; existing files are replaced."""
    if (layout := figure.get_layout_engine()) is not None:
        layout.execute(figure)  # once, not once more for each drawing of each file
        figure.set_layout_engine(None)
    paths = [stem.with_suffix(end) for end in (".svg", ".png")]
    for path in paths:
        with new_file(path, overwrite=True) as beside:
            figure.savefig(beside, dpi=150)
    return paths


def _figure(width: float, height: float) -> Figure:
    return Figure(figsize=(width, height), layout="constrained")


@styled
def reach_map(runs: Runs, title: str = "") -> Figure:
    """Targets in the fish's frame at its start, with the paths swum to them (paper's map)."""
    figure = _figure(5.5, 5.2)
    axes = figure.subplots()
    for way, place, hit, near in zip(*_in_start_frame(runs), runs.reached, runs.near, strict=True):
        colour = REACHED if hit else NEARLY if near else MISSED
        axes.plot(way[:, 1], way[:, 0], color=colour, lw=0.4, alpha=0.35)
        axes.plot(place[1], place[0], "o" if hit else "s" if near else "x", ms=4, color=colour)
    ends = [f"within {centimetres(one * float(runs.size[0]))}" for one in (ARRIVAL, NEAR)]
    names = ("o", REACHED, ends[0]), ("s", NEARLY, ends[1]), ("x", MISSED, "missed")
    for marker, colour, label in names:
        axes.plot([], [], marker, ms=4, color=colour, label=label)
    axes.annotate("", (0, 0.3), (0, -0.2), arrowprops={"arrowstyle": "-|>", "lw": 1.5})
    axes.set(xlabel="left [m]", ylabel="ahead [m]", title=title)
    axes.invert_xaxis()
    axes.set_aspect("equal")
    axes.legend(loc="upper left", fontsize="small")
    return figure


def _in_start_frame(runs: Runs) -> tuple[Any, Any]:
    """Paths (n, k, 2) and targets (n, 2), x ahead and y left of each fish at its start."""
    start = runs.pose[:, :1]
    paths, targets = (
        ahead_and_left(place - start[..., :2], start[..., 2])
        for place in (runs.pose[..., :2], runs.target[:, :1])
    )
    return paths, targets[:, 0]


@styled
def sectors(report: Mapping[str, ReachResult]) -> Figure:
    """Success rates by bearing with 95 % intervals, one panel per condition."""
    figure = _figure(4.2 * len(report), 3.4)
    for axes, (name, row) in zip(
        np.atleast_1d(figure.subplots(1, len(report), sharey=True)), report.items(), strict=True
    ):
        for shift, key, colour in ((-0.2, "arrived", REACHED), (0.2, "near", NEARLY)):
            _bars(axes, row.sectors, key, shift, colour)
        axes.set_xticks(range(len(row.sectors)), [f"{r.low:g}-{r.high:g}" for r in row.sectors])
        axes.set(title=name, xlabel="bearing, either side [deg]", ylim=(0, 102))
        axes.grid(visible=False, axis="x")
    figure.axes[0].set_ylabel("success rate [%]")
    figure.axes[0].legend(loc="lower left", fontsize="small")
    return figure


@styled
def heat_map(cells: Sequence[Cell], title: str = "") -> Figure:
    """Success rate over bearing and distance of the target at the start. Each cell has
    its 95 % Wilson interval and the number of targets; a cell without targets is empty."""
    bearings = sorted({cell.bearing for cell in cells})
    distances = sorted({cell.distance for cell in cells})
    rate = np.full((len(distances), len(bearings)), np.nan)
    figure = _figure(1.1 * len(bearings) + 1.6, 0.72 * len(distances) + 1.2)
    axes = figure.subplots()
    for cell in cells:
        row, column = distances.index(cell.distance), bearings.index(cell.bearing)
        rate[row, column] = 100 * cell.arrived
        _write_cell(axes, cell, column, row)
    drawn = axes.imshow(rate, cmap=RATES, vmin=0, vmax=100, origin="lower", aspect="auto")
    axes.set_xticks(range(len(bearings)), [f"{low:g}–{high:g}" for low, high in bearings])
    axes.set_yticks(range(len(distances)), [f"{low:g}–{high:g}" for low, high in distances])
    axes.set(title=title, xlabel="bearing, either side [deg]", ylabel="distance [m]")
    axes.grid(visible=False)
    figure.colorbar(drawn, label="success rate [%]")
    return figure


def _write_cell(axes: Axes, cell: Cell, column: int, row: int) -> None:
    low, high = (100 * end for end in cell.arrived_interval)
    words = f"{100 * cell.arrived:.0f} %\n{low:.0f} to {high:.0f} %\nn = {cell.targets}"
    colour = BLACK if cell.arrived > 0.6 else WHITE
    axes.text(column, row, words, ha="center", va="center", fontsize="x-small", color=colour)


def _bars(axes: Axes, rows: Sequence[Group], key: str, shift: float, colour: str) -> None:
    place = np.arange(len(rows)) + shift
    share = 100 * np.array([getattr(row, key) for row in rows])
    low, high = 100 * np.array([getattr(row, f"{key}_interval") for row in rows]).T
    reach = np.clip([share - low, high - share], 0, None)
    axes.bar(place, share, 0.38, yerr=reach, color=colour, ecolor=LIMIT, label=key)


@styled
def paths(runs: Runs, fish: Fish, count: int = 6) -> Figure:
    """Paths to several targets with snapshots of the fish's shape (paper's compilation)."""
    figure = _figure(9, 5.4)
    for axes, number in zip(np.ravel(figure.subplots(2, 3)), range(count), strict=True):
        if number < len(runs.shape):
            _draw_path(axes, runs, fish, number)
    return figure


def _draw_path(axes: Axes, runs: Runs, fish: Fish, number: int) -> None:
    steps = int(runs.steps[number])
    pose = runs.pose[number, : steps + 1]
    axes.plot(pose[:, 0], pose[:, 1], color=WAY, lw=1)
    snapshots = np.linspace(0, steps, 7).astype(int)
    for step, shade in zip(snapshots, np.linspace(0.35, 1, 7), strict=True):
        body = outline(fish, runs.shape[number, step])
        axes.plot(*body.T, color=POOL, alpha=shade, lw=2, solid_capstyle="round")
    x, y = runs.target[number, 0].tolist()
    size = float(runs.size[number])
    axes.add_patch(Circle((x, y), ARRIVAL * size, color=TARGET, zorder=3))
    axes.add_patch(Circle((x, y), NEAR * size, fill=False, color=TARGET, lw=0.8))
    ends = "reached" if runs.reached[number] else f"{100 * runs.nearest[number]:.0f} cm"
    axes.set(title=f"{ends}, {runs.seconds[number]:.1f} s", xlabel="x [m]", ylabel="y [m]")
    axes.set_aspect("equal", adjustable="datalim")


@styled
def following(by_path: Mapping[str, Runs], rows: Sequence[TrackResult]) -> Figure:
    """Moving targets, and the fish that follow them."""
    columns = 4
    figure = _figure(3.2 * columns, 2.6 * -(-len(rows) // columns))
    axes = np.ravel(figure.subplots(-(-len(rows) // columns), columns))
    for one, row in zip(axes, rows, strict=False):
        runs = by_path[row.condition]
        for pose in runs.pose[..., :2]:
            one.plot(*pose.T, color=POOL, lw=0.6, alpha=0.5)
        one.plot(*runs.target[0].T, color=TARGET, lw=1.5)
        kept = f"{row.kept}/{row.swims} kept"
        one.set(title=f"{row.condition}: {kept}, {100 * row.median_distance:.0f} cm")
        one.set(xlabel="x [m]", ylabel="y [m]")
        one.set_aspect("equal")
    for one in axes[len(rows) :]:
        one.remove()
    return figure


@styled
def power(rows: Sequence[SpectrumRow], bins: Any, band: Sequence[float]) -> Figure:
    """Cumulative fraction of the motor's velocity power over frequency; band edges as lines."""
    figure = _figure(5.5, 3.8)
    axes = figure.subplots()
    styles = {"all": "-", "forward": "--", "reversing": ":"}
    for row in rows:
        if row.pieces and row.share_below is not None:
            label = f"{row.runs}, {row.gait}: {100 * row.share_below:.0f} %"
            below = 100 * np.array(row.cumulative)
            axes.plot(bins, below, styles[row.gait], color=colour_of(row.runs), label=label)
    for edge in band:
        axes.axvline(edge, color=LIMIT, lw=0.8)
    axes.set(xlabel="frequency [Hz]", ylabel="velocity power below [%]", ylim=(0, 102))
    axes.set(title=f"fraction below {band[1]:g} Hz; lines at the band's edges")
    axes.legend(fontsize="x-small")
    return figure


@styled
def gaits(runs: Runs, seconds: float = 6.0) -> Figure:
    """The first seconds of some swims: setpoint, motor angle, and whether the fish swims
    backward."""
    figure, steps = _figure(9, 5.4), round(seconds / PERIOD)
    speed, time = surge(runs), PERIOD * np.arange(round(seconds / PERIOD))
    for axes, number in zip(np.ravel(figure.subplots(2, 3)), range(runs.count), strict=False):
        length = min(int(runs.steps[number]), steps)
        axes.plot(
            time[:length], runs.setpoint[number, :length], color=COMMAND, lw=1, label="setpoint"
        )
        axes.plot(
            time[:length], runs.motor[number, 1 : length + 1], color=MEASURED, lw=1, label="motor"
        )
        back = np.flatnonzero(speed[number, :length] < 0)
        axes.plot(time[back], np.full(back.size, -1.4), "s", ms=2, color=RED, label="backward")
        bearing = np.degrees(runs.bearing[number])
        axes.set(xlabel="time [s]", ylabel="angle [rad]", title=f"target at {bearing:.0f} deg")
    figure.axes[0].legend(fontsize="x-small")
    return figure


@styled
def costs(rows: Sequence[ConditionResult], title: str) -> Figure:
    """Success rate per condition with its interval, and the difference to the first
    condition on the same targets."""
    figure = _figure(9, 0.4 * len(rows) + 1.4)
    shares, differences = figure.subplots(1, 2, sharey=True)
    place = np.arange(len(rows))[::-1]
    value = 100 * np.array([row.arrived for row in rows])
    low, high = 100 * np.array([row.arrived_interval for row in rows]).T
    shares.errorbar(
        value, place, xerr=np.clip([value - low, high - value], 0, None), fmt="o", color=REACHED
    )
    gap = 100 * np.array([row.arrived_cost.difference for row in rows])
    low, high = 100 * np.array([row.arrived_cost.interval for row in rows]).T
    differences.errorbar(
        gap, place, xerr=np.clip([gap - low, high - gap], 0, None), fmt="o", color=MEASURED
    )
    differences.axvline(0, color=LIMIT, lw=0.8)
    shares.set_yticks(place, [row.condition for row in rows])
    shares.set(xlabel="success rate [%]", xlim=(0, 102), title=title)
    differences.set(xlabel="difference to the first, same targets [percentage points]")
    return figure


@styled
def transfer(rows: Sequence[Kind]) -> Figure:
    """Gap between twin and pool per condition of the pool, one line per kind of policy."""
    figure = _figure(8, 4)
    axes = figure.subplots()
    conditions = list(dict.fromkeys(row.condition for row in rows))
    kinds = list(dict.fromkeys((row.actions, row.servo) for row in rows))
    for index, kind in enumerate(kinds):
        own = [row for row in rows if (row.actions, row.servo) == kind]
        shift = 0.12 * (index - (len(kinds) - 1) / 2)
        place = np.array([conditions.index(row.condition) for row in own]) + shift
        gap = 100 * np.array([row.gap for row in own])
        low, high = 100 * np.array([row.gap_interval for row in own]).T
        label = f"{kind[0]}, {kind[1]} servo"
        reach = np.clip([gap - low, high - gap], 0, None)
        axes.errorbar(
            place, gap, reach, fmt="o", ms=4, color=SERIES[index % len(SERIES)], label=label
        )
    axes.axhline(0, color=LIMIT, lw=0.8)
    axes.set_xticks(range(len(conditions)), conditions)
    axes.set(ylabel="twin minus pool, success rate\n[percentage points]")
    axes.legend(fontsize="small")
    return figure
