"""Ray on this machine that does not start, or of which a process is killed in the middle."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest

pytest.importorskip("ray", reason="the cluster extra is not installed")

from support import tailbeat_process

SWEEP = """
hours = 1.0
checkpoint_minutes = 0.02
[vary]
fish = "pulley-fish-pool"
recipe = "smoke"
[recipe]
window = 100_000 # never passed: the trial ends by its budget
budget_hours = 0.002
[trial]
targets = 4
arc = 20.0
"""


def swept(folder: Path) -> list[str]:
    path = folder / "sweep.toml"
    path.write_text(SWEEP)
    return ["sweep", str(path), "--out", str(folder / "out")]


def wait_for(ready: Callable[[], object], seconds: float = 120.0) -> None:
    end = time.monotonic() + seconds
    while not ready():
        assert time.monotonic() < end
        time.sleep(0.1)


@pytest.mark.slow
@pytest.mark.realtime
@pytest.mark.parametrize("name", ["raylet", "gcs_server"])
def test_a_sweep_whose_ray_is_killed_says_so_and_goes_on_later(tmp_path, name):
    """Ray itself would wait for ever, or for a minute and end without a word of ours."""
    words, out = swept(tmp_path), tmp_path / "out"
    first = subprocess.Popen(
        [sys.executable, "-m", "tailbeat", *words], stderr=subprocess.PIPE, text=True
    )
    wait_for(lambda: list(out.glob("trials/*/run/checkpoint")))
    below = psutil.Process(first.pid).children(recursive=True)
    os.kill(next(one.pid for one in below if one.name() == name), signal.SIGKILL)
    _, said = first.communicate(timeout=30)
    assert first.returncode == 2 and "Traceback" not in said
    assert f"tailbeat: {name}, a process of Ray on this machine, ended" in said
    assert "--resume" in said
    psutil.wait_procs(below, timeout=5)
    assert not [one for one in below if one.is_running()]
    again = tailbeat_process(*words, "--resume")
    assert again.returncode == 0, again.stderr
    assert (out / "report.html").is_file()


@pytest.mark.slow
def test_ray_that_does_not_start_is_one_sentence(tmp_path, monkeypatch):
    """Its sockets lie in its folder, and a socket's path has at most 107 bytes."""
    long = tmp_path / ("x" * 100)
    long.mkdir()
    monkeypatch.setenv("RAY_TMPDIR", str(long))
    done = tailbeat_process(*swept(tmp_path))
    assert done.returncode == 2 and "Traceback" not in done.stderr
    assert "Ray did not start on this machine" in done.stderr and "107 bytes" in done.stderr
