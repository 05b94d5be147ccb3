"""The fault table: real faults, the very loop of `tailbeat drive`, processes of their own.

Here some faults and patient limits, so that a busy machine passes; every one, in real time and with
the limits of the deep end, is a slow test.
"""

import json
import math
import os
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("serial", reason="the robot extra is not installed")
pytest.importorskip("mcap", reason="the robot extra is not installed")

from support import command, complaint, tailbeat_process
from tailbeat.evaluate import faults
from tailbeat.evaluate.fault_bench import Bench, open_bench
from tailbeat.evaluate.fault_cases import CASES, Case
from tailbeat.evaluate.fault_table import Count, counted
from tailbeat.fish.store import load_fish
from tailbeat.processes import ALONE, fork_server
from tailbeat.report.fault_table import markdown
from tailbeat.robot import session

pytestmark = pytest.mark.realtime("robot")

POLICY, DRIVE = "pulley-fish-pool-generator", session.drive
QUICK = ("encoder frozen", "watchdog", "clock back", "nan", "stopped watchdog")
THOROUGH = ("servo cable", "forgeries", "disk full", "tail reversed", "encoder 30 %")


@pytest.fixture(scope="module")
def patient() -> Iterator[Bench]:
    with open_bench(load_fish("pulley-fish"), [session.__name__], patience=4) as bench:
        yield bench


@pytest.mark.parametrize(
    "case",
    [pytest.param(c, id=c.name) for c in CASES if c.name in QUICK]
    + [pytest.param(c, id=c.name, marks=pytest.mark.thorough) for c in CASES if c.name in THOROUGH],
)
def test_a_fault_leads_to_its_safe_state_and_says_why(patient, case):
    row = faults.measure(case, patient, POLICY, DRIVE)
    assert row.ok, row
    if case.safe != "run":
        assert row.safe_s is not None and row.safe_s < 10
        assert case.words in row.operator_sees


@pytest.mark.thorough
def test_a_fish_that_goes_on_where_it_should_hold_is_not_called_safe(patient, monkeypatch):
    monkeypatch.setattr(faults, "WAIT", 1.0)
    wrong = Case("nothing is broken", "loop", "nothing", "hold", "no pose for")
    row = faults.measure(wrong, patient, POLICY, DRIVE, tries=1)
    assert not row.ok  # it may hold for another reason, and that does not count


@pytest.mark.thorough
def test_killed_at_random_moments_the_torque_goes_and_the_log_stays(patient):
    rows = faults.kill_at_random(3, patient, POLICY, DRIVE, np.random.default_rng(0))
    for row in rows:
        assert row.off_s < 5.0  # 0.5 s is asked; a busy machine is not the fish
        assert row.log_lost_s < 2.0
    left = [name for swum in patient.folder.glob("*/") for name in os.listdir(swum)]
    assert left and not {"servo", "imu"} & set(left)  # or a late watchdog finds a stranger's servo


def test_a_swim_s_process_has_one_thread_and_this_one_keeps_its_own(patient, monkeypatch):
    """Threads of a pool would wait for each other on a busy machine."""
    with patient.context.Pool(1) as pool:
        assert [pool.apply(os.getenv, (name,)) for name in ALONE] == ["1"] * len(ALONE)
    monkeypatch.setenv("NUMBA_NUM_THREADS", "3")
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    before = dict(os.environ)
    fork_server([session.__name__])
    assert dict(os.environ) == before


def test_the_table_has_a_row_for_every_fault(tmp_path: Path):
    row = faults.FaultResult("a", "hold: b", "hold", 0.1, 0.25, True, None)
    missed = replace(row, ok=False, told_s=None, safe_s=None)
    lines = markdown([row, missed]).splitlines()
    assert lines[2] == "| a | hold: b | hold | 0.10 | 0.25 |"
    assert lines[3] == "| a | hold: b | **not reached** | – | – |"


def test_repeated_faults_are_counted_and_a_miss_is_one():
    row = faults.FaultResult("a", "hold: b", "hold", 0.5, 0.6, True, None)
    missed, other = replace(row, ok=False, told_s=9.0), replace(row, fault="b", told_s=None)
    told = [Count("a", 3, 2, 0.7), Count("b", 1, 1, None)]
    assert counted([row, missed, replace(row, told_s=0.7), other]) == told
    assert "give 1 or more" in complaint("faults", "--repeat", "0")


def test_a_fault_that_is_none_is_refused():
    assert "no such fault" in complaint("faults", "--only", "shark")


@pytest.mark.thorough
def test_the_loop_s_punctuality_is_measured_and_judged(tmp_path: Path):
    """What is measured depends on the machine; that it is judged does not."""
    out = tmp_path / "pace.json"
    done = tailbeat_process("latency", "--minutes", "0.05", "--allowed", "0", "--json", out)
    assert done.returncode == 1, done.stderr
    found = json.loads(out.read_text())
    assert 0 < found["compute_p50_ms"] < found["busy_max_ms"] and found["periods"] > 20
    assert found["late_p50_ms"] <= found["late_p99_ms"] <= found["late_max_ms"]


@pytest.mark.slow
def test_every_fault_in_real_time(tmp_path: Path):
    """Within the times that docs/results states; wants a machine that is not busy otherwise."""
    out = tmp_path / "faults.json"
    words = command("faults", "--kills", "20", "--json", out)
    done = subprocess.run(words, capture_output=True, text=True, timeout=1200)
    found = json.loads(out.read_text())
    assert done.returncode == 0, [row for row in found["faults"] if not row["ok"]]
    assert {row["fault"] for row in found["faults"]} == {case.title for case in CASES}
    assert all(row["off_s"] < 0.5 and row["log_lost_s"] < 0.5 for row in found["killed"])
    stops = [row for row in found["faults"] if "torque off" in row["safe_state"]]
    assert all(row["safe_s"] is not None and not math.isnan(row["safe_s"]) for row in stops)
