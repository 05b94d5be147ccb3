"""All figures have one style: colours by meaning, a unit on every axis, settings that are left."""

import ast
import re
from dataclasses import fields
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from tailbeat.evaluate import reach
from tailbeat.evaluate.comparison import Kind
from tailbeat.evaluate.rates import ConditionResult, Difference, wilson
from tailbeat.evaluate.runs import Runs
from tailbeat.evaluate.spectrum import BINS, SpectrumRow
from tailbeat.evaluate.speed_map import SpeedMap, SpeedRow
from tailbeat.evaluate.track import TrackResult
from tailbeat.fish.store import load_fish
from tailbeat.report import figures, learning_figures, style, swim_figures
from tailbeat.train.progress import TrainingRow

FOLDER = Path(style.__file__).parent
FIGURES = sorted(FOLDER.glob("*figures.py"))
FISH = load_fish("pulley-fish")
RATES: dict[str, Any] = {
    "arrived": 0.8,
    "arrived_interval": (0.6, 0.9),
    "near": 0.9,
    "near_interval": (0.7, 1),
}
ALLOWED = {
    to_hex(getattr(style, name))
    for name in ("BLACK", "ORANGE", "SKY", "GREEN", "YELLOW", "BLUE", "RED", "PURPLE",
                 "COMMAND", "LIMIT", "WAY")
}  # fmt: skip


