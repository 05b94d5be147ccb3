"""Make every fault of the table in real time, and measure the time until the fish is safe."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from tailbeat.evaluate import faults as table
from tailbeat.evaluate.fault_bench import open_bench
from tailbeat.evaluate.fault_cases import CASES
from tailbeat.evaluate.faults import FaultResult, KillResult
from tailbeat.files import BadInput
from tailbeat.fish.store import hardware_of, load_fish
from tailbeat.robot import session
from tailbeat.robot.fits import check_named

TRIES = 3  # of a fault: a busy machine may hold a fish for another reason


@dataclass(frozen=True)
class Count:
    """Repetitions of one fault: how many `tries`, in how many it was told as it should be and the
    servo was safe (`ok`), and the longest time until it was told [s] of these."""

    fault: str
    tries: int
    ok: int
    told_s_most: float | None


@dataclass(frozen=True)
class FaultTable:
    """Results of every fault, and of every killed loop; with repetitions, a count of each fault."""

    faults: list[FaultResult]
    killed: list[KillResult]
    counts: list[Count] = field(default_factory=list)


def faults(
    policy: str,
    fish: str,
    only: Sequence[str],
    kills: int,
    seed: int,
    say: Callable[[str], None],
    repeat: int = 1,
) -> FaultTable:
    """Make every fault, or those with one of the words of `only` in title or name, in real time.
    With `repeat` above 1 each is made so often, and none is tried again. Raises BadInput."""
    cases = [
        case
        for case in CASES
        if not only or any(word in f"{case.title} {case.name}" for word in only)
    ]
    if not cases and not kills:
        names = ", ".join(case.name for case in CASES)
        raise BadInput(f"--only {' '.join(only)}: no such fault; allowed are words of {names}.")
    described = load_fish(fish)
    hardware = hardware_of(described)
    if hardware.family != "dynamixel-x":
        raise BadInput(
            f"--fish {fish}: its servo is a {hardware.model}, and the faults are those of a"
            f" Dynamixel of the X series; give a fish with one."
        )
    check_named(policy, fish)  # before any device is started
    results: list[FaultResult] = []
    drive = session.drive
    with open_bench(described, [session.__name__]) as bench:
        tries = 1 if repeat > 1 else TRIES
        for number, case in enumerate(cases * repeat, 1):
            results.append(table.measure(case, bench, policy, drive, tries))
            say(f"{number}/{repeat * len(cases)}  {case.title}: {_short(results[-1])}")
        random = np.random.default_rng(seed)
        killed = table.kill_at_random(kills, bench, policy, drive, random)
    return FaultTable(results, killed, counted(results) if repeat > 1 else [])


def counted(results: Sequence[FaultResult]) -> list[Count]:
    """Count the repetitions of each fault."""
    found = []
    for title in dict.fromkeys(one.fault for one in results):
        own = [one for one in results if one.fault == title]
        told = [one.told_s for one in own if one.ok and one.told_s is not None]
        found.append(Count(title, len(own), sum(one.ok for one in own), max(told, default=None)))
    return found


def _short(one: FaultResult) -> str:
    after = "" if one.safe_s is None else f" after {one.safe_s:.2f} s"
    return f"{one.safe_state}{after}" if one.ok else f"NOT SAFE: {one.operator_sees}"
