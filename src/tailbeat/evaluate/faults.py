"""The fault table: each fault is made in a real swim, and the time until the fish is safe is
measured.

The servo's actions are read inside the emulated servo, not from the loop's reports.
"""

import math
import os
import signal
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tailbeat.evaluate.fault_bench import Bench, Drive, Swim, swimming, wait
from tailbeat.evaluate.fault_cases import Case
from tailbeat.robot.log import read_rows

CALM = 0.3  # s for which the tail must be straight; a fifth of the time that a swim must continue
WAIT = 6.0  # s for a safe state, times the patience


@dataclass(frozen=True)
class FaultResult:
    """Result of one fault in one swim.

    The operator's text; the safe state; time until it was reported and until the servo was safe [s]
    (None: never); whether both came; time missing in the log [s] if the process was killed; the
    number of the try.
    """

    fault: str
    operator_sees: str
    safe_state: str
    told_s: float | None
    safe_s: float | None
    ok: bool
    log_lost_s: float | None
    tries: int = 1


@dataclass(frozen=True)
class KillResult:
    """A loop killed with -9: when in its swim [s], time until torque was off [s] (NaN: never), and
    time missing in the log [s]."""

    swum_s: float
    off_s: float
    log_lost_s: float


def measure(case: Case, bench: Bench, policy: str, drive: Drive, tries: int = 3) -> FaultResult:
    """Make one fault in one swim. If the outcome is not safe, it is tried again, up to `tries`: on
    a busy machine a loop may go to HOLD without a fault."""
    for attempt in range(1, tries + 1):
        try:
            with swimming(bench, policy, drive, case.name if case.where == "start" else "") as swim:
                result = _result(case, bench, swim, _break(case, bench, swim))
        except RuntimeError as error:  # the fish did not start to swim
            result = FaultResult(case.title, str(error), case.safe, None, None, False, None)
        if result.ok or attempt == tries:
            break
    return replace(result, tries=attempt)


def _break(case: Case, bench: Bench, swim: Swim) -> float:
    """Make the fault; returns its time [s]. One from the start is there when the sign test
    begins."""
    if case.where == "start":
        return next(when for when, text in swim.lines if text.startswith("test"))
    wait(swim, lambda: False, case.after)
    if case.where == "bench":
        return float(bench.ask("break", case.name))
    if case.where == "signal":
        os.kill(swim.process.pid, signal.Signals[case.name])
        return time.monotonic()
    swim.pipe.send(case.name)
    wait(swim, lambda: not math.isnan(swim.broken), WAIT)
    return swim.broken


def _result(case: Case, bench: Bench, swim: Swim, broken: float) -> FaultResult:
    began, safe_at = broken, _safe_at(case, bench, swim, broken)
    if case.name == "servo cable":  # before, no command can reach the servo
        began = bench.ask("plug")
        safe_at = _safe_at(replace(case, safe="gone"), bench, swim, began)
    since = [(when - broken, text) for when, text in swim.lines if when >= broken]
    told = next(((when, text) for when, text in since if _is(case, text)), None)
    seen = told or (since or [(0.0, swim.lines[-1][1])])[0]
    return FaultResult(
        fault=case.title,
        operator_sees=seen[1],
        safe_state={"gone": "torque off", "stop": "stop: torque off"}.get(case.safe, case.safe),
        told_s=told[0] if told else None,
        safe_s=None if math.isnan(safe_at) else max(safe_at - began, 0.0),
        ok=not math.isnan(safe_at) and (told is not None or not case.words),
        log_lost_s=_lost(swim.log, broken) if case.name == "SIGKILL" else None,
    )


def _is(case: Case, text: str) -> bool:
    """Whether a line reports what the fault should lead to."""
    return text.startswith(case.safe) and case.words in text


def _safe_at(case: Case, bench: Bench, swim: Swim, broken: float) -> float:
    """Time at which the servo was safe [s]: torque off, straight, or still swimming if it should;
    NaN if never."""
    found = [math.nan]

    def safe() -> bool:
        found[0] = _safe_now(case, bench, swim, broken)
        return not math.isnan(found[0])

    wait(swim, safe, WAIT * bench.patience)
    if case.safe in ("stop", "hold"):  # the report may arrive later
        wait(swim, lambda: swim.state == case.safe or not swim.process.is_alive(), 1.0)
        swim.listen()
    return found[0]


def _safe_now(case: Case, bench: Bench, swim: Swim, broken: float) -> float:
    """Time since which the servo is safe [s]; NaN if it is not."""
    look, on = bench.ask("look")
    now, since = time.monotonic(), look.off
    if case.safe == "run":
        warned = any(when >= broken and _is(case, text) for when, text in swim.lines)
        lasted = now - broken > 5 * CALM and swim.state == "run"
        safe, since = lasted and (warned or not case.words), broken
    elif case.safe == "hold":
        safe, since = on and swim.state == "hold" and now - look.straight > CALM, look.straight
    elif case.name == "servo cable" and case.safe == "stop":
        safe, since = swim.state == "stop", now
    else:
        safe = not on
    return float(since) if safe else math.nan


def _lost(log: Path, killed: float) -> float:
    """Time [s] between a log's last complete row and the kill."""
    return killed - float(read_rows(log)[-1]["time_s"])


def kill_at_random(
    times: int, bench: Bench, policy: str, drive: Drive, rng: np.random.Generator
) -> list[KillResult]:
    """Kill the loop's process with -9, each time at another time of its swim."""
    results: list[KillResult] = []
    while len(results) < times:
        with swimming(bench, policy, drive) as swim:
            swum = float(rng.uniform(0.0, 1.0))
            wait(swim, lambda: False, swum)
            os.kill(swim.process.pid, signal.SIGKILL)
            killed = time.monotonic()
            off = _safe_at(Case("", "", "", "gone"), bench, swim, killed)
            results.append(KillResult(swum, off - killed, _lost(swim.log, killed)))
    return results
