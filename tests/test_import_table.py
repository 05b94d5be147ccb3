"""Any table becomes a recording in SI units, or one sentence says why not."""

import json
from typing import Any

import numpy as np
import polars as pl
import pytest

from support import complaint, tailbeat
from tailbeat.files import BadInput
from tailbeat.fish.store import load_fish
from tailbeat.identify.servo import as_bench, as_benches
from tailbeat.importers.table import TableConfig, import_table
from tailbeat.importers.xl330 import import_xl330
from tailbeat.recording import read_recording

DEG = TableConfig({"time": "t", "angle": "a"}, ["deg", "ms"])


def written(tmp_path, name: str, text: str):
    (tmp_path / name).write_text(text)
    return tmp_path / name


def test_a_csv_comes_in_si_units(tmp_path):
    file = written(tmp_path, "a.csv", "t;a;b\n0;0;x\n10;90;y\n20;180;z\n")
    found = import_table(file, DEG)
    assert found.time == pytest.approx([0.0, 0.01, 0.02])
    assert found.columns["angle_rad"] == pytest.approx([0, np.pi / 2, np.pi])
    assert found.meta["source"] == "not stated; imported from a.csv"


def test_every_form_of_json_and_parquet_gives_the_same(tmp_path):
    rows = [{"t": 10.0 * i, "a": 3.0 * i} for i in range(5)]
    lists = {name: [row[name] for row in rows] for name in ("t", "a")}
    pl.DataFrame(lists).write_parquet(tmp_path / "a.parquet")
    files = [tmp_path / "a.parquet"]
    forms: list[dict[str, Any] | list[Any]] = [rows, lists, {"kp": 7, "entries": rows}]
    forms.append({"kp": 7} | dict[str, Any](lists))
    for i, data in enumerate(forms):
        files.append(written(tmp_path, f"{i}.json", json.dumps(data)))
    for file in files:
        found = import_table(file, DEG)
        assert found.time == pytest.approx(0.01 * np.arange(5)), file
        assert found.columns["angle_rad"] == pytest.approx(np.radians(3.0 * np.arange(5))), file


def test_counts_lengths_and_conditions(tmp_path):
    text = "t,n,tau,c\n0,0,100,a\n1,1024,200,a\n0,2048,0,b\n1,4096,0,b\n"
    file = written(tmp_path, "a.csv", text)
    columns = {"time": "t", "angle": "n", "torque": "tau", "condition": "c"}
    found = import_table(file, TableConfig(columns, ["counts", "mNm"], counts_per_turn=4096))
    assert found.columns["angle_rad"] == pytest.approx(np.array([0, 0.5, 1, 2]) * np.pi)
    assert found.columns["torque_nm"] == pytest.approx([0.1, 0.2, 0, 0])
    assert found.labels["condition"].tolist() == ["a", "a", "b", "b"]


