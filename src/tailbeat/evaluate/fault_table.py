"""Make every fault of the table in real time, and measure the time until the fish is safe."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tailbeat.evaluate import faults as table
from tailbeat.evaluate.fault_bench import open_bench
from tailbeat.evaluate.fault_cases import CASES
from tailbeat.evaluate.faults import FaultResult, KillResult
from tailbeat.files import BadInput
from tailbeat.fish.store import load_fish
from tailbeat.robot import session


@dataclass(frozen=True)
class FaultTable:
    """Results of every fault, and of every killed loop."""

    faults: list[FaultResult]
    killed: list[KillResult]


def faults(
    policy: str, fish: str, only: Sequence[str], kills: int, seed: int, say: Callable[[str], None]
) -> FaultTable:
    """Make every fault, or those with one of the words of `only` in title or name, in real time.
    Raises BadInput."""
    cases = [
        case
        for case in CASES
        if not only or any(word in f"{case.title} {case.name}" for word in only)
    ]
    if not cases and not kills:
        names = ", ".join(case.name for case in CASES)
        raise BadInput(f"--only {' '.join(only)}: no such fault; allowed are words of {names}.")
    results: list[FaultResult] = []
    drive = session.drive
    with open_bench(load_fish(fish), [session.__name__]) as bench:
        for number, case in enumerate(cases, 1):
            results.append(table.measure(case, bench, policy, drive))
            say(f"{number}/{len(cases)}  {case.title}: {_short(results[-1])}")
        random = np.random.default_rng(seed)
        killed = table.kill_at_random(kills, bench, policy, drive, random)
    return FaultTable(results, killed)


def _short(one: FaultResult) -> str:
    after = "" if one.safe_s is None else f" after {one.safe_s:.2f} s"
    return f"{one.safe_state}{after}" if one.ok else f"NOT SAFE: {one.operator_sees}"
