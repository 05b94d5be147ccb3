"""The commands as a user types them, in a process of their own."""

import json
import subprocess
import sys

import pytest

from synthetic import record
from tailbeat.cli import spread_lists
from tailbeat.fish.store import load_fish
from tailbeat.recording import write_recording


def tailbeat(*words: object, cwd=None) -> subprocess.CompletedProcess:
    return subprocess.run(
        [sys.executable, "-m", "tailbeat", *map(str, words)],
        capture_output=True,
        text=True,
        cwd=cwd,
    )


@pytest.fixture(scope="module")
def swim(tmp_path_factory):
    """A recording of the pulley fish, as CSV."""
    path = tmp_path_factory.mktemp("recordings") / "swim.csv"
    write_recording(record(load_fish("pulley-fish"), "swim", 1.5, 0.5), path)
    return path


def test_lists_of_recordings_follow_an_option():
    words = ["identify", "fluid", "--fit", "a", "b", "--zones", "1", "--validate", "c", "d"]
    assert spread_lists(words) == (
        "identify fluid --fit a --fit b --zones 1 --validate c --validate d".split()
    )


def test_new_fish_show_and_predict(tmp_path, swim):
    assert tailbeat("new-fish", tmp_path / "my.toml").returncode == 0
    shown = tailbeat(
        "show",
        tmp_path / "my.toml",
        "--picture",
        tmp_path / "my.png",
        "--json",
        tmp_path / "s.json",
    )
    assert shown.returncode == 0, shown.stderr
    assert "k_eff_read" in shown.stdout
    assert (tmp_path / "my.png").stat().st_size > 5000
    assert json.loads((tmp_path / "s.json").read_text())["hinges"][0]["arm_m"] == pytest.approx(
        0.015
    )
    done = tailbeat("predict", "--fish", "pulley-fish", swim, "--json", tmp_path / "p.json")
    assert done.returncode == 0, done.stderr
    result = json.loads((tmp_path / "p.json").read_text())
    assert result["speed_mae"] < 1e-3
    assert result["runs"][0]["recording"] == "swim"


def test_identify_writes_fish_report_and_figure_and_its_fish_predicts(tmp_path, swim):
    out = tmp_path / "id.toml"
    done = tailbeat(
        "identify", "fluid", "--fish", "pulley-fish", "--fit", swim, "--validate", swim,
        "--out", out, "--zones", 1, "--seeds", 1, "--generations", 2,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert {p.name for p in tmp_path.iterdir()} == {"id.toml", "id.json", "id.png"}
    report = json.loads((tmp_path / "id.json").read_text())
    assert report["engine"].startswith("mujoco 4.") and len(report["seeds"]) == 1
    assert "identified on swim" in out.read_text()
    again = tailbeat("predict", "--fish", out, swim)
    assert again.returncode == 0 and "mean absolute speed error" in again.stdout


def complaint(*words: object, cwd=None) -> str:
    """The one line of a refusal."""
    done = tailbeat(*words, cwd=cwd)
    assert done.returncode == 2, (done.returncode, done.stdout, done.stderr)
    assert "Traceback" not in done.stderr
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1, lines
    return lines[0]


def test_bad_input_is_one_sentence_exit_two_and_nothing_written(tmp_path, swim):
    rows = swim.read_text().splitlines()
    (tmp_path / "nan.csv").write_text("\n".join([rows[0], rows[1], "1,nan,0,0,0", *rows[2:]]))
    (tmp_path / "short.csv").write_text("\n".join(rows[:20]))
    (tmp_path / "back.csv").write_text("\n".join([rows[0], rows[2], rows[1], *rows[3:]]))
    before = sorted(tmp_path.iterdir())
    out = tmp_path / "out.toml"

    def fit(recording: object) -> str:
        return complaint(
            "identify", "fluid", "--fish", "pulley-fish", "--fit", recording, "--out", out
        )

    assert "'nan' is not a finite number" in fit(tmp_path / "nan.csv")
    assert "beats" in fit(tmp_path / "short.csv")
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


def test_no_engine_warning_is_left_behind(tmp_path, swim):
    """MuJoCo reports divergence in a log file in the working folder."""
    tailbeat("predict", "--fish", "pulley-fish", swim, cwd=tmp_path)
    assert not (tmp_path / "MUJOCO_LOG.TXT").exists()


def test_open_loop_swim_leaves_picture_film_and_summary(tmp_path):
    done = tailbeat("swim", "--fish", "pulley-fish", "--out", tmp_path / "runs")
    assert done.returncode == 0, done.stderr
    summary = json.loads((tmp_path / "runs/summary.json").read_text())
    assert summary["speed_m_s"] > 0.1
    for name in ("fish.png", "swim.mp4", "open-loop.png"):
        assert (tmp_path / "runs" / name).stat().st_size > 5000


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
