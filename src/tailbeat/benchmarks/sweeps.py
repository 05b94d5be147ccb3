"""Efficiency of a sweep on this machine, and what more cores would give.

Eight short trainings are swum by a sweep, a core each, and one after the other with every core
each. Then by arithmetic: with `trial` the seconds of one process, `overhead` what the sweep adds to
each and `start` what it adds to all, T trials on N cores take

    start + ceil(T / N) (trial + overhead)

as long as the driver, which needs `driver` seconds of its own core per trial, keeps up:
N driver < trial. It was not measured on more cores than this machine has.
"""

import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tailbeat.cluster import connection, plan, tune
from tailbeat.cluster.plan import Sweep, Trial
from tailbeat.cluster.trial import process_span
from tailbeat.processes import ALONE, cores

TRIALS = 8
FILE = """
[vary]
fish = "pulley-fish-pool"
recipe = "smoke"
seed = {seeds}
[trial]
targets = 16
"""
MANY, LONG = 1000, 1200.0  # trials of the arithmetic, and seconds of a usual training
CORES = (10, 100, 1000, 10_000)


@dataclass(frozen=True)
class SweepRow:
    """`trials` in a sweep, a core each, and one after the other with every core each: times [s],
    and the first over the second. `start_s` is Ray's own start. Per trial [s]: the process, what
    the sweep adds, and the driver's processor time. `idle_s`: for how long [s] cores, added up, had
    no trial left while the last ones swam; it is not in what the sweep adds."""

    trials: int
    cores: int
    sweep_s: float
    in_turn_s: float
    ratio: float
    start_s: float
    trial_s: float
    overhead_s: float
    driver_s: float
    idle_s: float = 0.0


@dataclass(frozen=True)
class MoreCoresRow:
    """By the arithmetic above: `trials` of `trial_s` on so many `cores`, with their `hours`,
    `efficiency` (share of the cores' time that goes into trials), and most cores that one driver
    serves."""

    cores: int
    trials: int
    trial_s: float
    hours: float
    efficiency: float
    most_cores: int


def sweep_bench(trials: int = TRIALS) -> SweepRow:
    """Measure a sweep of `trials` smoke trainings on this machine. Takes about ten minutes."""
    with tempfile.TemporaryDirectory() as name:
        file = Path(name) / "sweep.toml"
        file.write_text(FILE.format(seeds=list(range(trials))), "utf-8")
        asked = plan.read(file)
        made = plan.trials(asked)
        in_turn = _in_turn(asked, made, Path(name) / "in-turn")
        return _swept(asked, made, Path(name) / "sweep", in_turn)


def _in_turn(asked: Sweep, made: Sequence[Trial], out: Path) -> float:
    """Time [s] of all trials one after the other, each with every core."""
    env = {**os.environ, **dict.fromkeys(ALONE, str(cores()))}
    folders = tune.write_trials(asked, made, out)
    began = time.monotonic()
    for folder in folders:
        words = [sys.executable, "-m", "tailbeat.cluster.trial", str(folder)]
        subprocess.run(words, env=env, stdout=subprocess.DEVNULL, check=True)
    return time.monotonic() - began


def _swept(asked: Sweep, made: Sequence[Trial], out: Path, in_turn: float) -> SweepRow:
    began = time.monotonic()
    connection.connect(None)
    start, used = time.monotonic() - began, time.process_time()
    try:
        failed = tune.swim(asked, made, out, lambda row: None)
    finally:
        connection.disconnect()
    assert not failed, failed
    whole, driver = time.monotonic() - began, time.process_time() - used
    spans = [process_span(out / "trials" / one.name) for one in made]
    count, slots = len(made), min(cores(), len(made))
    trial = sum(ended - started for started, ended in spans) / count
    left = idle(spans, slots)
    added = (slots * (whole - start) - left) / count - trial
    ratio, driver = whole / in_turn, driver / count
    return SweepRow(count, cores(), whole, in_turn, ratio, start, trial, added, driver, left)


def idle(spans: Sequence[tuple[float, float]], slots: int) -> float:
    """For how long [s] `slots` cores, added up, had no trial left before the last one ended.
    `spans` are the trials' starts and ends."""
    last, end = max(one for one, _ in spans), max(one for _, one in spans)
    swimming = [one for _, one in spans if one > last]
    return (slots - len(swimming)) * (end - last) + sum(end - one for one in swimming)


def more_cores(row: SweepRow, trials: int = MANY) -> tuple[MoreCoresRow, ...]:
    """What more cores would give, for trials as they were measured, and for usual trainings."""
    return tuple(_with(row, count, trials, of) for of in (row.trial_s, LONG) for count in CORES)


def _with(row: SweepRow, count: int, trials: int, trial: float) -> MoreCoresRow:
    most = math.floor(trial / row.driver_s)
    served = min(count, most)
    whole = row.start_s + math.ceil(trials / served) * (trial + row.overhead_s)
    return MoreCoresRow(count, trials, trial, whole / 3600, trials * trial / (count * whole), most)
