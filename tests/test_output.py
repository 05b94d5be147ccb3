"""Tables at 80 columns, and progress in a pipe."""

import itertools
import re

import pytest

from tailbeat.cli import output, progress
from tailbeat.cli.layout import fitted, needed
from tailbeat.cli.progress import counting, now_and_then, search_progress

NARROW = [
    {"arm [mm]": 15.0, "stiffness [N m/rad]": 1.234567, "covered": "yes"},
    {"arm [mm]": 30.0, "stiffness [N m/rad]": None, "covered": "NO"},
]
MANY = 14


def wide(rows: int) -> list[dict[str, object]]:
    """Rows with more numbers than 80 columns take; each cell is found again by its digits."""
    columns = [f"column {c} [deg]" for c in range(MANY)]
    return [
        {"name": f"row{r}", **{name: 1000 * r + 10 * c + 1 for c, name in enumerate(columns)}}
        for r in range(1, rows + 1)
    ]


def shown(rows, capsys, monkeypatch, columns=80) -> str:
    monkeypatch.setenv("COLUMNS", str(columns))
    output.tables({"speeds [m/s]": rows})
    return capsys.readouterr().out


def test_units_in_headers_titles_and_cells_are_shown(capsys, monkeypatch):
    text = shown([*NARROW, {"covered": "in [s]"}], capsys, monkeypatch)
    for word in ("speeds [m/s]", "arm [mm]", "stiffness [N m/rad]", "in [s]", "1.235", " - "):
        assert word in text


@pytest.mark.parametrize("rows", [1, 2, 3, 30])
def test_no_cell_is_cut_at_eighty_columns(rows, capsys, monkeypatch):
    table = wide(rows)
    text = shown(table, capsys, monkeypatch)
    assert max(map(len, text.splitlines())) <= 80 and "…" not in text
    for row in table:
        for name, value in row.items():
            assert name in text or name == "name"
            assert re.search(rf"\b{value}\b", text), (name, value)


def test_a_table_too_wide_is_turned_if_that_fits_and_split_otherwise():
    (turned,) = fitted(wide(2), 80)
    assert list(turned[0]) == ["name", "row1", "row2"] and len(turned) == MANY
    parts = fitted(wide(30), 80)
    assert len(parts) > 1 and all(needed(part) <= 80 for part in parts)
    assert all(next(iter(part[0])) == "name" and len(part) == 30 for part in parts)
    assert fitted(wide(2), 400) == [wide(2)]
    twice = [{**row, "name": "same"} for row in wide(2)]  # heads that do not tell rows apart
    assert len(fitted(twice, 80)) > 1


def test_long_text_wraps_between_words(capsys, monkeypatch):
    rows = [
        {"finding": "servo", "do": f"{n} " + "look at the cable and its plug " * 5} for n in "ab"
    ]
    text = shown(rows, capsys, monkeypatch)
    assert text.count("plug") == 10 and max(map(len, text.splitlines())) <= 80


def test_a_pipe_gets_a_line_at_once_one_now_and_then_and_the_last(capsys):
    clock = itertools.count(0.0, 10.0).__next__  # 10 s between two looks
    report = now_and_then(30.0, clock)
    for done in (0.1, 0.2, 0.3, 0.4, 0.5, 1.0):
        report("reach", done)
    lines = capsys.readouterr().err.splitlines()
    assert lines == [
        "reach: 10 %, 0:00:10 elapsed, 0:01:30 left",
        "reach: 40 %, 0:00:40 elapsed, 0:01:00 left",
        "reach: 100 %, 0:01:00 elapsed",
    ]


def test_the_time_of_other_work_counts_from_its_own_begin(capsys):
    now = [0.0]
    report = now_and_then(0.0, lambda: now[0])
    for time, done in ((0.0, 0.1), (100.0, 1.0), (110.0, 0.1), (120.0, 0.2)):
        now[0] = time
        report("search", done)
    said = capsys.readouterr().err.splitlines()
    assert said[1].endswith("100 %, 0:01:40 elapsed")
    assert said[3].endswith("20 %, 0:00:10 elapsed, 0:00:40 left")


def test_a_part_whose_total_grows_is_the_same_work(capsys, monkeypatch):
    """The margins learn of more cells as they go on; the part after them has a time of its own."""
    now = [0.0]
    monkeypatch.setattr(progress, "now_and_then", lambda: now_and_then(0.0, lambda: now[0]))
    seen = (("cells", 2, 4), ("cells", 60, 180), ("fit", 70, 280), ("fit", 5, 5), ("fit", 1, 5))
    with counting() as count:
        for step, row in enumerate(seen, 1):
            now[0] = 60.0 * step
            count(*row)
    said = [
        line.split(" %, ")[1].split(" elapsed")[0]
        for line in capsys.readouterr().err.split("\n")[:-1]
    ]
    assert said == ["0:01:00", "0:02:00", "0:00:00", "0:01:00", "0:00:00"]


def test_counting_and_a_search_say_in_a_pipe_where_they_are(capsys):
    with counting() as count:
        count("reach", 1, 4)
        count("reach", 4, 4)
    with search_progress() as search:
        search(2, "search", 0.5, 12.345)
        search(2, "draws", 1.0, 12.345)
    lines = capsys.readouterr().err.splitlines()
    assert [line.split(":")[0] for line in lines] == [
        "reach 1/4", "reach 4/4", "seed 2 search, cost 12.35", "seed 2 draws, cost 12.35",
    ]  # fmt: skip
    assert "30 %" in lines[2] and "100 %" in lines[3]
