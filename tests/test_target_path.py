"""A target's path by the clock: named ones, files, and what is refused before a start."""

from pathlib import Path

import numpy as np
import pytest

from support import complaint
from tailbeat.control.measure import PAPER, SPEED, Measure
from tailbeat.evaluate.path_start import behind
from tailbeat.files import BadInput
from tailbeat.link.places import POOL, pose
from tailbeat.operator.paths import MARGIN
from tailbeat.operator.target_path import (
    CLOSED,
    EIGHT,
    JUMP,
    LONGEST,
    NAMES,
    PathAsked,
    TargetPath,
    target_path,
)

SMALL = Measure(0.5, 0.5, 0.4, 0.1)  # of a fish of half the size
LINE = "x,y\n0,0\n0.1,0\n0.2,0\n0.3,0.1\n"
TIMED = "time,y,x\n# at noon\n10,0,0\n12,0,0.1\n\n13,0,0.2\n15,0.1,0.2\n"


def written(folder: Path, text: str | bytes, name: str = "path.csv") -> str:
    file = folder / name
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    return str(file)


def speeds(path: TargetPath, seconds: float) -> np.ndarray:
    """Between places 20 ms apart [m/s]."""
    places = path.along(np.arange(0, seconds, 0.02))
    return np.asarray(np.hypot(*np.diff(places, axis=0).T) / 0.02)


# ---- named paths --------------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_a_named_path_repeats_at_an_even_speed_inside_the_pool(name):
    path = target_path(PathAsked(name, laps=2))
    assert path.closed and path.seconds == pytest.approx(2 * path.lap)
    assert path.at(0.0) == pytest.approx(path.at(path.lap), abs=1e-6)
    assert path.at(7.0) == pytest.approx(path.at(7.0 + path.lap), abs=1e-6)
    assert path.at(-3.0) == path.at(0.0)  # it rests until the fish swims
    assert speeds(path, 2 * path.lap) == pytest.approx(path.speed, rel=0.02)
    assert (np.abs(path.places) <= np.array(POOL) / 2 - MARGIN).all()


def test_the_figure_eight_takes_the_paper_s_time_and_the_others_go_at_the_usual_speed():
    eight = target_path(PathAsked(EIGHT))
    assert eight.lap == eight.seconds == 73.0
    assert np.ptp(eight.places, axis=0) == pytest.approx([3.2, 1.2], rel=1e-3)
    for name in ("circle", "square"):
        assert target_path(PathAsked(name)).speed == pytest.approx(0.12, rel=1e-3)
    assert target_path(PathAsked(EIGHT, speed=0.2)).speed == pytest.approx(0.2, rel=1e-3)
    assert target_path(PathAsked("circle", seconds=5.0)).seconds == 5.0


def test_a_small_fish_gets_a_small_path_in_its_own_time():
    whole, small = target_path(PathAsked(EIGHT)), target_path(PathAsked(EIGHT), measure=SMALL)
    assert np.ptp(small.places, axis=0) == pytest.approx(0.5 * np.ptp(whole.places, axis=0))
    assert small.speed == pytest.approx(0.4 * whole.speed)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("measure", [PAPER, SMALL])
def test_the_fish_starts_behind_the_path_and_looks_along_it(name, measure):
    path = target_path(PathAsked(name), measure=measure)
    x, y, yaw = behind(path, measure)
    ahead = np.array([np.cos(yaw), np.sin(yaw)])
    way = path.places[0] - (x, y)
    assert 0.3 * measure.reach < np.hypot(*way) <= 1.0 and way @ ahead == pytest.approx(
        np.hypot(*way)
    )
    step = np.array(path.at(0.5)) - path.places[0]
    assert step @ ahead > 0.99 * np.hypot(*step)
    tail = np.array([x, y]) - 0.54 * measure.size * ahead
    assert (np.abs(tail) <= np.array(POOL) / 2 + 1e-9).all()


@pytest.mark.parametrize("size", [1.0, 2.13])
@pytest.mark.parametrize(
    ("x", "y", "heading"),
    [(-2.3, 0, 0), (-2.0, 0.3, 0), (0, -0.95, 90), (-2.35, -0.95, 45), (2.3, 0.9, 200)],
)
def test_a_fish_near_a_wall_starts_behind_its_target_with_its_tail_inside(x, y, heading, size):
    """It started upon its target, with the tail beyond the wall."""
    ahead = np.array([np.cos(np.radians(heading)), np.sin(np.radians(heading))])
    places = np.array([x, y]) + np.linspace(0, 0.5, 9)[:, None] * ahead
    path, measure = TargetPath("line", np.arange(9.0), places, False, 8.0), Measure(size=size)
    *tag, yaw = behind(path, measure)
    way, looks = places[0] - tag, np.array([np.cos(yaw), np.sin(yaw)])
    assert way == pytest.approx(np.hypot(*way) * looks) and np.hypot(*way) > 0.49 * size
    for end in (np.array(tag), tag - 0.54 * size * looks):
        assert (np.abs(end) <= np.array(POOL) / 2 + 1e-9).all()


