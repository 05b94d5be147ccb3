"""The log of a swim: what is written is read, a killed writer loses little, a full disk is told."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mcap", reason="the robot extra is not installed")

from mcap.reader import make_reader

from support import tailbeat, until
from tailbeat.files import BadInput
from tailbeat.fish.store import fish_of, load_fish
from tailbeat.recording import read_recording, write_recording
from tailbeat.robot import log as logs
from tailbeat.robot import log_salvage
from tailbeat.robot.log import COLUMNS, read_log, read_notes, read_rows, start
from tailbeat.robot.log_export import as_recording, export
from tailbeat.robot.log_losses import losses
from tailbeat.robot.log_rows import NOTED, read_row
from tailbeat.robot.log_salvage import CHUNK

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


def test_a_recording_carries_what_its_log_s_head_tells(tmp_path):
    from tailbeat.control.policy import load_policy
    from tailbeat.robot.session import notes

    policy, fish = "pulley-fish-pool-generator", load_fish("pulley-fish")
    told = {
        **notes(policy, load_policy(policy).contract, fish),
        "yaw_rate": "a",
        "sign_test": "two\nlines",
    }
    assert fish_of(json.loads(told.pop("fish"))) == fish  # for the log's head alone
    assert set(told) == set(NOTED) and "unknown" in told["calibration"] and told["git"]
    log = start(tmp_path / "a.mcap", {**told, "gain": "7"})  # nothing that an identification reads
    log.put(row(0))
    log.put(row(1))
    log.close()
    export(tmp_path / "a.mcap", tmp_path / "a.csv")
    meta = read_recording(tmp_path / "a.csv").meta
    assert dict(meta) == {**told, "source": "tailbeat drive", "sign_test": "two lines"}


def test_a_note_that_comes_while_rows_are_written_replaces_the_head_s(tmp_path):
    path = tmp_path / "a.mcap"
    log = start(path, {"calibration": "unknown", "policy": "p"})
    for k in range(100):
        log.put(row(k))
        if k in (40, 60):
            log.note("calibration", f"sha256 {k}")
    log.close()
    told = {"calibration": "sha256 60", "policy": "p"}
    assert read_notes(path) == told and as_recording(path).meta["calibration"] == "sha256 60"
    swim = read_log(path)
    assert len(swim.rows) == 100 and not swim.damaged and swim.whole
    with path.open("rb") as file:
        assert [*make_reader(file).iter_metadata()][-1].metadata == {"calibration": "sha256 60"}
    path.write_bytes(path.read_bytes()[:-300])  # its writer was killed
    assert read_notes(path) == told and len(read_log(path).rows) == 100


# ---- damage -------------------------------------------------------------------------------------

ROWS, CHUNK_SECONDS = 250, 0.3  # of a row's 20 ms: a chunk holds about eleven


@pytest.fixture(scope="module")
def swum(tmp_path_factory) -> bytes:
    """The bytes of a log of five seconds."""
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


@pytest.mark.thorough
@pytest.mark.parametrize(("copies", "hole"), [(300, 0), (50, 4096)])
def test_a_damaged_log_loses_the_damaged_rows_alone_and_says_so(swum, tmp_path, copies, hole):
    true = [row(k)["motor_angle_rad"] for k in range(ROWS)]
    for seed in range(copies):
        found = read_log(damaged(swum, tmp_path / "bad.mcap", seed, hole))
        whole = ROWS - (2 * CHUNK_SECONDS if hole else CHUNK_SECONDS) / 0.02
        assert len(found.rows) >= whole, seed
        for one in found.rows:  # no row was altered
            assert one["motor_angle_rad"] == true[round((one["time_s"] - 100) / 0.02)], seed
        if found.lost is None:  # the log's end is damaged: the first and last row are not known
            assert found.damaged or not found.whole, seed
            inside = found.rows[-1]["time_s"] - found.rows[0]["time_s"]
            lost = round(inside / 0.02) + 1 - len(found.rows)
        else:
            lost = ROWS - len(found.rows)
            assert found.lost == lost and (not lost or found.damaged), seed
        assert sum(gap.seconds for gap in found.gaps) == pytest.approx(0.02 * lost, abs=1e-6)


def test_an_export_of_a_damaged_log_says_what_is_missing(swum, tmp_path):
    path = tmp_path / "hole.mcap"
    path.write_bytes(swum[:50_000] + bytes(4096) + swum[54_096:])
    done = tailbeat("export", path, "--out", tmp_path / "hole.csv")
    assert done.returncode == 1 and "s of rows are missing, after" in done.stdout
    assert read_recording(tmp_path / "hole.csv").time.size > 200
    path.write_bytes(swum[:50_000])
    done = tailbeat("export", path, "--out", tmp_path / "cut.csv")
    assert done.returncode == 0 and "the log has no end" in done.stdout


def pieces(swum: bytes) -> list[bytes]:
    """What is before the chunks, each chunk with its index, what is after."""
    at, edges = swum.find(CHUNK), list[int]()
    while at >= 0:
        chunk = log_salvage._chunk(swum, at)
        edges += [at] if chunk else []
        at = swum.find(CHUNK, chunk[1] if chunk else at + 1)
    edges += [swum.find(log_salvage.DATA_END)]
    return [swum[a:b] for a, b in pairwise([0, *edges, len(swum)])]


CHANGES: dict[str, tuple[Callable[[list[bytes]], list[bytes]], str]] = {
    "begin gone": (lambda p: p[11:], "s of rows are missing, before the first row (1"),
    "first chunk flipped": (lambda p: [p[0], flipped(p[1]), *p[2:]], "before the first row ("),
    "last chunk flipped": (lambda p: [*p[:-2], flipped(p[-2]), p[-1]], "missing, after 4."),
    "one chunk gone": (lambda p: p[:5] + p[6:], "0.22 s of rows are missing, after 0.66 s (11"),
    "last chunks gone": (lambda p: [*p[:-4], p[-1]], "s of rows are missing, after 4."),
    "a chunk twice": (lambda p: p[:8] + p[5:6] + p[8:], "11 rows have the time of another"),
    "chunks swapped": (lambda p: [*p[:5], p[6], p[5], *p[7:]], "were sorted"),
    "the end flipped": (lambda p: [*p[:-1], flipped(p[-1])], "counts the rows, is damaged too"),
}


def flipped(piece: bytes) -> bytes:
    return piece[:200] + bytes([piece[200] ^ 1]) + piece[201:]


@pytest.mark.parametrize(("change", "said"), CHANGES.values(), ids=CHANGES)
def test_rows_that_are_gone_twice_or_elsewhere_are_said(swum, tmp_path, change, said):
    parts = pieces(swum)
    changed = change(list(parts))
    (tmp_path / "a.mcap").write_bytes(b"".join(changed))
    recording, swim = export(tmp_path / "a.mcap", tmp_path / "a.csv")
    assert any(said in one for one in losses(swim)), losses(swim)
    assert swim.damaged and (np.diff(recording.time) > 0).all()
    here = {round(at / 0.02) for at in recording.time}
    assert len(here) == len(recording.time) >= ROWS - (125 if len(changed) < len(parts) else 11)
    assert ROWS - len(here) == (swim.lost or 0)


def test_a_log_that_is_as_written_lacks_nothing(swum, tmp_path):
    (tmp_path / "a.mcap").write_bytes(swum)
    swim = read_log(tmp_path / "a.mcap")
    assert (swim.lost, swim.gaps, losses(swim)) == (0, (), [])


def test_two_logs_in_a_file_are_both_read_if_they_follow_each_other(swum, tmp_path):
    path = tmp_path / "later.mcap"
    log = start(path, {})
    for k in range(1000, 1100):
        log.put(row(k))
    log.close()
    (tmp_path / "two.mcap").write_bytes(swum + path.read_bytes())
    swim = read_log(tmp_path / "two.mcap")
    assert len(swim.rows) == ROWS + 100 and not swim.damaged and not swim.gaps
    assert losses(swim) == ["the file holds 2 logs, one after the other"]
    (tmp_path / "same.mcap").write_bytes(path.read_bytes() + swum + swum)
    swim = read_log(tmp_path / "same.mcap")
    assert len(swim.rows) == ROWS
    assert losses(swim) == [
        "the file holds 3 logs, one after the other; 2 not read: their times overlap"
    ]


def test_the_loop_s_own_pauses_are_no_loss(tmp_path):
    """Periods that it missed and the time of arming have no row; other rows are missing."""
    rows = [{**row(k), "missed": 0} for k in range(60)]
    missed = [{**one, "missed": 3} if k > 9 else one for k, one in enumerate(rows)]
    armed = [{**one, "state": "armed"} if k < 10 else one for k, one in enumerate(rows)]
    for kind, lost in ((missed, 0), (armed, 0), (rows, 1)):
        log = start(tmp_path / "a.mcap", {})
        for one in kind[:10] + kind[13:]:
            log.put(one)
        log.close()
        swim = read_log(tmp_path / "a.mcap")
        assert len(swim.gaps) == lost and swim.lost == 0
        (tmp_path / "a.mcap").unlink()


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("time_s", "abc", "row 7: time_s is 'abc', not a number"),
        ("x_m", [1, 2], r"row 7: x_m is \[1, 2\], not a number"),
        ("x_m", True, "row 7: x_m is True, not a number"),
        ("x_m", 10**400, "row 7: x_m is 1000.*0, not a number"),
        ("state", 3.0, "row 7: state is 3.0, not a text"),
        ("state", 3, "row 7: state is 3, not a text"),
        ("decided_on", [1.0, "b"], "row 7: decided_on is .* not a list of numbers"),
    ],
)
def test_a_row_of_other_types_is_refused(field, value, said):
    text = json.dumps({"time_s": 1.0, "x_m": 2.0, "state": "run", field: value}).encode()
    with pytest.raises(BadInput, match=said):
        read_row(Path("a.mcap"), 7, text)


def test_a_row_nested_without_end_is_refused_and_an_infinite_number_is_none():
    with pytest.raises(BadInput, match="not a JSON object"):
        read_row(Path("a.mcap"), 0, b"[" * 100_000)
    assert read_row(Path("a.mcap"), 0, b'{"x_m": 1e999, "y_m": NaN}')["x_m"] is None


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


def test_a_writer_that_hangs_is_not_healthy_after_half_a_second_and_holds_no_end_up(
    tmp_path, monkeypatch
):
    hung = threading.Event()
    monkeypatch.setattr(logs, "WAITING", 30)
    monkeypatch.setattr(logs, "PATIENCE", 0.1)
    monkeypatch.setattr(logs, "_text", lambda row: "{}" if hung.wait(60) else "")
    log = start(tmp_path / "a.mcap", {})
    log.put(row(0))
    until(lambda: not log.waiting.qsize())  # the writer has it, and hangs
    for k in range(25):
        log.put(row(k))
    healthy = [log.healthy]
    log.put(row(25))
    healthy += [log.healthy]
    assert healthy == [True, False] and log.dropped == 0
    for k in range(10):  # the queue is full
        log.put(row(k))
    began = time.monotonic()
    log.close()
    assert time.monotonic() - began < 5.0
    assert log.failed == "its writer did not end within 0.1 s" and log.dropped == 36
    hung.set()
