"""How punctual the loop is: lateness, work and latency of every period, and what makes it punctual.

Durations are counted in bins of ten microseconds: cheap enough for every period, exact enough for
p99.9, and as small after a day as after a minute.
"""

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
SPIN = 2e-4  # s before a deadline that are waited out awake: a sleep ends 50 to 150 us late
PRIORITY = 40  # below the kernel's own interrupt threads (50)
SWITCH = 5e-4  # s until a thread must hand over the interpreter; 5 ms is a quarter of a period
MCL_ALL, PR_SET_TIMERSLACK = 1 | 2 | 4, 29  # current, future, on fault: mman.h; prctl.h


@dataclass(eq=False)
class Spread:
    """Durations [s], counted; negative ones count as 0."""

    bins: Counter[int] = field(default_factory=Counter)
    most: float = 0.0

    def add(self, seconds: float) -> None:
        """One more."""
        self.bins[max(int(seconds / BIN), 0)] += 1
        self.most = max(self.most, seconds)

    def quantile(self, share: float) -> float:
        """The duration [s] that so large a share stays within; NaN where none was counted."""
        wanted, seen = share * self.bins.total(), 0
        for bin_, count in sorted(self.bins.items()):
            seen += count
            if seen >= wanted:
                return min((bin_ + 1) * BIN, self.most)
        return float("nan")

    def row(self) -> dict[str, float]:
        """In milliseconds."""
        shares = {"p50": 0.5, "p99": 0.99, "p99.9": 0.999}
        found = {f"{name}_ms": 1e3 * self.quantile(share) for name, share in shares.items()}
        return {**found, "max_ms": 1e3 * self.most}


@dataclass(eq=False)
class Pace:
    """A loop's: `late` at the start of a period, `busy` in it (waiting for the bus too), `compute`
    (processor time of the loop's thread alone), `latency` from a frame's capture to the setpoint
    that was decided on it; periods done and skipped."""

    late: Spread = field(default_factory=Spread)
    busy: Spread = field(default_factory=Spread)
    compute: Spread = field(default_factory=Spread)
    latency: Spread = field(default_factory=Spread)
    periods: int = 0
    skipped: int = 0

    def report(self) -> dict[str, dict[str, float]]:
        """Per quantity its quantiles [ms]."""
        names = ("late", "busy", "compute", "latency")
        return {name: getattr(self, name).row() for name in names}


def sleep_until(due: float) -> None:
    """Until a monotonic time [s]: asleep, and awake for the last moment."""
    left = due - time.monotonic()
    if left > SPIN:
        time.sleep(left - SPIN)
    while time.monotonic() < due:
        pass


@contextmanager
def without_collection() -> Iterator[None]:
    """No garbage is collected inside: a collection takes longer than a period may."""
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


def claim() -> list[str]:
    """Ask the system for punctuality, before any thread is started: real-time priority, memory that
    is not paged out, exact timers. Returns what was refused, each with what to do."""
    sys.setswitchinterval(SWITCH)
    libc = ctypes.CDLL(None, use_errno=True)
    libc.prctl(PR_SET_TIMERSLACK, 1)
    refused = []
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except OSError:
        refused.append("no real-time priority: start it from the systemd unit, or allow rtprio")
    if libc.mlockall(MCL_ALL) != 0:
        refused.append("memory may be paged out: raise the limit memlock")
    return refused
