"""Punctuality of the loop: lateness, duration and latency of every period, and how it is achieved.

Durations are counted in bins of ten microseconds. This is fast enough for every period, exact
enough for p99.9, and its size does not grow with time.
"""

import contextlib
import ctypes
import gc
import os
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

BIN = 1e-5  # s
SPIN = 2e-4  # s of busy waiting before a deadline: a sleep ends 50 to 150 us late
PRIORITY = 40  # below the kernel's own interrupt threads (50)
NICE = -11  # instead, where only this is allowed: eleven times the share of another program
BESIDE = 39  # of emulated devices: they run at once, but never while the loop wants the processor
# s until a thread must release the interpreter: the log's thread holds up a period for this long at
# most. The default of 5 ms is a quarter period.
SWITCH = 1e-4
MCL_ALL, PR_SET_TIMERSLACK = 1 | 2 | 4, 29  # current, future, on fault: mman.h; prctl.h


@dataclass(eq=False)
class Spread:
    """Histogram of durations [s]; negative ones count as 0."""

    bins: Counter[int] = field(default_factory=Counter)
    most: float = 0.0

    def add(self, seconds: float) -> None:
        """Count a duration [s]."""
        self.bins[max(int(seconds / BIN), 0)] += 1
        self.most = max(self.most, seconds)

    def quantile(self, share: float) -> float:
        """The quantile [s]: the fraction `share` of durations is at most this long; NaN if there
        are none."""
        wanted, seen = share * self.bins.total(), 0
        for bin_, count in sorted(self.bins.items()):
            seen += count
            if seen >= wanted:
                return min((bin_ + 1) * BIN, self.most)
        return float("nan")

    def row(self) -> dict[str, float]:
        """Quantiles and maximum [ms]."""
        shares = {"p50": 0.5, "p99": 0.99, "p99.9": 0.999}
        found = {f"{name}_ms": 1e3 * self.quantile(share) for name, share in shares.items()}
        return {**found, "max_ms": 1e3 * self.most}


@dataclass(eq=False)
class Pace:
    """Durations of a loop.

    `late`: how late a period starts. `busy`: its duration, with waiting for the bus. `compute`:
    processor time of the loop's thread. `latency`: from a frame's capture to the setpoint decided
    on it. `periods` done and `skipped`.
    """

    late: Spread = field(default_factory=Spread)
    busy: Spread = field(default_factory=Spread)
    compute: Spread = field(default_factory=Spread)
    latency: Spread = field(default_factory=Spread)
    periods: int = 0
    skipped: int = 0

    def report(self) -> dict[str, dict[str, float]]:
        """Quantiles of every quantity [ms]."""
        names = ("late", "busy", "compute", "latency")
        return {name: getattr(self, name).row() for name in names}


def sleep_until(due: float) -> None:
    """Wait until `due` [s], monotonic: asleep, with busy waiting at the end."""
    left = due - time.monotonic()
    if left > SPIN:
        time.sleep(left - SPIN)
    while time.monotonic() < due:
        pass


@contextmanager
def without_collection() -> Iterator[None]:
    """Switch garbage collection off inside: a collection takes longer than a period may."""
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


def claim(priority: int = PRIORITY) -> list[str]:
    """Request real-time `priority`, memory that is not paged out, and exact timers from the system.

    Call it before any thread is started. Returns what was refused, each with what to do.
    """
    sys.setswitchinterval(SWITCH)
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(PR_SET_TIMERSLACK, 1)
    refused = []
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except OSError:
        refused.append(
            "no real-time priority: run it as a service (tailbeat unit), or allow rtprio"
        )
        with contextlib.suppress(OSError):  # second best, where the limit `nice` allows it
            os.setpriority(os.PRIO_PROCESS, 0, NICE)
    if libc.mlockall(MCL_ALL) != 0:
        refused.append("memory may be paged out: raise the limit memlock")
    return refused
