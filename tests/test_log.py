"""The log of a swim: what is written is read, a killed writer loses little, a full disk is told."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mcap", reason="the robot extra is not installed")

from mcap.reader import make_reader

from support import tailbeat, until
from tailbeat.files import BadInput
from tailbeat.recording import read_recording, write_recording
from tailbeat.robot import log as logs
from tailbeat.robot.log import COLUMNS, read_log, read_rows, start
from tailbeat.robot.log_export import as_recording

pytestmark = pytest.mark.realtime


def row(k: int) -> dict:
    numbers = {name: 0.01 * k + i for i, name in enumerate(COLUMNS)}
    arrays = {"observation": np.full(24, 0.5, np.float32), "action": np.zeros(6, np.float32)}
    return {"time_s": 100 + 0.02 * k, **numbers, **arrays, "state": "run", "reason": "swimming"}


def test_a_log_is_read_back_is_a_recording_and_any_reader_s(tmp_path):
    path = tmp_path / "a.mcap"
    log = start(path, {"policy": "p", "fish": "f"})
    for k in range(200):
        log.put(row(k))
    log.put({**row(200), "x_m": float("nan")})
    log.close()
    rows = read_rows(path)
    assert len(rows) == 201 and rows[3]["observation"] == [0.5] * 24 and rows[200]["x_m"] is None
    recording = as_recording(path)
    assert recording.time.size == 200 and recording.time[0] == 0.0
    write_recording(recording, tmp_path / "a.csv")
    again = read_recording(tmp_path / "a.csv")
    assert again.columns["motor_angle_rad"] == pytest.approx(recording.columns["motor_angle_rad"])
    with path.open("rb") as file:
        reader = make_reader(file)  # the indexed one, as Foxglove's
        assert len(list(reader.iter_messages(topics=["/swim"]))) == 201
        notes = next(iter(reader.iter_metadata()))
        assert notes.metadata == {"policy": "p", "fish": "f"}
    with pytest.raises(BadInput, match="exists already"):
        start(path, {})


def test_a_killed_writer_loses_less_than_half_a_second(tmp_path):
    path = tmp_path / "killed.mcap"
    code = (
        "import sys, time; sys.path.insert(0, 'tests')\n"
        "from pathlib import Path; from test_log import row; from tailbeat.robot.log import start\n"
        f"log = start(Path({str(path)!r}), {{}})\n"
        "for k in range(10**6):\n"
        "    log.put(row(k)); print(k, flush=True); time.sleep(0.02)\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", code],
        cwd=Path(__file__).parents[1],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    last = 0
    for line in process.stdout:
        last = int(line)
        if last >= 150:
            os.kill(process.pid, signal.SIGKILL)
            break
    process.wait()
    rows = read_rows(path)
    assert 0.02 * (last + 1 - len(rows)) <= 0.5
    assert [round((one["time_s"] - 100) / 0.02) for one in rows] == list(range(len(rows)))


def test_a_disk_that_takes_no_more_is_told_and_the_loop_goes_on(tmp_path):
    log = start(tmp_path / "full.mcap", {})
    log.put(row(0))
    log.file.close()  # every further write fails, as on a full disk
    for k in range(1, 200):
        log.put(row(k))
    until(lambda: log.failed)
    log.put(row(999))
    log.close()


def test_a_writer_that_falls_behind_drops_and_counts(tmp_path, monkeypatch):
    monkeypatch.setattr(logs, "WAITING", 10)

    def slow(row: dict) -> str:
        time.sleep(0.05)
        return "{}"

    monkeypatch.setattr(logs, "_text", slow)
    log = start(tmp_path / "slow.mcap", {})
    began = time.monotonic()
    for k in range(60):
        log.put(row(k))
    assert time.monotonic() - began < 2.0 and log.dropped >= 10  # to write all takes 3 s
    log.close()


def test_what_is_no_log_is_refused(tmp_path):
    with pytest.raises(BadInput, match="no such file"):
        read_rows(tmp_path / "none.mcap")
    (tmp_path / "text.mcap").write_text("hello")
    with pytest.raises(BadInput, match="no row of a swim"):
        read_rows(tmp_path / "text.mcap")


# ---- damage -------------------------------------------------------------------------------------

ROWS, CHUNK_SECONDS = 500, 0.3  # of a row's 20 ms: a chunk holds about seven


@pytest.fixture(scope="module")
def swum(tmp_path_factory) -> bytes:
    """The bytes of a log of ten seconds."""
    path = tmp_path_factory.mktemp("log") / "swim.mcap"
    log = start(path, {"policy": "p"})
    for k in range(ROWS):
        until(lambda: log.waiting.qsize() < 400)
        log.put(row(k))
    log.close()
    return path.read_bytes()


def damaged(swum: bytes, path: Path, seed: int, hole: int) -> Path:
    """A copy with one bit flipped, or with a hole of so many random bytes."""
    rng, data = np.random.default_rng(seed), bytearray(swum)
    at = int(rng.integers(0, len(data) - hole))
    if hole:
        data[at : at + hole] = rng.bytes(hole)
    else:
        data[at] ^= 1 << int(rng.integers(8))
    path.write_bytes(data)
    return path


@pytest.mark.parametrize(("copies", "hole"), [(300, 0), (50, 4096)])
def test_a_damaged_log_loses_the_damaged_rows_alone_and_says_so(swum, tmp_path, copies, hole):
    true = [row(k)["motor_angle_rad"] for k in range(ROWS)]
    for seed in range(copies):
        found = read_log(damaged(swum, tmp_path / "bad.mcap", seed, hole))
        whole = ROWS - (2 * CHUNK_SECONDS if hole else CHUNK_SECONDS) / 0.02
        assert len(found.rows) >= whole, seed
        for one in found.rows:  # no row was altered
            assert one["motor_angle_rad"] == true[round((one["time_s"] - 100) / 0.02)], seed
        inside = found.rows[-1]["time_s"] - found.rows[0]["time_s"]
        lost = round(inside / 0.02) + 1 - len(found.rows)
        assert sum(gap.seconds for gap in found.gaps) == pytest.approx(0.02 * lost, abs=1e-6)
        assert not lost or found.damaged, seed


def test_an_export_of_a_damaged_log_says_what_is_missing(swum, tmp_path):
    path = tmp_path / "hole.mcap"
    path.write_bytes(swum[:100_000] + bytes(4096) + swum[104_096:])
    done = tailbeat("export", path, "--out", tmp_path / "hole.csv")
    assert done.returncode == 1 and "s of rows are missing, after" in done.stdout
    assert read_recording(tmp_path / "hole.csv").time.size > 450
    path.write_bytes(swum[:100_000])
    done = tailbeat("export", path, "--out", tmp_path / "cut.csv")
    assert done.returncode == 0 and "the log has no end" in done.stdout


def test_a_log_that_drops_or_whose_thread_dies_is_not_healthy(tmp_path):
    log = start(tmp_path / "a.mcap", {})
    assert log.healthy
    log.put({"no": "time"})
    until(lambda: not log.healthy)
    assert "time_s" in log.failed
    log.close()
    full = start(tmp_path / "b.mcap", {})
    full.dropped = 1
    assert not full.healthy
    full.close()
