"""What people type and what programs leave: each is one sentence, and nothing is half-written."""

import re
from pathlib import Path

import pytest

from support import complaint, tailbeat
from tailbeat.files import BadInput
from tailbeat.fish.store import fish_path, load_fish
from tailbeat.importers.table import TableConfig, import_table
from tailbeat.pool import mess
from tailbeat.recording import read_recording

FISH = fish_path("pulley-fish").read_text("utf-8")
LONG = "n" * 300


def written(path: Path, old: str, new: str) -> Path:
    path.write_text(FISH.replace(old, new), encoding="utf-8")
    return path


def test_a_byte_order_mark_of_a_windows_editor_is_read_over(tmp_path):
    path = tmp_path / "a.toml"
    path.write_bytes(b"\xef\xbb\xbf" + FISH.encode())
    assert load_fish(path) == load_fish("pulley-fish")


def test_a_body_without_mass_and_a_size_beyond_all_are_named(tmp_path):
    light = tmp_path / "light.toml"
    lines = [line for line in FISH.split("\n") if not line.startswith("mass =")]
    light.write_text("\n".join(lines), encoding="utf-8")
    assert "mass" in complaint("show", light)
    huge = written(tmp_path / "huge.toml", 'size = "220 70 110 mm"', 'size = "1e300 70 110 mm"')
    assert "1e+300 is beyond 1e+10 in SI" in complaint("show", huge)
    bare = written(tmp_path / "bare.toml", 'size = "220 70 110 mm"', "size = [1e300, 0.07, 0.11]")
    assert "is beyond 1e+10 in SI" in complaint("show", bare)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("show", LONG), "File name too long; choose another path"),
        (("new-fish", f"{LONG}.toml", "--length", "280mm", "--mass", "350g"), "File name too long"),
        (("show", "pulley-fish", "--picture", "a.xyz"), "--picture a.xyz: allowed are .png"),
        (("record", "tail", "--fish", "pulley-fish", "--out", "d", "--seed", "-1"), "'--seed'"),
    ],
    ids=["fish", "new fish", "picture", "seed"],
)
def test_words_that_cannot_be_are_one_sentence(tmp_path, monkeypatch, words, said):
    monkeypatch.chdir(tmp_path)
    assert said in complaint(*words)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("benchmark --json plain.txt/a.json", "plain.txt is not a folder"),
        ("swim --direct --out plain.txt/a", "plain.txt is not a folder"),
        ("latency --json plain.txt/a.json", "plain.txt is not a folder"),
        ("speed-map --fish pulley-fish --out a.xyz", "written as .png, .svg, .pdf"),
        ("faults --policy nothing", "nothing: no such file"),
        ("zoo --out zoo --targets 0", "--targets 0: give 2 or more"),
        ("evaluate pulley-fish-pool-generator --out e --walls 1e9x1e9", "must be 0.3 to 100 m"),
        ("evaluate pulley-fish-pool-generator --out e --walls nanx2", "must be 0.3 to 100 m"),
        ("torque-off --servo plain.txt --baud 1000000000000", "--baud 1000000000000: give 1 to"),
        ("torque-off --servo plain.txt --id 999", "--id 999: give 0 to 252"),
        ("track --camera a --calibration /dev/zero", "/dev/zero: no such file"),
        ("emulate --key plain.txt --robot " + LONG + ":1", "no name of a host"),
    ],
)  # fmt: skip
def test_bad_words_are_refused_before_any_work(tmp_path, words, said):
    (tmp_path / "plain.txt").write_text("kept")
    (tmp_path / "plain.txt").chmod(0o600)
    (tmp_path / "plain.txt").write_bytes(bytes(32))  # a key
    assert said in complaint(*words.split(), cwd=tmp_path)
    assert [one.name for one in tmp_path.iterdir()] == ["plain.txt"]


def test_a_line_s_end_in_a_name_does_not_make_two_lines(tmp_path):
    assert r"two\nlines" in complaint("show", "two\nlines", cwd=tmp_path)
    assert r"\x1b[31m" in complaint("show", "\x1b[31mred", cwd=tmp_path)