def test_a_fish_that_is_too_long_for_the_pool_is_refused():
    path = target_path(PathAsked("circle"))
    with pytest.raises(BadInput, match=r"a fish of 5\.4 m has no room behind the path"):
        behind(path, Measure(size=10.0))


# ---- files --------------------------------------------------------------------------------------


def test_a_file_without_times_is_walked_at_the_speed_given(tmp_path):
    path = target_path(PathAsked(written(tmp_path, LINE), speed=0.2))
    assert path.at(0.5) == pytest.approx((0.1, 0.0)) and not path.closed
    assert path.lap == pytest.approx((0.2 + 0.1 * 2**0.5) / 0.2) == path.seconds
    assert path.at(1e6) == pytest.approx((0.3, 0.1))  # it rests at the end
    assert target_path(PathAsked(written(tmp_path, LINE))).speed == pytest.approx(0.12)


def test_a_file_with_times_goes_by_them_from_its_first(tmp_path):
    path = target_path(PathAsked(written(tmp_path, b"\xef\xbb\xbf" + TIMED.encode())))
    assert path.lap == 5.0 and path.at(1.0) == pytest.approx((0.05, 0.0))
    assert path.at(2.5) == pytest.approx((0.15, 0.0)) and path.at(4.0) == pytest.approx((0.2, 0.05))


@pytest.mark.parametrize("head", ["time_s,y_m,x_m", "Time, Y ,X", "t,y,x,"])
def test_columns_have_their_unit_or_not_in_any_case(tmp_path, head):
    """They were walked at the default speed if the time was not called `time`."""
    path = target_path(PathAsked(written(tmp_path, TIMED.replace("time,y,x", head) + " , \n  \n")))
    assert path.lap == 5.0 and path.at(1.0) == pytest.approx((0.05, 0.0))


def test_a_file_that_ends_where_it_begins_repeats(tmp_path):
    loop = f"x,y\n0,0\n0.2,0\n0.2,0.2\n0,0.2\n0,{CLOSED / 2}\n"
    path = target_path(PathAsked(written(tmp_path, loop), laps=3))
    assert path.closed and path.seconds == pytest.approx(3 * path.lap)
    assert path.at(path.lap + 1.0) == pytest.approx(path.at(1.0))


def points(*rows: tuple[float, ...], head: str = "x,y") -> str:
    return "\n".join([head, *(",".join(map(str, row)) for row in rows)])


FEW = points((0, 0), (0.1, 0), (0.2, 0))
FAST = points((0, 0, 0), (1, 0.1, 0), (1.2, 0.2, 0), (2, 0.25, 0), head="time,x,y")
JUMPS = points((0, 0), (0.1, 0), (0.1 + JUMP + 0.01, 0), (0.5, 0))
OUTSIDE = points((2.2, 0), (2.3, 0), (2.4, 0), (2.3, 0))
BAD_FILES: dict[str, tuple[str | bytes, str]] = {
    "few points": (FEW, "3 points; a path needs 4 or more"),
    "faster than the fish": (FAST, "lines 3 and 4: the target moves at 0.50 m/s; at most 0.45"),
    "a jump": (JUMPS, "lines 3 and 4: the path jumps by 0.26 m"),
    "outside": (OUTSIDE, "line 4: x 2.40, y 0.00 m is outside the pool or less than 0.4 m from"),
    "no column": ("x,z\n1,2\n", "no column y; its first line must name"),
    "twice": ("x,y,x\n1,2,3\n", "two columns x"),
    "twice by two names": ("x,y,t,time_s\n1,2,3,4\n", "two columns time"),
    "another time": (
        points((0, 0, 0), head="x,y,time_ms"),
        "unknown column 'time_ms'; allowed are x",
    ),
    "huge": (LINE + "1e308,0\n", "line 6: x is '1e308'; give a finite number of metres, at most"),
    "no number": (LINE + "0.4,abc\n", "line 6: y is 'abc'; give a finite number of metres"),
    "not finite": (LINE + "0.4,inf\n", "line 6: y is 'inf'"),
    "short line": (LINE + "0.4\n", "line 6: y is ''"),
    "time goes back": (TIMED + "14,0,0\n", "time goes from 15 to 14 s; it must rise"),
    "time stands": (TIMED + "15,0,0\n", "time goes from 15 to 15 s; it must rise"),
    "one place": (points(*[(0.1, 0.1)] * 5), "all points are the same place"),
    "empty": ("", "has nothing"),
    "a picture": (b"\x89PNG\r\n\x1a\n\x00\xff\xfe", "not a CSV file"),
}


