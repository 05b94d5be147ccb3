"""Swim every fault of the table in real time and time the way to safety."""

from collections.abc import Callable, Sequence

import numpy as np

from tailbeat.evaluate import faults as table
from tailbeat.evaluate.fault_bench import open_bench
from tailbeat.evaluate.fault_cases import CASES
from tailbeat.evaluate.faults import Row
from tailbeat.files import BadInput
from tailbeat.fish.store import load_fish
from tailbeat.robot import session


def faults(
    policy: str, fish: str, only: Sequence[str], kills: int, seed: int, say: Callable[[str], None]
) -> dict[str, list[Row]]:
    """Every fault, or those whose title or name holds one of the words in `only`, in real time."""
    cases = [
        case
        for case in CASES
        if not only or any(word in f"{case.title} {case.name}" for word in only)
    ]
    if not cases and not kills:
        names = ", ".join(case.name for case in CASES)
        raise BadInput(f"--only {' '.join(only)}: no such fault; give some of {names}.")
    rows, drive = [], session.drive
    with open_bench(load_fish(fish), [session.__name__]) as bench:
        for number, case in enumerate(cases, 1):
            rows.append(table.measure(case, bench, policy, drive))
            say(f"{number}/{len(cases)}  {case.title}: {_short(rows[-1])}")
        random = np.random.default_rng(seed)
        killed = table.kill_at_random(kills, bench, policy, drive, random)
    return {"faults": rows, "killed": killed}


def _short(row: Row) -> str:
    after = "" if row["safe_s"] is None else f" after {row['safe_s']:.2f} s"
    return f"{row['safe state']}{after}" if row["ok"] else f"NOT SAFE: {row['operator sees']}"