def test_the_middle_of_a_long_complaint_is_left_out(tmp_path):
    (tmp_path / "a.csv").write_text(("x" * 5000 + ",1" * 17 + "\n") * 3)
    said = complaint("import", "fishsim", tmp_path / "a.csv", "--out", tmp_path / "b.csv")
    assert len(said) < 1500


@pytest.mark.parametrize("link", ["hole", "loop"])
def test_a_link_to_nothing_is_kept(tmp_path, link):
    (tmp_path / link).symlink_to("loop")
    assert "exists already" in complaint("key", tmp_path / link)
    assert (tmp_path / link).is_symlink()


@pytest.mark.parametrize("end", ["csv", "json"])
def test_a_cell_beyond_the_reader_s_limit_and_a_number_beyond_python_s(tmp_path, end):
    text = "t,a\n" + "1" * 200_000 + ",1\n2,2\n" if end == "csv" else '[{"t": ' + "1" * 5000 + "}]"
    path = tmp_path / f"a.{end}"
    path.write_text(text)
    out = "--out", tmp_path / "o.csv"
    assert "a." in complaint("import", "table", path, "--map", "time=t,angle=a", *out)
    if end == "csv":
        assert "field limit" in complaint("predict", path, "--fish", "pulley-fish")
    else:
        assert "not JSON" in complaint("import", "xl330", path, *out)


def test_a_number_of_thousands_of_digits_in_a_fish(tmp_path):
    assert "not valid TOML" in complaint(
        "show", written(tmp_path / "a.toml", "[motor]", "[motor]\nodd = " + "1" * 5000)
    )


@pytest.mark.parametrize("name", ["deep.toml", "deep.json"])
def test_nesting_without_end_is_one_sentence(tmp_path, name):
    text = "a = " + "[" * 3000 + "]" * 3000 if name.endswith("toml") else "[" * 100_000
    (tmp_path / name).write_text(text)
    verb = ("show",) if name.endswith("toml") else ("import", "table")
    more = () if verb == ("show",) else ("--map", "time=t", "--out", tmp_path / "o.csv")
    done = tailbeat(*verb, tmp_path / name, *more)
    assert done.returncode == 2 and "nested too deeply" in done.stderr


# ---- what an outside audit typed ----------------------------------------------------------------


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ('tag_sideway = "3 mm"', "unknown field tag_sideway; remove it, or use tag_sideways or"),
        ('"tag sideways" = "3 mm"', "unknown field tag sideways; remove it, or use tag_sideways"),
        ("horn = true", "horn = True: true and false are no quantities"),
    ],
    ids=["misspelt", "with a space", "no quantity"],
)
def test_a_lab_s_figure_that_cannot_be_is_named(tmp_path, lines, said):
    path = tmp_path / "lab.toml"
    path.write_text(f"[lab]\n{lines}\n", encoding="utf-8")
    with pytest.raises(BadInput, match=re.escape(f"{path}: lab: {said}")):
        mess.level(str(path))


def test_a_table_of_times_alone_or_of_other_separators_is_refused(tmp_path):
    table = tmp_path / "semi.csv"
    table.write_text("time_s;angle_rad\n0;0.1\n1;0.2\n2;0.3\n", encoding="utf-8")
    with pytest.raises(BadInput, match=r"separated by semicolons; .* `tailbeat import table`"):
        read_recording(table)
    with pytest.raises(BadInput, match=r"--map names the time alone; name the signals too"):
        import_table(table, TableConfig({"time": "time_s"}))


def test_hours_without_a_training_and_a_posterior_by_another_name_are_refused(tmp_path):
    asked = ("refine", "pulley-fish-pool-reach", "--log", "a.mcap", "--out", tmp_path / "r")
    assert "--start and --hours only with them" in complaint(*asked, "--hours", "3")
    asked = ("identify", "posterior", "--fish", "pulley-fish-pool", "--fit", "a.csv")
    said = complaint(*asked, "--out", tmp_path / "z.csv")
    assert "a posterior is a Parquet file; give a name in .parquet" in said
    assert list(tmp_path.iterdir()) == []
