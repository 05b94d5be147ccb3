"""The loop's punctuality is measured alone and beside busy programs; the numbers are no test."""

import os

import pytest

pytest.importorskip("serial", reason="the robot extra is not installed")

from tailbeat.benchmarks import punctuality
from tailbeat.robot import timing

pytestmark = pytest.mark.realtime


@pytest.mark.thorough
def test_rows_of_the_loop_alone_and_beside_busy_programs():
    rows = punctuality.punctuality_bench(minutes=0.02)
    assert [row.busy for row in rows] == [0, os.cpu_count()]
    for row in rows:
        assert 0 < row.late_p50_ms <= row.late_p99_ms <= row.late_p999_ms <= row.late_max_ms
        assert 0 < row.compute_p50_ms <= row.compute_p999_ms and row.sleeper_p999_ms > 0
    assert (
        os.sched_getscheduler(0) == os.SCHED_OTHER
    )  # what is measured next is no real-time process


def test_emulated_devices_give_way_to_the_loop():
    timing.claim(timing.BESIDE)
    if os.sched_getscheduler(0) != os.SCHED_FIFO:
        pytest.skip("this system refuses real-time priority")
    beside = os.sched_getparam(0).sched_priority
    timing.claim()
    assert beside < os.sched_getparam(0).sched_priority
