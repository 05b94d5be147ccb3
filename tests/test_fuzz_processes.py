"""Odd input for whole processes: what a child prints counts too, and nothing waits without end."""

import subprocess

import pytest

from fuzz import LONG, check, contents, furnish
from support import command

P = "pulley-fish-pool-generator"
SECONDS = 120.0  # far above what each takes, for a busy machine


@pytest.mark.thorough
@pytest.mark.realtime
@pytest.mark.parametrize(
    "words",
    [
        f"drive {P} --emulated --fish plain.txt --log out.mcap",
        f"drive {P} --log out.mcap --servo . --imu . --listen 127.0.0.1:0 --station 127.0.0.1:9"
        " --key pipe",
        "faults --policy nothing",
        "faults --fish pipe --only sags",
        "show /dev/zero",
        "show pipe",
        "import table /dev/zero --map time=t --out out.csv",
        "import xl330 pipe --out out.csv",
        "doctor --servo . --imu /dev/null --key pipe --logs plain.txt",
        "torque-off --servo /dev/zero",
        "track --camera pipe --calibration pipe",
        "calibrate --views pipe --survey /dev/zero --picture pipe --out out.json",
        f"station --replay /dev/zero --page {LONG}:1",
        "policy show /dev/zero",
        "predict pipe --fish pulley-fish",
        "key /dev/full",
        "benchmark --json /dev/null/a.json",
    ],
)
def test_a_process_ends_with_one_sentence(tmp_path, words):
    furnish(tmp_path)
    before = contents(tmp_path)
    done = subprocess.run(
        command(*words.split()), cwd=tmp_path, capture_output=True, text=True, timeout=SECONDS,
        stdin=subprocess.DEVNULL,
    )  # fmt: skip
    check(done, before, contents(tmp_path))
    assert done.returncode in (1, 2)
