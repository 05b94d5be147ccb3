"""Punctuality of the robot's loop, alone and beside busy programs, and that of the machine itself.

A thread that only sleeps and counts, at the same priority, shows what no loop on this machine can
do better: a virtual machine's host takes the processor away for milliseconds.
"""

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from tailbeat import processes
from tailbeat.benchmarks.loop import latency
from tailbeat.control.actions import PERIOD
from tailbeat.robot import timing

POLICY, FISH = "pulley-fish-pool-generator", "pulley-fish"
MINUTES = 1.0
SPIN = "while True: pass"
SLEEPER = "import sys, tailbeat.benchmarks.punctuality as p; print(p.sleep(float(sys.argv[1])))"


@dataclass(frozen=True)
class PunctualityRow:
    """The loop beside `busy` programs: how late its periods start and how long it computes [ms],
    and how late a thread is that only sleeps."""

    busy: int
    late_p50_ms: float
    late_p99_ms: float
    late_p999_ms: float
    late_max_ms: float
    compute_p50_ms: float
    compute_p999_ms: float
    skipped: int
    armed_anew: int
    sleeper_p999_ms: float
    load: float


def punctuality_bench(minutes: float = MINUTES) -> tuple[PunctualityRow, ...]:
    """A row without other programs, and one beside as many as the machine has cores. Each takes
    `minutes` for the loop, and as long for the sleeper. The loop drives emulated devices."""
    try:
        return tuple(_row(count, minutes) for count in (0, os.cpu_count() or 1))
    finally:
        _usual()


def _row(count: int, minutes: float) -> PunctualityRow:
    with busy(count):
        found = latency(POLICY, FISH, minutes, 0, lambda line: None)
        words = [sys.executable, "-c", SLEEPER, str(60 * minutes)]
        told = subprocess.run(words, check=True, capture_output=True, text=True).stdout
    late, compute = (found.drive.punctuality[name] for name in ("late", "compute"))
    return PunctualityRow(
        count,
        late["p50_ms"],
        late["p99_ms"],
        late["p99.9_ms"],
        late["max_ms"],
        compute["p50_ms"],
        compute["p99.9_ms"],
        found.drive.periods_skipped,
        found.armed_anew,
        float(told),
        os.getloadavg()[0],
    )


@contextmanager
def busy(count: int) -> Iterator[None]:
    """Run `count` programs that compute without end, at the usual priority."""
    programs = [processes.start(["-c", SPIN], preexec_fn=_usual) for _ in range(count)]
    try:
        yield
    finally:
        for one in programs:
            one.kill()
            one.wait()


def _usual() -> None:
    """Give back the real-time priority that a drive in this process has claimed."""
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def sleep(seconds: float) -> float:
    """How late a thread is that sleeps from period to period, 99.9th percentile [ms]."""
    timing.claim()
    late, start = timing.Spread(), time.monotonic()
    for number in range(1, round(seconds / PERIOD)):
        due = start + number * PERIOD
        timing.sleep_until(due)
        late.add(time.monotonic() - due)
    return 1e3 * late.quantile(0.999)
