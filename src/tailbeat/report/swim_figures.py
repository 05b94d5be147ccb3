"""Figures of the trials. Draws what others computed; computes nothing.

Every function returns a figure; `save` writes it as SVG and PNG. Colours are Okabe and Ito's, which
the colour-blind can tell apart.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from tailbeat.control.actions import PERIOD
from tailbeat.evaluate.comparison import Kind
from tailbeat.evaluate.rates import ConditionResult
from tailbeat.evaluate.reach import Group, ReachResult
from tailbeat.evaluate.runs import NEAR, Runs, surge
from tailbeat.evaluate.spectrum import SpectrumRow
from tailbeat.evaluate.track import TrackResult
from tailbeat.files import new_file
from tailbeat.fish.description import Fish
from tailbeat.fish.outline import outline

matplotlib.use("Agg")
BLACK, ORANGE, SKY, GREEN, YELLOW, BLUE, RED, PURPLE = (
    "#000000", "#E69F00", "#56B4E9", "#009E73", "#F0E442", "#0072B2", "#D55E00", "#CC79A7",
)  # fmt: skip
COLOURS = (BLUE, ORANGE, GREEN, RED, PURPLE, SKY, BLACK)
REACHED, NEARLY, MISSED = GREEN, ORANGE, RED


def save(figure: Figure, stem: Path) -> list[Path]:
    """Write `stem`.svg and `stem`.png, over what is there."""
    paths = [stem.with_suffix(end) for end in (".svg", ".png")]
    for path in paths:
        with new_file(path, overwrite=True) as beside:
            figure.savefig(beside, dpi=150)
    return paths


def _figure(width: float, height: float) -> Figure:
    return Figure(figsize=(width, height), layout="constrained")


def reach_map(runs: Runs, title: str = "") -> Figure:
    """Targets in the fish's frame at its start, with the paths swum to them (paper's map)."""
    figure = _figure(5.5, 5.2)
    axes = figure.subplots()
    for way, place, hit, near in zip(
        *_in_start_frame(runs), runs.reached, runs.nearest, strict=True
    ):
        colour = REACHED if hit else NEARLY if near < NEAR else MISSED
        axes.plot(way[:, 1], way[:, 0], color=colour, lw=0.4, alpha=0.35)
        axes.plot(
            place[1], place[0], "o" if hit else "s" if near < NEAR else "x", ms=4, color=colour
        )
    names = ("o", REACHED, "within 5 cm"), ("s", NEARLY, "within 20 cm"), ("x", MISSED, "missed")
    for marker, colour, label in names:
        axes.plot([], [], marker, ms=4, color=colour, label=label)
    axes.annotate("", (0, 0.3), (0, -0.2), arrowprops={"arrowstyle": "-|>", "lw": 1.5})
    axes.set(xlabel="left [m]", ylabel="ahead [m]", title=title)
    axes.invert_xaxis()
    axes.set_aspect("equal")
    axes.legend(loc="upper left", fontsize="small")
    axes.grid(alpha=0.3)
    return figure


def _in_start_frame(runs: Runs) -> tuple[Any, Any]:
    """Paths (n, k, 2) and targets (n, 2), x ahead and y left of each fish at its start."""
    start = runs.pose[:, :1]
    c, s = np.cos(start[..., 2]), np.sin(start[..., 2])
    turned = []
    for place in (runs.pose[..., :2], runs.target[:, :1]):
        x, y = np.moveaxis(place - start[..., :2], 2, 0)
        turned.append(np.stack([c * x + s * y, c * y - s * x], axis=2))
    return turned[0], turned[1][:, 0]


def sectors(report: Mapping[str, ReachResult]) -> Figure:
    """Success rates by bearing with 95 % intervals, one panel per condition."""
    figure = _figure(4.2 * len(report), 3.4)
    for axes, (name, row) in zip(
        np.atleast_1d(figure.subplots(1, len(report), sharey=True)), report.items(), strict=True
    ):
        for shift, key, colour in ((-0.2, "5cm", BLUE), (0.2, "20cm", ORANGE)):
            _bars(axes, row.sectors, key, shift, colour)
        axes.set_xticks(range(len(row.sectors)), [f"{r.low:g}-{r.high:g}" for r in row.sectors])
        axes.set(title=name, xlabel="bearing, either side [deg]", ylim=(0, 1.02))
        axes.grid(alpha=0.3, axis="y")
    figure.axes[0].set_ylabel("success rate")
    figure.axes[0].legend(loc="lower left", fontsize="small")
    return figure


def _bars(axes: Axes, rows: Sequence[Group], key: str, shift: float, colour: str) -> None:
    place = np.arange(len(rows)) + shift
    share = np.array([getattr(row, f"within_{key}") for row in rows])
    low, high = np.array([getattr(row, f"interval_{key}") for row in rows]).T
    reach = np.clip([share - low, high - share], 0, None)
    label = f"within {key.removesuffix('cm')} cm"
    axes.bar(place, share, 0.38, yerr=reach, color=colour, ecolor="0.3", label=label)


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
    axes.plot(pose[:, 0], pose[:, 1], color="0.7", lw=1)
    snapshots = np.linspace(0, steps, 7).astype(int)
    for step, shade in zip(snapshots, np.linspace(0.35, 1, 7), strict=True):
        body = outline(fish, runs.shape[number, step])
        axes.plot(*body.T, color=BLUE, alpha=shade, lw=2, solid_capstyle="round")
    x, y = runs.target[number, 0].tolist()
    axes.add_patch(Circle((x, y), 0.05, color=ORANGE, zorder=3))
    axes.add_patch(Circle((x, y), NEAR, fill=False, color=ORANGE, lw=0.8))
    ends = "reached" if runs.reached[number] else f"{100 * runs.nearest[number]:.0f} cm"
    axes.set(title=f"{ends}, {runs.seconds[number]:.1f} s", xlabel="x [m]", ylabel="y [m]")
    axes.set_aspect("equal", adjustable="datalim")
    axes.grid(alpha=0.3)


def following(by_path: Mapping[str, Runs], rows: Sequence[TrackResult]) -> Figure:
    """Targets that go round, and the fish behind them."""
    columns = 4
    figure = _figure(3.2 * columns, 2.6 * -(-len(rows) // columns))
    axes = np.ravel(figure.subplots(-(-len(rows) // columns), columns))
    for one, row in zip(axes, rows, strict=False):
        runs = by_path[row.condition]
        for pose in runs.pose[..., :2]:
            one.plot(*pose.T, color=BLUE, lw=0.6, alpha=0.5)
        one.plot(*runs.target[0].T, color=ORANGE, lw=1.5)
        kept = f"{row.kept}/{row.swims} kept"
        one.set(title=f"{row.condition}: {kept}, {100 * row.median_distance:.0f} cm")
        one.set_aspect("equal")
        one.grid(alpha=0.3)
    for one in axes[len(rows) :]:
        one.remove()
    return figure


def power(rows: Sequence[SpectrumRow], bins: Any, band: Sequence[float]) -> Figure:
    """Cumulative fraction of the motor's velocity power over frequency; band edges as lines."""
    figure = _figure(5.5, 3.8)
    axes = figure.subplots()
    styles = {"all": "-", "forward": "--", "reversing": ":"}
    names = list(dict.fromkeys(row.runs for row in rows))
    for row in rows:
        if row.pieces and row.share_below is not None:
            colour = COLOURS[names.index(row.runs) % len(COLOURS)]
            label = f"{row.runs}, {row.gait}: {100 * row.share_below:.0f} %"
            axes.plot(bins, row.cumulative, styles[row.gait], color=colour, label=label)
    for edge in band:
        axes.axvline(edge, color=BLACK, lw=0.8)
    axes.set(xlabel="frequency [Hz]", ylabel="share of velocity power below", ylim=(0, 1.02))
    axes.set(title=f"share below {band[1]:g} Hz; lines at the band's edges")
    axes.legend(fontsize="x-small")
    axes.grid(alpha=0.3)
    return figure