def swims(count: int = 40, steps: int = 50) -> Runs:
    """Fish that swim straight to targets all around; every fourth stays 10 cm short."""
    bearing = np.linspace(-np.pi, np.pi, count, endpoint=False)
    distance = np.linspace(0.6, 2.9, count)
    target = distance[:, None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
    short = np.where(np.arange(count) % 4 == 0, 0.1, 0.0)
    done = np.linspace(0, 1, steps + 1)[None] * (1 - short / distance)[:, None]
    pose = np.zeros((count, steps + 1, 3), np.float32)
    pose[..., :2] = target[:, None] * done[..., None]
    shape = np.zeros((6, steps + 1, 4 + len(FISH.tail.links)), np.float32)
    shape[..., :3] = pose[:6]
    wave = np.sin(np.linspace(0, 20, steps + 1, dtype=np.float32))
    return Runs(
        pose=pose,
        target=np.repeat(target[:, None], steps + 1, axis=1).astype(np.float32),
        motor=np.tile(wave, (count, 1)),
        setpoint=np.tile(wave[:-1], (count, 1)),
        steps=np.full(count, steps),
        reached=short == 0,
        lost=np.zeros(count, bool),
        energy=np.ones(count, np.float32),
        shape=shape,
        water=np.zeros(count, np.int64),
        size=np.ones(count, np.float32),
        reach=np.ones(count, np.float32),
    )


SWIMS = swims()
RESULT = reach.numbers(SWIMS)


def condition(name: str) -> ConditionResult:
    gap = Difference(-0.1, (-0.2, 0.05))
    return ConditionResult(
        condition=name, swims=40, lost=0, arrived_cost=gap, near_cost=gap, **RATES
    )


def spectrum(runs: str, gait: str) -> SpectrumRow:
    cumulative = tuple(np.linspace(0, 1, len(BINS)).tolist())
    return SpectrumRow(runs=runs, gait=gait, pieces=3, share_below=0.9, cumulative=cumulative)


def kind(**words: Any) -> Kind:
    values: dict[str, Any] = {one.name: np.nan for one in fields(Kind)}
    return Kind(**{**values, "gap": 0.1, "gap_interval": (0.0, 0.2), **words})


POWER = [spectrum(runs, gait) for runs in ("identification", "reach twin", "reach open")
         for gait in ("all", "forward")]  # fmt: skip
ROUND = TrackResult("circle", 40, 0.1, 0.2, 0.2, 0.3, 0.1, 38, None, None, 0.9)
DRAWN = {
    "reach_map": lambda: swim_figures.reach_map(SWIMS),
    "heat_map": lambda: swim_figures.heat_map(RESULT.cells),
    "sectors": lambda: swim_figures.sectors({"open": RESULT, "walled": RESULT}),
    "paths": lambda: swim_figures.paths(SWIMS, FISH),
    "following": lambda: swim_figures.following({"circle": SWIMS}, [ROUND]),
    "power": lambda: swim_figures.power(POWER, BINS, (0.5, 4.0)),
    "gaits": lambda: swim_figures.gaits(SWIMS),
    "costs": lambda: swim_figures.costs([condition("calm"), condition("wind")], "within 5 cm"),
    "transfer": lambda: swim_figures.transfer(
        [kind(actions=a, servo="real", condition=c) for a in ("direct", "generator") for c in "ab"]
    ),
}


def saved(draw, monkeypatch: pytest.MonkeyPatch, path: Path) -> Figure:
    """The figure that a function writes to a file."""
    caught: list[Figure] = []
    save = Figure.savefig

    def keep(self: Figure, *given: Any, **named: Any) -> None:
        caught.append(self)
        save(self, *given, **named)

    monkeypatch.setattr(Figure, "savefig", keep)
    draw(path)
    assert path.stat().st_size > 5000
    return caught[0]


def speed_figure(path: Path) -> None:
    rows = [SpeedRow("identified", rate, beat, 0.3, 0.2, 0.1) for rate in (3.0, 6.0)
            for beat in (1.0, 2.0, 4.0)]  # fmt: skip
    figures.speed_map(SpeedMap("a", "b", tuple(rows)), path)


def training_figure(path: Path) -> None:
    zero: dict[str, Any] = {one.name: 0 for one in fields(TrainingRow)}
    rows = [
        TrainingRow(**{**zero, "seconds": 60.0 * k, "stage": 1 + k // 3, "success": 0.1 * k})
        for k in range(8)
    ]
    learning_figures.courses({"seed 1": rows, "seed 2": rows}, path)


def without_unit(figure: Figure) -> list[str]:
    """Axes with numbers beside them whose label has no unit in brackets."""
    figure.draw_without_rendering()
    return [
        f"{axis.axis_name} {axis.get_label_text()!r} of {axes.get_title()!r}"
        for axes in figure.axes
        for axis, side in ((axes.xaxis, "labelbottom"), (axes.yaxis, "labelleft"))
        if axis.get_tick_params().get(side, True)  # else the numbers stand at another one
        if any(re.match(r"[−\d.]", one.get_text()) for one in axis.get_ticklabels())
        if not re.search(r"\[.+\]", axis.get_label_text())
    ]


def colours(figure: Figure) -> set[str]:
    """Of all lines or, where there is none, of their markers, and of all bars and discs."""
    lines = [line for axes in figure.axes for line in axes.get_lines()]
    bars = [patch.get_facecolor() for axes in figure.axes for patch in axes.patches]
    marks = [one.get_markeredgecolor() if one.get_linestyle() == "None" else one.get_color()
             for one in lines]  # fmt: skip
    return {to_hex(one) for one in [*marks, *bars]}


@pytest.mark.thorough
@pytest.mark.parametrize("name", DRAWN)
def test_every_axis_has_a_unit_and_every_colour_is_of_the_style(name):
    figure = DRAWN[name]()
    assert not without_unit(figure)
    assert colours(figure) <= ALLOWED


@pytest.mark.parametrize("draw", [speed_figure, training_figure])
def test_the_same_holds_for_figures_that_are_written_at_once(draw, monkeypatch, tmp_path):
    figure = saved(draw, monkeypatch, tmp_path / "a.png")
    assert not without_unit(figure)
    assert colours(figure) <= ALLOWED


def test_twin_pool_and_measurement_have_their_own_colour_in_every_figure(monkeypatch, tmp_path):
    seen = {line.get_label(): to_hex(line.get_color()) for line in DRAWN["power"]().axes[0].lines}
    for name, colour in (
        ("identification", style.MEASURED), ("reach twin", style.TWIN), ("reach open", style.POOL),
    ):  # fmt: skip
        assert {shade for label, shade in seen.items() if name in str(label)} == {to_hex(colour)}
    figure = saved(speed_figure, monkeypatch, tmp_path / "a.png")
    for line in figure.axes[0].get_lines():
        for name, colour in (("twin", style.TWIN), ("pool", style.POOL)):
            if str(line.get_label()).startswith(name):
                assert line.get_color() == colour
    assert len({style.MEASURED, style.TWIN, style.POOL}) == 3


def test_few_lines_are_labelled_at_their_ends_without_overlap(monkeypatch, tmp_path):
    figure = saved(training_figure, monkeypatch, tmp_path / "a.png")
    above = figure.axes[0]
    assert above.get_legend() is None
    texts = {text.get_text(): text for text in above.texts}
    assert set(texts) == {"seed 1", "seed 2"}
    for line in above.get_lines()[:2]:
        assert texts[str(line.get_label())].get_color() == line.get_color()
    heights = sorted(text.get_position()[1] for text in above.texts)
    assert heights[1] - heights[0] == pytest.approx(style.APART)  # the curves end alike


def test_the_heat_map_has_rate_interval_and_number_in_every_cell():
    away = np.abs(np.degrees(np.linspace(-np.pi, np.pi, 40, endpoint=False)))
    inside = (
        (away >= 90) & (away < 120) & (SWIMS.distance[:, 0] < 1.5) & (SWIMS.distance[:, 0] >= 1)
    )
    hits, count = int(SWIMS.reached[inside].sum()), int(inside.sum())
    assert 0 < hits < count
    low, high = (100 * end for end in wilson(hits, count))
    words = f"{100 * hits / count:.0f} %\n{low:.0f} to {high:.0f} %\nn = {count}"
    axes = DRAWN["heat_map"]().axes[0]
    at = {tuple(text.get_position()): text.get_text() for text in axes.texts}
    columns = [text.get_text() for text in axes.get_xticklabels()]
    rows = [text.get_text() for text in axes.get_yticklabels()]
    assert columns[0] == "0–30" and columns[-1] == "150–180"
    assert at[columns.index("90–120"), rows.index("1–1.5")] == words
    assert sum(cell.targets for cell in RESULT.cells) == 40
    assert len(at) == len(RESULT.cells)


def test_drawing_leaves_matplotlib_s_settings_as_they_were():
    before = dict(matplotlib.rcParams)
    DRAWN["power"]()
    assert dict(matplotlib.rcParams) == before
    assert DRAWN["power"]().axes[0].spines["top"].get_visible() is False  # and had its own


# ---- what the code says -------------------------------------------------------------------------


@pytest.mark.parametrize("path", [*FIGURES, FOLDER / "tour.py"], ids=lambda path: path.stem)
def test_no_figure_names_a_colour_or_an_axis_without_a_unit(path):
    """Also of figures that need long computing and are not drawn here."""
    faults = []
    for node in ast.walk(ast.parse(path.read_text())):
        if not isinstance(node, ast.Call):
            continue
        for word in node.keywords:
            texts = [one.value for one in ast.walk(word.value)
                     if isinstance(one, ast.Constant) and isinstance(one.value, str)]  # fmt: skip
            if word.arg in ("color", "ecolor", "facecolor", "edgecolor") and texts:
                faults.append(f"line {node.lineno}: {word.arg}={texts}; take it from style.py")
            if word.arg in ("xlabel", "ylabel") and any("[" not in text for text in texts):
                faults.append(f"line {node.lineno}: {word.arg}={texts}; give a unit")
    assert not faults


@pytest.mark.parametrize("path", FIGURES, ids=lambda path: path.stem)
def test_every_function_that_draws_has_the_style(path):
    drawn = [
        one
        for one in ast.parse(path.read_text()).body
        if isinstance(one, ast.FunctionDef) and one.name[0] != "_" and one.name != "save"
    ]
    bare = [one.name for one in drawn if "styled" not in map(ast.unparse, one.decorator_list)]
    assert drawn and not bare
