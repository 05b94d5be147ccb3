"""The commands as a user types them; one run of each verb is a process of its own."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from support import complaint, tailbeat, tailbeat_process
from synthetic import record
from tailbeat.cli.app import spread_lists
from tailbeat.cli.renamed import refuse_old_names
from tailbeat.fish.store import load_fish
from tailbeat.identify import launch
from tailbeat.recording import read_recording, write_recording


@pytest.fixture(scope="module")
def swim(tmp_path_factory):
    """A recording of the pulley fish, as CSV."""
    path = tmp_path_factory.mktemp("recordings") / "swim.csv"
    write_recording(record(load_fish("pulley-fish"), "swim", 1.5, 0.5, seconds=3.0), path)
    return path


def test_lists_of_recordings_follow_an_option():
    words = ["identify", "fluid", "--fit", "a", "b", "--zones", "1", "--validate", "c", "d"]
    assert spread_lists(words) == (
        "identify fluid --fit a --fit b --zones 1 --validate c --validate d".split()
    )


@pytest.mark.thorough
def test_new_fish_show_and_predict(tmp_path, swim, monkeypatch):
    monkeypatch.setattr(launch, "SECONDS", 2.5)
    assert tailbeat_process("new-fish", tmp_path / "my.toml").returncode == 0
    shown = tailbeat(
        "show",
        tmp_path / "my.toml",
        "--picture",
        tmp_path / "my.png",
        "--json",
        tmp_path / "s.json",
        "--launches",
    )
    assert shown.returncode == 0, shown.stderr
    assert "k_eff_read" in shown.stdout and "launch [m/s]" in shown.stdout
    assert (tmp_path / "my.png").stat().st_size > 5000
    found = json.loads((tmp_path / "s.json").read_text())
    assert found["hinges"][0]["arm_m"] == pytest.approx(0.015)
    assert [row["launch"] for row in found["launches"]] == 6 * [0.0, 0.03, -0.03, -0.1, -0.3]
    done = tailbeat("predict", "--fish", "pulley-fish", swim, "--json", tmp_path / "p.json")
    assert done.returncode == 0, done.stderr
    result = json.loads((tmp_path / "p.json").read_text())
    assert result["speed_mae"] < 1e-3
    assert result["runs"][0]["recording"] == "swim"


@pytest.mark.thorough
def test_identify_writes_fish_report_and_figure_and_its_fish_predicts(tmp_path, swim):
    out, held = tmp_path / "id.toml", tmp_path / "held.csv"
    held.write_bytes(swim.read_bytes())
    done = tailbeat_process(
        "identify", "fluid", "--fish", "pulley-fish", "--fit", swim, "--validate", held,
        "--out", out, "--zones", 1, "--seeds", 1, "--generations", 2, "--draws", 4,
    )  # fmt: skip
    assert {p.name for p in tmp_path.iterdir()} == {
        "held.csv",
        "id.toml",
        "id.json",
        "id.png",
        "id-posterior.parquet",
    }
    report = json.loads((tmp_path / "id.json").read_text())
    assert report["engine"].startswith("mujoco 4.") and len(report["seeds"]) == 1
    # two generations miss their own swim, which the report says and the exit code shows
    assert done.returncode == 1 and not report["trusted"], done.stderr
    assert "misses its own fitted swims" in report["verdict"][0]
    assert "identified on swim" in out.read_text()
    assert load_fish(out).name == "id"  # a contract names the fish: not the one it came from
    again = tailbeat("predict", "--fish", out, swim)
    assert again.returncode == 0 and "mean absolute speed error" in again.stdout


def test_bad_input_is_one_sentence_exit_two_and_nothing_written(tmp_path, swim):
    rows = swim.read_text().splitlines()
    (tmp_path / "nan.csv").write_text("\n".join([rows[0], rows[1], "1,nan,0,0,0", *rows[2:]]))
    (tmp_path / "back.csv").write_text("\n".join([rows[0], rows[2], rows[1], *rows[3:]]))
    before = sorted(tmp_path.iterdir())
    out = tmp_path / "out.toml"

    def fit(recording: object) -> str:
        return complaint(
            "identify", "fluid", "--fish", "pulley-fish", "--fit", recording, "--out", out
        )

    assert "'nan' is not a finite number" in fit(tmp_path / "nan.csv")
    assert "time must rise" in fit(tmp_path / "back.csv")
    assert "no such file" in fit(tmp_path / "gone.csv")
    assert "no such fish" in complaint("show", "nemo")
    assert "exists already" in complaint(
        "identify", "fluid", "--fish", "pulley-fish", "--fit", swim, "--out", tmp_path / "nan.csv"
    )
    assert "give 1" in complaint(
        "identify", "fluid", "--fish", "pulley-fish", "--fit", swim, "--out", out, "--zones", 2
    )
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize(
    ("words", "answer"),
    [
        ("pace --minutes 1", "pace is now latency: tailbeat latency --minutes 1"),
        ("flutter", "flutter is now speed-map"),
        ("laptop", "laptop is now station"),
        ("rig --help", "rig is now emulate"),
        ("bench", "bench is now benchmark"),
        ("let-go", "let-go is now torque-off"),
        ("identify motor --help", "identify motor is now identify servo"),
        ("protocol motor -h", "protocol motor is now protocol servo: tailbeat protocol servo -h"),
        ("record motor", "record motor is now record servo"),
        ("drive x --rig", "drive: --rig is now --emulated"),
        ("doctor --laptop=a:1", "doctor: --laptop is now --station"),
        ("swim --console a:1", "swim: --console is now --page"),
    ],
)
def test_an_old_name_is_answered_with_the_new_one(words, answer):
    assert answer in complaint(*words.split())


def test_a_new_name_s_value_may_be_an_old_name():
    refuse_old_names(["drive", "rig", "--log", "pace"])


def test_no_engine_warning_is_left_behind(tmp_path, swim):
    """MuJoCo reports divergence in a log file in the working folder."""
    tailbeat("predict", "--fish", "pulley-fish", swim, cwd=tmp_path)
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()


@pytest.mark.thorough
def test_open_loop_swim_leaves_picture_film_and_summary(tmp_path, monkeypatch):
    monkeypatch.setattr("tailbeat.fish.render.FILM_RATE", 5)  # software rendering takes its time
    done = tailbeat("swim", "--fish", "pulley-fish", "--out", tmp_path / "runs")
    assert done.returncode == 0, done.stderr
    summary = json.loads((tmp_path / "runs/summary.json").read_text())
    assert summary["speed_m_s"] > 0.1
    for name in ("fish.png", "swim.mp4", "open-loop.png"):
        assert (tmp_path / "runs" / name).stat().st_size > 5000


@pytest.mark.thorough
def test_a_missing_gl_library_never_stops_a_picture(tmp_path):
    code = (
        "import mujoco, numpy as np, pathlib;"  # the engine first, without a screen: it picks GLFW
        "from tailbeat.fish import render, store, twin;"
        "t = twin.compile_twin(store.load_fish('pulley-fish'), twin.Options(looks=True));"
        f"path = pathlib.Path({str(tmp_path / 'a.png')!r});"
        "print(render.save_picture(t, np.zeros(t.model.nq), path))"
    )
    env = {"PATH": "/usr/bin:/bin", "MUJOCO_GL": "disable"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=env)
    assert done.stdout.strip() == "drawn", done.stderr
    assert (tmp_path / "a.png").stat().st_size > 2000


EXAMPLES = Path(__file__).parents[1] / "examples" / "bench"


@pytest.mark.thorough
def test_the_worked_example_of_the_tail(tmp_path):
    words = ["--static", EXAMPLES / "tail-static.csv", "--ring-down", EXAMPLES / "tail-release.csv"]
    out = tmp_path / "fish.toml"
    done = tailbeat(
        "identify", "tail", EXAMPLES / "tail-sweep.csv", "--fish", "pulley-fish", "--out", out,
        "--json", tmp_path / "r.json", *words,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    report = json.loads((tmp_path / "r.json").read_text())
    assert report["k_eff"]["interval"][0] < 0.98 < report["k_eff"]["interval"][1]
    assert len(report["joint_stiffness"]) == 5 and len(report["conditions"]) == 12
    assert report["static"]["bias"] > 0.05 and "a static test gives" in done.stdout
    assert report["ring_down"]["natural_frequency"]["value"] == pytest.approx(4.75, rel=0.01)
    assert (tmp_path / "fish.png").stat().st_size > 20_000
    fish = load_fish(out)
    assert fish.tail.k_eff == pytest.approx(report["k_eff"]["value"], rel=1e-4)
    assert fish.tail.links[0].stiffness == pytest.approx(report["joint_stiffness"][0], rel=1e-4)
    assert fish.tail.friction == pytest.approx(0.02, rel=0.1)
    again = tailbeat(
        "identify", "tail", EXAMPLES / "tail-sweep.csv", "--fish", "pulley-fish", "--out", out
    )
    assert again.returncode == 2 and "exists already" in again.stderr


@pytest.mark.thorough
@pytest.mark.long
def test_the_worked_example_of_the_servo(tmp_path):
    out = tmp_path / "fish.toml"
    done = tailbeat(
        "identify", "servo", "--fish", "pulley-fish",
        "--fit", *(EXAMPLES / f"servo-{name}.csv" for name in ("chirp", "steps")),
        "--validate", EXAMPLES / "servo-mixed.csv", EXAMPLES / "servo-beat.csv",
        "--out", out, "--seeds", 1, "--generations", 15, "--json", tmp_path / "r.json",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    report = json.loads((tmp_path / "r.json").read_text())
    assert set(report["parameters"]) >= set(
        "kp kv armature damping friction force_limit delay".split()
    )
    assert [run["role"] for run in report["runs"]] == ["fit"] * 2 + ["validate"] * 2
    assert report["validate_mae_deg"] < 0.1
    fish = load_fish(out)
    assert fish.servo == "identified"
    assert fish.servos["identified"].kp == pytest.approx(5.41, rel=0.05)
    assert "paper, identified after deployment" not in out.read_text()
    assert (tmp_path / "fish.png").stat().st_size > 20_000
    assert not list(tmp_path.glob(".*"))  # no checkpoints left


@pytest.mark.thorough
def test_protocols_and_bad_benches(tmp_path):
    done = tailbeat_process("protocol", "servo", "--fish", "pulley-fish", "--out", tmp_path / "p")
    assert done.returncode == 0, done.stderr
    assert len(list((tmp_path / "p").glob("servo-*.csv"))) == 5
    for words, refusal in (
        (("protocol", "wings", "--fish", "pulley-fish", "--out", tmp_path), "allowed are tail"),
        (("protocol", "tail", "--fish", "crank-fish", "--out", tmp_path), "cannot swing"),
        (
            ("identify", "tail", EXAMPLES / "servo-beat.csv", "--fish", "pulley-fish", "--out",
             tmp_path / "f.toml"),
            "column torque_nm is missing",
        ),
        (
            ("identify", "servo", "--fish", "pulley-fish", "--fit", EXAMPLES / "tail-static.csv",
             "--out", tmp_path / "f.toml"),
            "column command_rad is missing",
        ),
    ):  # fmt: skip
        assert refusal in complaint(*words)
    assert not list(tmp_path.glob("f.*"))


def test_a_servo_log_is_imported(tmp_path, data):
    log = data / "xl330" / "2026-01-15_10h28m10.json"
    done = tailbeat_process("import", "xl330", log, "--out", tmp_path / "log.csv")
    assert done.returncode == 0, done.stderr
    meta = read_recording(tmp_path / "log.csv").meta
    assert (meta["gain"], meta["load_mass_kg"], meta["load_arm_m"]) == ("100", "0.49", "0.1")
    (tmp_path / "bad.json").write_text('{"kp": 100}')
    bad = tailbeat("import", "xl330", tmp_path / "bad.json", "--out", tmp_path / "x.csv")
    assert bad.returncode == 2 and "field entries is missing" in bad.stderr