def gaits(runs: Runs, seconds: float = 6.0) -> Figure:
    """The first seconds of some swims: setpoint, motor, and which way the fish goes."""
    figure, steps = _figure(9, 5.4), round(seconds / PERIOD)
    speed, time = surge(runs), PERIOD * np.arange(round(seconds / PERIOD))
    for axes, number in zip(np.ravel(figure.subplots(2, 3)), range(runs.count), strict=False):
        length = min(int(runs.steps[number]), steps)
        axes.plot(
            time[:length], runs.setpoint[number, :length], color=ORANGE, lw=1, label="setpoint"
        )
        axes.plot(
            time[:length], runs.motor[number, 1 : length + 1], color=BLUE, lw=1, label="motor"
        )
        back = np.flatnonzero(speed[number, :length] < 0)
        axes.plot(time[back], np.full(back.size, -1.4), "s", ms=2, color=RED, label="backward")
        bearing = np.degrees(runs.bearing[number])
        axes.set(xlabel="time [s]", ylabel="angle [rad]", title=f"target at {bearing:.0f} deg")
        axes.grid(alpha=0.3)
    figure.axes[0].legend(fontsize="x-small")
    return figure


def costs(rows: Sequence[ConditionResult], title: str) -> Figure:
    """Success rate within 5 cm per condition with its interval, and the difference to the first
    condition on the same targets."""
    figure = _figure(9, 0.4 * len(rows) + 1.4)
    shares, differences = figure.subplots(1, 2, sharey=True)
    place = np.arange(len(rows))[::-1]
    value = np.array([row.within_5cm for row in rows])
    low, high = np.array([row.interval_5cm for row in rows]).T
    shares.errorbar(
        value, place, xerr=np.clip([value - low, high - value], 0, None), fmt="o", color=BLUE
    )
    gap = np.array([row.cost_5cm.difference for row in rows])
    low, high = np.array([row.cost_5cm.interval for row in rows]).T
    differences.errorbar(
        gap, place, xerr=np.clip([gap - low, high - gap], 0, None), fmt="o", color=ORANGE
    )
    differences.axvline(0, color=BLACK, lw=0.8)
    shares.set_yticks(place, [row.condition for row in rows])
    shares.set(xlabel="success rate within 5 cm", xlim=(0, 1.02), title=title)
    differences.set(xlabel="difference to the first, same targets")
    for axes in (shares, differences):
        axes.grid(alpha=0.3)
    return figure


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
        gap = np.array([row.gap_20cm for row in own])
        low, high = np.array([row.gap_interval_20cm for row in own]).T
        label = f"{kind[0]}, {kind[1]} servo"
        reach = np.clip([gap - low, high - gap], 0, None)
        axes.errorbar(place, gap, reach, fmt="o", ms=4, color=COLOURS[index % 7], label=label)
    axes.axhline(0, color=BLACK, lw=0.8)
    axes.set_xticks(range(len(conditions)), conditions)
    axes.set(ylabel="twin less pool, success rate within 20 cm")
    axes.legend(fontsize="small")
    axes.grid(alpha=0.3)
    return figure
