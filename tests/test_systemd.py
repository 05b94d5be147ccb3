"""What systemd hears, over a real datagram socket, and the unit that makes the loop a service."""

import os
import shutil
import socket
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("serial", reason="the robot extra is not installed")
pytest.importorskip("mcap", reason="the robot extra is not installed")

from support import tailbeat
from tailbeat.files import BadInput
from tailbeat.robot import systemd
from tailbeat.robot.log import read_rows

pytestmark = pytest.mark.realtime


@pytest.fixture
def manager(tmp_path: Path, monkeypatch):
    """A socket such as the service manager's."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as made:
        made.bind(str(tmp_path / "notify"))
        made.settimeout(5)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        yield made


def test_the_first_word_is_ready_and_a_beat_feeds_the_watchdog(manager):
    told = systemd.from_environment()
    told.beat(100.0, "disarmed: not armed yet")
    assert manager.recv(999).decode().split("\n") == [
        "READY=1", "WATCHDOG=1", "STATUS=disarmed: not armed yet",
    ]  # fmt: skip
    told.beat(100.02, "disarmed: not armed yet")  # too soon to say the same again
    told.beat(100.04, "run: swimming")
    assert manager.recv(999).decode().split("\n") == ["WATCHDOG=1", "STATUS=run: swimming"]
    told.beat(100.3, "run: swimming")
    assert manager.recv(999).decode().startswith("WATCHDOG=1")
    told.end()
    assert manager.recv(999) == b"STOPPING=1"


def test_an_abstract_name_is_understood_and_silence_where_there_is_none(monkeypatch):
    name = f"tailbeat-{os.getpid()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as made:
        made.bind("\0" + name)
        made.settimeout(5)
        monkeypatch.setenv("NOTIFY_SOCKET", "@" + name)
        systemd.from_environment().beat(0.0, "x")
        assert made.recv(99).startswith(b"READY=1")
    systemd.from_environment().beat(1.0, "y")  # nobody listens any more: not the loop's trouble
    monkeypatch.delenv("NOTIFY_SOCKET")
    systemd.from_environment().beat(0.0, "x")


WORDS = ["my policy.onnx", "--wait", "--log", "/var/log/fish 100%"]


def test_the_unit_runs_drive_disarmed_fed_by_the_loop_and_lets_go_last(tmp_path):
    text = systemd.unit("/usr/bin/python3", "fish", "/dev/serial/by-id/servo", WORDS)
    lines = dict(line.split("=", 1) for line in text.splitlines() if "=" in line and line[0] != "#")
    assert lines["ExecStart"] == (
        '/usr/bin/python3 -m tailbeat drive "my policy.onnx" --wait --log "/var/log/fish 100%%"'
    )
    assert lines["ExecStopPost"].endswith(
        "tailbeat.robot.watchdog /dev/serial/by-id/servo 1 1000000 now"
    )
    wanted = {"Type": "notify", "WatchdogSec": "2", "Restart": "on-failure", "User": "fish",
              "CPUSchedulingPolicy": "fifo", "LimitMEMLOCK": "infinity",
              "SupplementaryGroups": "dialout", "After": "network-online.target",
              "Wants": "network-online.target", "StartLimitIntervalSec": "0"}  # fmt: skip
    assert wanted.items() <= lines.items()
    with pytest.raises(BadInput, match="not allowed in a unit"):
        systemd.unit("/usr/bin/python3", "fish\nRoot", "/dev/x", WORDS)


def test_a_unit_drives_the_fish_that_it_was_given(tmp_path):
    own = tmp_path / "mine.toml"
    own.write_text("")
    parts = ["--servo", "/dev/a", "--imu", "/dev/b", "--listen", "a:1", "--station", "b:2"]
    parts += ["--key", "k", "--logs", "l"]
    for fish, word in {"pulley-fish": "pulley-fish", own.name: str(own)}.items():
        words = ["pulley-fish-pool-generator", "--out", f"{fish}.service", *parts, "--fish", fish]
        done = tailbeat("unit", *words, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        assert f"--fish {word}" in (tmp_path / f"{fish}.service").read_text()


@pytest.mark.skipif(not shutil.which("systemd-analyze"), reason="systemd is not installed")
def test_systemd_itself_takes_the_unit(tmp_path):
    path = tmp_path / "fish.service"
    path.write_text(systemd.unit(sys.executable, "root", "/dev/servo", WORDS))
    done = subprocess.run(
        ["systemd-analyze", "verify", str(path)], capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 0 and "fish.service" not in done.stderr, done.stderr
    path.write_text(path.read_text().replace("Type=notify", "Type=nothing"))
    worse = subprocess.run(
        ["systemd-analyze", "verify", str(path)], capture_output=True, text=True, timeout=60
    )
    assert "nothing" in worse.stderr  # it does look


@pytest.mark.thorough
def test_the_loop_itself_says_that_it_turns_and_stays_disarmed_until_ordered(manager, tmp_path):
    command = [sys.executable, "-m", "tailbeat", "drive", "pulley-fish-pool-generator",
               "--emulated", "--wait", "--seconds", "inf", "--log", str(tmp_path)]  # fmt: skip
    service = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    manager.settimeout(60)
    assert manager.recv(999).startswith(b"READY=1")
    words = [manager.recv(999).decode() for _ in range(8)]  # two seconds: it would have armed
    assert all("WATCHDOG=1" in word and "STATUS=disarmed" in word for word in words)
    service.terminate()
    _, said = service.communicate(timeout=60)
    assert service.returncode == 0, said  # to systemd a stop that was asked for is no failure
    (log,) = tmp_path.glob("swim-*.mcap")
    assert {row["state"] for row in read_rows(log)} == {"disarmed"}
