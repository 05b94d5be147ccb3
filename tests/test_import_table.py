"""Any table becomes a recording in SI units, or one sentence says why not."""

import json
from typing import Any

import numpy as np
import polars as pl
import pytest

from support import tailbeat
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
