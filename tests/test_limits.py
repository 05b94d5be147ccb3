"""What a fish can do at all: circles, stops and paths, by hand-worked cases and by real swims."""

import json
import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from support import complaint, tailbeat
from tailbeat.control.actions import PERIOD
from tailbeat.control.measure import Measure
from tailbeat.evaluate import limit_rows, limits
from tailbeat.evaluate.closed_paths import PathRow, least_radius, path_rows
from tailbeat.evaluate.gaits import Gait, Grid, beats_of, gaits_of
from tailbeat.evaluate.limits import Place, SwimLimits, allowed, space_of
from tailbeat.evaluate.steady_swims import Command, Steady, Swimmer, poses, setpoints, steady
from tailbeat.evaluate.stopping import stops
from tailbeat.fish.store import load_fish
from tailbeat.operator.paths import circle, eight, lap_length, square
from tailbeat.pool.water import ensemble
from tailbeat.report.limits_figures import limits_figure
from tailbeat.report.tables import as_cell
from test_figures import ALLOWED, colours, saved, without_unit

FISH = load_fish("pulley-fish")
SPACE = space_of(FISH)
POOL = Swimmer(FISH, tuple(ensemble(1, 0)))
SMALL = Grid((0.5,), 2, (0.2, 1.0), (0.0, 1.0), (2.0,), 4.0, 3.0)
PLAIN = limit_rows.Spread(1.0, 1.0, 1.0)


def quiet(name: str, done: int, total: int) -> None:
    """No progress."""


@cache
def swum(*commands: Command, seconds: float = 16.0) -> Steady:
    """How the fish swims in the default water."""
    pose = poses(POOL, setpoints(SPACE, commands, seconds), quiet)[0]
    return steady(pose, [one.period for one in commands])


def gait(frequency: float, amplitude: float, centre: float, *numbers: tuple[float, ...]) -> Gait:
    """A gait that was not swum: speed, radius and rate, one number for each water."""
    return Gait(Command(frequency, amplitude, centre), *numbers)


# ---- measuring ----------------------------------------------------------------------------------


@pytest.mark.parametrize(("rate", "ahead"), [(0.4, 1.0), (-0.4, 1.0), (3.0, 1.0), (0.4, -1.0)])
def test_a_circle_keeps_its_radius_whatever_the_recoil(rate, ahead):
    """A path of 0.25 m radius, with a recoil of 4 cm and 0.3 rad at 0.7 Hz, and no whole period."""
    period, radius = 1 / 0.7, 0.25
    time = PERIOD * np.arange(round(30.0 / PERIOD) + 1)
    beat = 2 * np.pi * time / period
    place = np.exp(1j * rate * time) * (radius + 0.04 * np.sin(beat))
    heading = np.angle(1j * rate * ahead) + rate * time + 0.3 * np.sin(beat + 1)
    pose = np.stack([place.real, place.imag, heading], axis=-1)
    found = steady(pose[None], [period])
    assert found.rate[0] == pytest.approx(rate, rel=2e-3)
    assert found.radius[0] == pytest.approx(radius, rel=5e-3)
    assert found.speed[0] == pytest.approx(ahead * abs(rate) * radius, rel=5e-3)


def test_a_generator_at_rest_makes_pauses():
    command = Command(2.0, 1.0, 0.4, burst=1.0, rest=3.0)
    played = setpoints(SPACE, [command], 8.0)[0]
    time = PERIOD * np.arange(len(played))
    moving = np.abs(np.diff(played, append=played[-1])) > 1e-3
    resting = (np.mod(time, 4.0) > 1.6) & (np.mod(time, 4.0) < 3.9)  # 0.6 s: the generator's lag
    assert not moving[resting].any() and moving[np.mod(time, 4.0) < 0.9].mean() > 0.9
    assert played[resting] == pytest.approx(0.4, abs=0.01)


def test_an_action_means_its_command():
    """Frequency, amplitude and centre are found again in the setpoints."""
    played = setpoints(SPACE, [Command(1.5, 0.3, -0.2)], 20.0)[0][500:]
    assert played.mean() == pytest.approx(-0.2, abs=0.01)
    assert np.ptp(played) / 2 == pytest.approx(0.3, rel=0.02)
    lines = np.abs(np.fft.rfft(played - played.mean()))
    assert np.fft.rfftfreq(len(played), PERIOD)[lines.argmax()] == pytest.approx(1.5)