def test_a_servo_log_comes_as_its_own_importer_reads_it(data, tmp_path):
    log = data / "xl330" / "2026-01-15_10h28m10.json"
    out = tmp_path / "log.csv"
    done = tailbeat(
        "import", "table", log, "--out", out, "--rows", "entries", "--source", "our bench",
        "--map", "time=timestamp,angle=position,command=goal_position,enabled=torque_enable",
        "--meta", "gain=kp,load_mass_kg=mass,load_arm_m=length",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    found, known = read_recording(out), import_xl330(log, "our bench")
    assert known.meta["source"] == found.meta["source"] == "our bench"
    for name in ("angle_rad", "command_rad", "enabled_ratio"):
        assert np.array_equal(found.columns[name], known.columns[name]), name
    for name in ("gain", "load_mass_kg", "load_arm_m"):
        assert float(found.meta[name]) == float(known.meta[name]), name


def test_nothing_is_claimed_of_a_log_that_the_user_did_not_state(data, tmp_path):
    log = json.loads((data / "xl330" / "2026-01-15_10h28m10.json").read_text())
    other = written(tmp_path, "other.json", json.dumps({**log, "motor": "mx64"}))
    found = import_xl330(other)
    assert found.meta["source"] == "not stated; imported from other.json"
    assert found.meta["motor"] == "mx64" and "pwm_ratio" not in found.columns


@pytest.mark.parametrize(
    ("text", "config", "complaint"),
    [
        ("t,a\n0,1\n1,2\n", TableConfig({"time": "t", "angle": "pos"}),
         "column 'pos' .--map angle. is missing; there are t, a"),
        ("t,a\n0,1\n1,two\n", DEG, "column a, row 2: 'two' is not a finite number"),
        ("t,a\n0,1\n1,\n", DEG, "column a, row 2: '' is not a finite number"),
        ("t,a\n0,1\n2,1\n1,1\n", DEG, "column t, row 3: 0.001 s does not come after 0.002 s"),
        ("t,a\n0,1\n1,2\n", TableConfig({"angle": "a"}), "--map has no time"),
        ("t,a\n0,1\n1,2\n", TableConfig({"time": "t", "angel": "a"}), "--map angel: allowed are"),
        ("t,a\n0,1\n1,2\n", TableConfig(DEG.columns, ["grad"]), "--unit grad: unknown unit"),
        ("t,a\n0,1\n1,2\n", TableConfig(DEG.columns, ["counts"]), "needs --counts-per-turn"),
        ("t,a\n0,1\n1,2\n", TableConfig(DEG.columns, ["deg", "rad"]), "second unit of angle"),
        ("t,a\n0,1\n1,2\n", TableConfig(DEG.columns, [], {"gain": "kp"}), "not a header field"),
        ("t,a\n0,1\n1\n", DEG, "row 2 has 1 cells and the header 2"),
        ("", DEG, "a header and at least two rows"),
        ("t,a,a\n0,1,5\n1,2,6\n", DEG, "column 'a' appears twice; rename or remove one"),
    ],
)  # fmt: skip
def test_bad_tables_are_one_sentence(tmp_path, text, config, complaint):
    with pytest.raises(BadInput, match=complaint):
        import_table(written(tmp_path, "a.csv", text), config)


@pytest.mark.parametrize(
    ("text", "rows", "complaint"),
    [
        ("{", None, "not JSON"),
        ('{"kp": 1}', None, "no list of entries"),
        ('{"a": [{"t": 1}], "b": [{"t": 1}]}', None, "several lists of entries .a, b."),
        ('{"t": [1, 2], "a": [1]}', None, "lists of unequal length"),
        ('{"e": [{"t": 1}, {"t": 2}]}', "entries", "--rows 'entries' is not a list"),
        ("[1, 2]", None, "no list of two or more objects"),
        ('{"t": [], "a": []}', None, "a header and at least two rows"),
        ('[{"t": 0, "a": 1}, {"t": 1}]', None, "column a, row 2: None is not a finite number"),
    ],
)
def test_bad_json_is_one_sentence(tmp_path, text, rows, complaint):
    config = TableConfig(DEG.columns, rows=rows)
    with pytest.raises(BadInput, match=complaint):
        import_table(written(tmp_path, "a.json", text), config)


def test_an_empty_parquet_file_is_one_sentence(tmp_path):
    pl.DataFrame({"t": [], "a": []}).write_parquet(tmp_path / "a.parquet")
    with pytest.raises(BadInput, match=r"a\.parquet: give a table with a header"):
        import_table(tmp_path / "a.parquet", DEG)


def test_a_bad_map_exits_with_2_and_writes_nothing(tmp_path):
    file = written(tmp_path, "a.csv", "t,a\n0,1\n1,2\n")
    out = tmp_path / "o.csv"
    bad = tailbeat("import", "table", file, "--out", out, "--map", "time=when,angle=a")
    assert bad.returncode == 2 and "there are t, a" in bad.stderr and not out.exists()


def test_one_table_of_several_gains_loads_and_arms_is_what_its_logs_are(data, tmp_path):
    """Time starts anew with each log, and no log states a condition."""
    paths = sorted((data / "xl330").glob("*.json"))
    settings = {path: json.loads(path.read_text()) for path in paths}
    logs = list({(s["kp"], s["mass"], s["length"]): path for path, s in settings.items()}.values())
    rows = []
    for log in (settings[path] for path in logs):
        own = {"p": log["kp"], "kg": log["mass"], "m": log["length"]}
        rows += [{**own, **entry} for entry in log["entries"]]
    file = written(tmp_path, "all.json", json.dumps(rows))
    out = tmp_path / "all.parquet"
    done = tailbeat(
        "import", "table", file, "--out", out, "--map",
        "time=timestamp,angle=position,command=goal_position,enabled=torque_enable,"
        "gain=p,load_mass=kg,load_arm=m",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    fish = load_fish("pulley-fish")
    found = as_benches(read_recording(out), fish)
    known = [as_bench(import_xl330(log), fish) for log in logs]
    assert len(found) == len(known) > 2
    for one, true in zip(found, known, strict=True):
        assert (one.gain, one.load) == (true.gain, true.load)
        assert one.time == pytest.approx(true.time, abs=1e-9)
        assert np.array_equal(one.angle, true.angle, equal_nan=True)
    assert found[0].name.startswith("all, gain ") and len({one.name for one in found}) == len(logs)


def test_time_that_falls_while_no_setting_changes_is_refused(tmp_path):
    file = written(tmp_path, "a.csv", "t,a,p\n0,1,8\n1,2,8\n0,1,8\n1,2,9\n")
    config = TableConfig({"time": "t", "angle": "a", "gain": "p"})
    with pytest.raises(BadInput, match=r"row 3: 0 s does not come after 1 s"):
        import_table(file, config)


# ---- settings -----------------------------------------------------------------------------------

SETTINGS = {"time": "t", "gain": "p", "load_mass": "w", "load_arm": "l"}


def refusal(tmp_path, text: str, config: TableConfig, name: str = "a.csv") -> str:
    """The sentence with which a table is refused, without its folder."""
    with pytest.raises(BadInput) as refused:
        import_table(written(tmp_path, name, text), config)
    return str(refused.value).removeprefix(f"{tmp_path}/")


def test_settings_of_columns_come_in_si_units(tmp_path):
    file = written(tmp_path, "a.csv", "t,p,w,l\n0,8.0,490,10\n1,8,490,7\n2,9,500,15\n")
    found = import_table(file, TableConfig(SETTINGS, ["deg", "cm", "g"])).labels
    assert found["load_arm_m"].tolist() == ["0.1", "0.07", "0.15"]
    assert found["load_mass_kg"].tolist() == ["0.49", "0.49", "0.5"]
    assert found["gain"].tolist() == ["8", "8", "9"]


@pytest.mark.parametrize(
    ("row", "complaint"),
    [
        ("-200,1,1", "column p, row 2: '-200' is not a finite number above 0; correct"),
        ("8,inf,1", "column w, row 2: 'inf' is not a finite number above 0; correct"),
        ("8,1,long", "column l, row 2: 'long' is not a finite number above 0; correct"),
        (",1,1", "column p, row 2: the cell is empty, which only marker columns may be; correct"),
    ],
)
def test_a_wrong_setting_is_named_as_the_user_s_file_has_it(tmp_path, row, complaint):
    text = f"t,p,w,l\n0,8,1,1\n1,{row}\n"
    assert refusal(tmp_path, text, TableConfig(SETTINGS)).startswith(f"a.csv: {complaint}")


def test_an_unknown_load_is_refused(tmp_path):
    said = refusal(tmp_path, "t,w\n0,tail\n1,fin\n", TableConfig({"time": "t", "load": "w"}))
    assert said.startswith("a.csv: column w, row 2: 'fin' is not tail, pendulum or nothing")


@pytest.mark.parametrize("name", ["gain", "condition"])
def test_a_cell_of_nothing_is_no_word(tmp_path, name):
    config, rows = TableConfig({"time": "t", name: "c"}), {"t": [0, 1], "c": [8.0, None]}
    said = "column c, row 2: the cell is empty, which only marker columns may be"
    assert said in refusal(tmp_path, json.dumps(rows), config, "a.json")
    for empty in (None, float("nan")):
        pl.DataFrame({"t": [0, 1], "c": [8.0, empty]}).write_parquet(tmp_path / "a.parquet")
        with pytest.raises(BadInput, match=said):
            import_table(tmp_path / "a.parquet", config)


@pytest.mark.parametrize("counts", [0, -1, np.inf, np.nan])
def test_counts_per_turn_are_finite_and_above_0(tmp_path, counts):
    config = TableConfig(DEG.columns, ["counts"], counts_per_turn=counts)
    said = refusal(tmp_path, "t,a\n0,1\n1,2\n", config)
    assert said == "--unit counts needs --counts-per-turn, a finite number above 0."


# ---- metadata -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("meta", "complaint"),
    [
        (
            {"load_arm_m": "motor"},
            "header field motor (--meta load_arm_m) is 'mx64'; give a finite",
        ),
        ({"gain": "kp"}, "header field kp (--meta gain) is -8; give a finite number above 0."),
        ({"supply_v": "0"}, "--meta supply_v=0: not a finite number above 0, and not a header"),
        ({"gain": "true"}, "--meta gain=true: not a finite number above 0, and not a header"),
        ({"load": "fin"}, "--meta load=fin: not tail, pendulum or nothing, and not a header"),
        ({"motor": "none"}, "header field none (--meta motor) is None; give a word or a number."),
    ],
)
def test_metadata_that_no_recording_may_have(tmp_path, meta, complaint):
    rows = {"motor": "mx64", "kp": -8, "none": None, "t": [0, 1], "a": [1, 2]}
    said = refusal(tmp_path, json.dumps(rows), TableConfig(DEG.columns, meta=meta), "a.json")
    assert said.startswith(f"a.json: {complaint}")


def test_comments_of_a_csv_are_kept_as_those_of_our_own_recordings(tmp_path):
    heading = "# gain: 8,,\n# load_mass_kg: 0.5\n#source: lab: B\n# operator: A\n# load:\n"
    file = written(tmp_path, "a.csv", f"{heading}t,a,p\n0,1,8.0\n1,2,8.0\n")
    found = import_table(
        file, TableConfig({**DEG.columns, "gain": "p"}, [], {"load_mass_kg": ".5"})
    )
    assert found.meta == {"gain": "8", "load_mass_kg": ".5", "source": "lab: B"}
    assert import_table(file, TableConfig(DEG.columns, source="us")).meta["source"] == "us"


def test_metadata_of_a_parquet_recording_are_kept(tmp_path):
    rows = pl.DataFrame({"t": [0, 1], "a": [1, 2]})
    rows.write_parquet(tmp_path / "a.parquet", metadata={"gain": "8", "pandas": "{}"})
    found = import_table(tmp_path / "a.parquet", DEG)
    assert found.meta == {"gain": "8", "source": "not stated; imported from a.parquet"}


@pytest.mark.parametrize(
    ("heading", "meta", "complaint"),
    [
        ("# gain: 8", {}, "metadata gain = '8' contradicts column p, row 2: '9'; correct"),
        ("# load: tail", {"load": "nothing"}, "metadata load = 'tail' contradicts --meta load=no"),
        ("# gain: high", {}, "metadata gain = 'high' is not a finite number above 0; correct"),
        ("# begin: a\n# begin: b", {}, "metadata begin is stated twice, 'a' and 'b'; remove one"),
    ],
)
def test_comments_that_contradict_are_refused(tmp_path, heading, meta, complaint):
    config = TableConfig({"time": "t", "gain": "p"}, meta=meta)
    said = refusal(tmp_path, f"{heading}\nt,p\n0,8\n1,9\n", config)
    assert said.startswith(f"a.csv: {complaint}")


def test_a_setting_from_two_options_and_a_name_given_twice_are_refused(tmp_path):
    file, out = written(tmp_path, "a.csv", "t,a,p\n0,1,8\n1,2,8\n"), tmp_path / "o.csv"
    words = "import", "table", file, "--out", out, "--map"
    said = complaint(*words, "time=t,angle=a,gain=p", "--meta", "gain=300")
    assert "--meta gain=300: --map already takes gain from column p; leave one of them out" in said
    assert "time is given twice; give it once" in complaint(*words, "time=t,time=a")
    assert "gain is given twice" in complaint(*words, "time=t", "--meta", "gain=1,gain=2")
    assert not out.exists()


def test_the_json_result_names_columns_and_no_metadata_overwrites_it(tmp_path):
    file, said = written(tmp_path, "a.csv", "t,a,p\n0,1,8\n1,2,8\n"), tmp_path / "said.json"
    out = tmp_path / "o.csv"
    done = tailbeat(
        "import", "table", file, "--out", out, "--map", "time=t,angle=a,gain=p", "--json", said,
        "--meta", "rows=5,columns=7,supply_v=7.4", "--source", "us",
    )  # fmt: skip
    assert done.returncode == 0 and "2 samples of angle_rad, gain" in done.stdout, done.stderr
    told = json.loads(said.read_text())
    assert (told["rows"], told["columns"]) == (2, ["angle_rad", "gain"])
    assert told["recording"] == str(out) and told["supply_v"] == "7.4" and told["source"] == "us"
    assert told["meta"] == {"source": "us", "rows": "5", "columns": "7", "supply_v": "7.4"}


# ---- files that are not as they should be -------------------------------------------------------


@pytest.mark.parametrize("text", ["0.000,0\n1,1\n2,2\n", "# t,a\n0,0\n1,1\n", "0,1\n1,2\n2,3\n"])
def test_a_missing_header_is_named(tmp_path, text):
    said = refusal(tmp_path, text, DEG)
    assert "so the header is missing or commented out; write the columns' names" in said


def test_a_header_of_numbers_is_read(tmp_path):
    file = written(tmp_path, "a.csv", "0,1\n0,90\n10,180\n")
    found = import_table(file, TableConfig({"time": "0", "angle": "1"}, ["deg", "ms"]))
    assert found.columns["angle_rad"] == pytest.approx([np.pi / 2, np.pi])


@pytest.mark.parametrize("value", ["0,000", "-1.000,5", ",5", "1,5e-3"])
def test_decimal_commas_are_named(tmp_path, value):
    said = refusal(tmp_path, f"t;a\n{value};1\n1;2\n", DEG)
    assert said == (
        f"a.csv: column t, row 1: '{value}' has a decimal comma, which is not read; write decimal"
        " points in the whole file."
    )


def test_json_lists_that_are_not_mapped_may_have_another_length(tmp_path):
    rows = {"pid": [4], "t": [0, 10, 20], "a": [0, 90, 180], "none": []}
    found = import_table(written(tmp_path, "a.json", json.dumps(rows)), DEG)
    assert found.columns["angle_rad"] == pytest.approx([0, np.pi / 2, np.pi])
    config = TableConfig({"time": "t", "angle": "pid"})
    said = refusal(tmp_path, json.dumps(rows), config, "a.json")
    assert "lists of unequal length ({'t': 3, 'pid': 1}); make them equal" in said
    only = TableConfig({"time": "pid", "angle": "pid"})
    assert "at least two rows" in refusal(tmp_path, json.dumps(rows), only, "a.json")


def test_json_rows_may_be_an_object_of_lists(tmp_path):
    rows = {"kp": 8, "data": {"t": [0, 10], "a": [90, 180], "mass": 0.5}}
    meta = {"gain": "kp", "load_mass_kg": "mass"}
    file = written(tmp_path, "a.json", json.dumps(rows))
    found = import_table(file, TableConfig(DEG.columns, DEG.units, meta, "data"))
    assert found.columns["angle_rad"] == pytest.approx([np.pi / 2, np.pi])
    assert found.meta["gain"] == "8" and found.meta["load_mass_kg"] == "0.5"
    said = refusal(tmp_path, json.dumps(rows), DEG, "a.json")
    assert "no list of entries outside of data; name the object that has the lists: --rows" in said
    other = TableConfig(DEG.columns, rows="kp")
    assert "there are data" in refusal(tmp_path, json.dumps(rows), other, "a.json")


def test_nan_of_a_marker_in_parquet_is_an_empty_cell(tmp_path):
    nan = float("nan")
    rows = pl.DataFrame({"t": [0, 1], "mx": [nan, 2.0], "my": [None, 3.0], "other": [nan, nan]})
    rows.write_parquet(tmp_path / "a.parquet")
    columns = {"time": "t", "marker0_x": "mx", "marker0_y": "my"}
    found = import_table(tmp_path / "a.parquet", TableConfig(columns)).columns
    assert np.array_equal(found["marker0_x_m"], [nan, 2], equal_nan=True)
    assert np.array_equal(found["marker0_y_m"], [nan, 3], equal_nan=True)
    with pytest.raises(BadInput, match="column mx, row 1: nan is not a finite number"):
        import_table(tmp_path / "a.parquet", TableConfig({"time": "t", "x": "mx"}))


def test_a_number_of_hundreds_of_digits_is_one_sentence(tmp_path):
    text = '{"t": [0, 1], "a": [1, 1' + "0" * 400 + "]}"
    assert "column a, row 2: 1000" in refusal(tmp_path, text, DEG, "a.json")