@pytest.mark.parametrize("kind", BAD_FILES)
def test_a_bad_file_is_refused_before_anything_moves(tmp_path, kind):
    text, said = BAD_FILES[kind]
    out = tmp_path / "out"
    line = complaint("swim", "--headless", "--path", written(tmp_path, text), "--out", out)
    assert said in line and "path.csv" in line and not out.exists()


BAD_WORDS = {
    ("--path", "spiral"): "--path spiral: no such file; give a CSV file, or circle",
    ("--path", "."): "--path .: Is a directory",
    ("--path", "circle", "--speed", "0.5"): "--speed 0.5: allowed are speeds above 0 and up to",
    ("--path", "circle", "--speed", "0"): "--speed 0: allowed are",
    ("--path", "circle", "--speed", "nan"): "--speed nan: allowed are",
    ("--path", "circle", "--laps", "0"): "--laps 0: give 1 or more",
    ("--path", "circle", "--laps", "2", "--seconds", "9"): "--laps 2 and --seconds 9: give one",
    ("--path", "circle", "--seconds", "-1"): "--seconds -1: give a time above 0",
    ("--path", "circle", "--laps", 400 * "9"): "--laps 99999999999999999999: give 1 or more, up",
    ("--path", "circle", "--seconds", "1e308"): "it takes 1e+308 s",
    ("--path", "circle", "--laps", "1000"): f"{LONGEST:g} s are allowed",
    ("--path", "circle", "--speed", "0.5", "--direct"): "--speed 0.5: allowed are speeds above 0",
    ("--path", "circle", "--fish", "pulley-fish"): "--fish: without a policy it follows no --path",
    ("--speed", "0.1"): "--speed 0.1: it is for a target on a path; add --path",
    ("--laps", "2"): "--laps 2: it is for a target on a path",
    ("--seconds", "2"): "--seconds 2: it is for a target on a path",
}


@pytest.mark.parametrize("words", BAD_WORDS, ids=lambda words: " ".join(words)[:40])
def test_what_a_path_cannot_be_is_one_sentence(tmp_path, words):
    out = tmp_path / "out"
    line = complaint("swim", "--headless", "--out", out, *words)
    assert BAD_WORDS[words] in line and not out.exists()


def test_an_open_path_has_one_lap_and_a_timed_one_its_own_speed(tmp_path):
    path, timed = written(tmp_path, LINE), written(tmp_path, TIMED, "timed.csv")
    for more in ({"laps": 2}, {"seconds": 60.0}):
        with pytest.raises(BadInput, match=r"it ends after 2\.845 s, and not where it begins"):
            target_path(PathAsked(path, **more))
    with pytest.raises(BadInput, match="has a column time; leave it out"):
        target_path(PathAsked(timed, speed=0.1))


def test_a_path_too_large_for_the_pool_or_too_fast_for_a_small_fish_is_refused():
    with pytest.raises(BadInput, match=r"--path circle: .* in this pool of 2 x 2 m, x -0.60 to"):
        target_path(PathAsked("circle"), (2.0, 2.0))
    with pytest.raises(BadInput, match=r"speeds above 0 and up to 0\.18 m/s"):
        target_path(PathAsked("circle", speed=0.3), measure=SMALL)
    assert target_path(PathAsked("circle", speed=SPEED)).speed == pytest.approx(SPEED, rel=1e-3)


@pytest.mark.parametrize(
    ("option", "said"),
    [
        (("--path", "circle"), "--path: needs the fish's poses; give --camera and --calibration"),
        (("--seconds", "5"), "--seconds 5: it is for a target on a path"),
    ],
)
def test_a_station_refuses_a_path_that_it_cannot_lead_along(tmp_path, option, said):
    words = ["--robot", "127.0.0.1:1", "--listen", "127.0.0.1:0", "--key", tmp_path / "key"]
    assert said in complaint("station", *words, *option)


def test_the_start_of_emulated_devices_is_a_pose_in_the_pool():
    assert pose("1,-0.5,90") == pytest.approx((1.0, -0.5, np.pi / 2))
    for text, said in (("1,2", "give x,y,heading"), ("0,0,nan", "give"), ("3,0,0", "outside")):
        with pytest.raises(BadInput, match=said):
            pose(text)
    line = complaint("emulate", "--camera", "/tmp/nobody.sock", "--start=9,9,0")
    assert "--start 9,9,0: outside the pool" in line