# ---- swims --------------------------------------------------------------------------------------


def test_mirrored_commands_give_mirrored_circles_and_a_straight_beat_none():
    left, right = Command(2.0, 0.4, 0.4), Command(2.0, 0.4, -0.4)
    found = swum(left, right)
    assert found.rate[0] > 0.1 and found.rate[1] == pytest.approx(-found.rate[0], rel=0.02)
    assert found.speed[1] == pytest.approx(found.speed[0], rel=0.02)
    both, ahead = gaits_of(POOL, SPACE, [left, replace(left, centre=0.0)], 16.0, quiet)
    assert ahead.radius == (np.inf,) and ahead.speed[0] > 0.1
    assert both.speed[0] == pytest.approx(found.speed.max(), rel=1e-9)
    assert both.radius[0] == pytest.approx(found.radius.max(), rel=1e-9)
    assert both.rate[0] == pytest.approx(np.abs(found.rate).min(), rel=1e-6)


@pytest.mark.thorough
def test_a_larger_beat_of_the_same_frequency_is_not_slower():
    speeds = swum(*(Command(1.5, size, 0.0) for size in (0.05, 0.1, 0.2, 0.4, 0.8))).speed
    assert speeds[0] > 0 and (np.diff(speeds) > 0).all()


@cache
def stopped(centre: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Start, distance and time of stops from two speeds, with the tail at `centre`."""
    beats = [Command(2.0, size, 0.0) for size in (0.3, 1.0)]
    rest = Command(0.0, 0.0, centre)
    found = stops(POOL, SPACE, beats, rest, (12.0, 24.0), quiet)
    return found.start[0], found.distance[0], found.seconds[0]


def test_a_stop_is_that_of_a_drag_that_grows_with_the_square_of_the_speed():
    """With m v' = -k v^2 the way to a tenth is (m/k) ln 10 from any speed, and the time 9 m/(k v).
    Only the flow that separates at the fin makes the faster fish's way a little longer."""
    start, distance, seconds = stopped(0.0)
    assert start[1] > 1.5 * start[0] and (distance > 0.5).all()
    assert 1.0 < distance[1] / distance[0] < 1.1
    assert seconds * start == pytest.approx(distance * 9 / np.log(10), rel=0.1)


@pytest.mark.thorough
def test_a_bent_tail_stops_the_fish_sooner():
    assert (stopped(SPACE.offset)[1] < stopped(0.0)[1]).all()


def test_a_fish_that_goes_on_has_no_way_to_stop():
    found = stops(POOL, SPACE, [Command(2.0, 1.0, 0.0)], Command(0.0, 0.0, 0.0), (6.0, 0.5), quiet)
    assert np.isinf(found.distance).all() and np.isinf(found.seconds).all()


# ---- what follows -------------------------------------------------------------------------------

# Two waters. The beat of 0.5 Hz is slower than the band; that of 2 Hz and 0.1 rad does not turn.
GAITS = (
    gait(0.5, 0.4, 0.0, (0.03, 0.04), (np.inf, np.inf), (0.0, 0.0)),
    gait(0.5, 0.4, 0.4, (0.02, 0.03), (0.2, 0.3), (0.1, 0.1)),
    gait(2.0, 0.1, 0.0, (0.06, 0.05), (np.inf, np.inf), (0.0, 0.0)),
    gait(2.0, 0.1, 0.4, (0.05, 0.05), (0.9, 1.0), (0.06, 0.05)),
    gait(2.0, 0.4, 0.0, (0.2, 0.22), (np.inf, np.inf), (0.0, 0.0)),
    gait(2.0, 0.4, 0.4, (0.10, 0.12), (0.4, 0.5), (0.25, 0.24)),
    gait(2.0, 0.4, 0.8, (0.08, 0.09), (0.3, 0.35), (0.27, 0.26)),
)
BAND = (1.0, 4.0)


def made(gaits: tuple[Gait, ...]) -> SwimLimits:
    return SwimLimits(
        "a", None, 2, "b", BAND, 0.6, 0.05, (), (), (), (), (), (Place("pool", gaits, ()),)
    )


@pytest.mark.parametrize(
    ("speed", "radius", "lowest", "may"),
    [
        (0.10, 0.35, 1.0, True),  # by the last gait: 0.09 m/s and 0.35 m in the second water
        (0.10, 0.34, 1.0, False),  # too tight in the second water
        (0.085, 0.35, 1.0, False),  # too slow in the second water
        (0.085, 0.34, 0.0, True),  # by the beat below the band
        (0.02, 0.34, 0.0, False),  # slower than its 0.03 m/s in the second water
        (0.21, 0.35, 0.0, False),  # faster than 0.2 m/s in the first
    ],
)
def test_what_is_allowed_agrees_with_a_case_worked_by_hand(speed, radius, lowest, may):
    assert allowed(made(GAITS), speed, radius, lowest) is may


def test_the_slowest_steerable_beat_is_found_in_the_band_and_below_it():
    inside, below = limit_rows.slowest("pool", GAITS, BAND, 0.6, 0.05)
    assert (inside.steerable.default, inside.steerable.high) == (0.2, 0.22)
    assert (inside.in_turn.default, inside.circle.high, inside.centre) == (0.08, 0.35, 0.8)
    assert (inside.straight.default, inside.straight.low) == (0.06, 0.05)  # the naive baseline
    assert (below.steerable.default, below.steerable.high, below.frequency) == (0.03, 0.04, 0.5)


def test_a_beat_that_turns_too_slowly_or_too_widely_does_not_steer():
    tight, _ = limit_rows.slowest("pool", GAITS, BAND, 0.32, 0.05)
    quick, _ = limit_rows.slowest("pool", GAITS, BAND, 0.6, 0.5)
    assert tight.steerable.default == 0.2 and tight.steerable.high == np.inf
    assert quick.steerable.low == np.inf and quick.frequency is None


def test_circles_stand_beside_their_speed():
    by_speed = {row.above: row for row in limit_rows.circles("pool", GAITS, BAND, 1.0)}
    assert by_speed[0.06].band.default == 0.3 and by_speed[0.06].band.high == np.inf
    assert by_speed[0.02].band.default == np.inf and by_speed[0.02].all.default == 0.2
    assert limit_rows.front(GAITS).tolist() == [[0.02, 0.2]]
    assert limit_rows.front(GAITS[2:]).tolist() == [[0.05, 0.9], [0.08, 0.3]]


def test_a_path_is_asked_of_beats_and_of_bursts():
    bursts = (gait(2.0, 1.0, 0.8, (0.05, 0.05), (0.5, 0.5), (0.1, 0.1)),)
    rows = {row.path: row for row in path_rows("pool", GAITS, bursts, BAND, Measure())}
    quick, slow = rows["circle 0.12 m/s"], rows["circle 0.06 m/s"]
    assert (quick.slowest.default, quick.slowest.high) == (0.08, 0.09)
    assert (quick.tightest.default, quick.tightest.high) == (0.3, 0.35)
    assert (quick.band, quick.all, quick.bursts, quick.waters) == (2, 2, 2, 2)
    assert slow.tightest.default == 0.9  # too wide for a circle of 0.8 m
    assert (slow.band, slow.all, slow.bursts) == (0, 2, 2)
    assert rows["eight 73 s"].speed == pytest.approx(lap_length(eight) / 73)
    assert not [name for name in rows if "led" in name]


def test_least_radii_of_curves_that_are_known():
    assert least_radius(circle) == pytest.approx(0.8, rel=1e-3)
    corner = 0.8 * 2**-0.25 / (3 / np.sqrt(2))  # of x^4 + y^4 = 0.8^4, at x = y
    assert least_radius(square) == pytest.approx(corner, rel=0.01)
    angle = np.linspace(0, 2 * np.pi, 20001)
    dx, dy = 1.6 * np.cos(angle), 1.2 * np.cos(2 * angle)
    bend = dx * -2.4 * np.sin(2 * angle) + dy * 1.6 * np.sin(angle)
    assert least_radius(eight) == pytest.approx(
        1 / np.abs(bend / np.hypot(dx, dy) ** 3).max(), rel=0.01
    )


def test_the_grid_holds_beats_in_the_band_and_below_it():
    own = {one.frequency for one in beats_of(SPACE, BAND, Grid())}
    assert min(own) == pytest.approx(0.3) and max(own) == pytest.approx(SPACE.ceiling)
    assert sum(one >= 1.0 for one in own) == 4 and 1.0 in own
    assert min(one.frequency for one in beats_of(SPACE, (0.0, 4.0), Grid())) > 0


# ---- the verb -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def written(tmp_path_factory) -> tuple[Path, str]:
    """A run over a grid that is small and does not settle: its folder, and what it printed."""
    folder = tmp_path_factory.mktemp("limits")
    words = "--grid", "coarse", "--waters", 2, "--out", folder / "out", "--json", folder / "a.json"
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(limits.GRIDS, "coarse", SMALL)
        patch.setenv("COLUMNS", "240")  # no table is transposed or split
        done = tailbeat("limits", "--twin", "pulley-fish-pool", *words)
    assert done.returncode == 0, done.stderr
    assert "swims in the pool" in done.stderr and "%" in done.stderr
    return folder, done.stdout


def shown(value: object) -> str:
    """A value of the JSON as the tables print it."""
    if not isinstance(value, dict):
        return as_cell(value)
    default, low, high = (as_cell(value[name], 3) for name in ("default", "low", "high"))
    return default if low == high == default else f"{default} ({low} … {high})"


@pytest.mark.thorough
def test_the_printed_tables_equal_the_json(written):
    folder, text = written
    found = json.loads((folder / "a.json").read_text("utf-8"))
    printed = [tuple(cell.strip() for cell in line.split("│")[1:-1]) for line in text.splitlines()]
    tables = ("circles", "stops", "bursts", "paths")
    first = [[f"{row.pop('where')}, {row.pop('beats')}", *row.values()] for row in found["slowest"]]
    rows = [*first, *(row.values() for name in tables for row in found[name])]
    assert len(rows) > 30 and [row for row in printed if row] == [
        tuple(map(shown, row)) for row in rows
    ]
    assert {"pool, in the band", "twin, below the band"} <= {row[0] for row in printed if row}


@pytest.mark.thorough
def test_the_folder_has_numbers_and_a_figure_with_units(written, tmp_path, monkeypatch):
    folder = written[0]
    assert (folder / "out/limits.json").read_text() == (folder / "a.json").read_text()
    assert (folder / "out/limits.png").stat().st_size > 20_000
    places = (Place("pool", GAITS, GAITS[1:2]), Place("twin", GAITS, ()))
    stop = limit_rows.StopRow("pool", "bent", PLAIN, PLAIN, PLAIN)
    path = PathRow("pool", "eight", 0.4, 0.1, PLAIN, PLAIN, 1, 2, 2, 2)
    drawn = replace(made(GAITS), places=places, stops=(stop,), paths=(path, path))
    figure = saved(lambda to: limits_figure(drawn, to), monkeypatch, tmp_path / "a.png")
    assert not without_unit(figure) and colours(figure) <= ALLOWED


@pytest.mark.thorough
def test_the_json_s_keys_are_no_columns_of_a_recording(written):
    keys = set(re.findall(r'"(\w+)":', (written[0] / "a.json").read_text("utf-8")))
    assert {"steerable", "distance"} <= keys
    assert not [key for key in keys if re.search(r"_(m|s|rad|deg|hz|m_s)$", key)]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("--fish crank-fish", "crank-fish: its motor is a crank"),
        ("--twin crank-fish --waters 1", "crank-fish: its motor is a crank"),
        ("--fish nothing", "nothing: no such fish"),
        ("--grid fine", "--grid 'fine': allowed are full, coarse"),
        ("--waters 0", "--waters 0: allowed are 1 to 100"),
        ("--seed -1", "--seed"),
        ("--out full", "full/limits.png: exists already"),
        ("--json full/limits.png", "full/limits.png: exists already"),
    ],
)
def test_bad_input_is_one_sentence_and_leaves_nothing(words, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "limits.png").touch()
    assert said in complaint("limits", *words.split(), cwd=tmp_path)
    assert [one.name for one in tmp_path.rglob("*")] == ["full", "limits.png"]
