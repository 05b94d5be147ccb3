"""What do the verbs of safety do? The fault table, the loop's punctuality, letting go, the unit."""

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tailbeat import robot_tasks
from tailbeat.files import BadInput, new_file
from tailbeat.fish.store import load_fish

Row = dict[str, Any]
MINUTE = 60.0


def faults(
    policy: str, fish: str, only: list[str], kills: int, seed: int, say: Callable[[str], None]
) -> dict[str, list[Row]]:
    """Every fault, or those whose title or name holds one of the words in `only`, in real time."""
    robot_tasks.need_extra()
    from tailbeat.evaluate import faults as table

    cases = [
        case
        for case in table.CASES
        if not only or any(word in f"{case.title} {case.name}" for word in only)
    ]
    if not cases and not kills:
        names = ", ".join(case.name for case in table.CASES)
        raise BadInput(f"--only {' '.join(only)}: no such fault; give some of {names}.")
    rows, drive = [], robot_tasks.drive
    with table.open_bench(load_fish(fish), [robot_tasks.__name__]) as bench:
        for number, case in enumerate(cases, 1):
            rows.append(table.measure(case, bench, policy, drive))
            say(f"{number}/{len(cases)}  {case.title}: {_short(rows[-1])}")
        random = np.random.default_rng(seed)
        killed = table.kill_at_random(kills, bench, policy, drive, random)
    return {"faults": rows, "killed": killed}


def _short(row: Row) -> str:
    after = "" if row["safe_s"] is None else f" after {row['safe_s']:.2f} s"
    return f"{row['safe state']}{after}" if row["ok"] else f"NOT SAFE: {row['operator sees']}"


def markdown(rows: list[Row]) -> str:
    """The table as docs/deploy.md has it."""
    head = "| fault | the operator reads | safe state | told after [s] | safe after [s] |"
    lines = [head, "|---|---|---|---|---|"]
    for row in rows:
        state = row["safe state"] if row["ok"] else "**not reached**"
        cells = [row["fault"], row["operator sees"], state]
        times = [row["told_s"], None if row["safe state"] == "run" else row["safe_s"]]
        cells += ["–" if value is None else f"{value:.2f}" for value in times]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def pace(policy: str, fish: str, minutes: float, seed: int, say: Callable[[str], None]) -> Row:
    """The loop against the emulated bench for so long: how punctual it was, and whether it drifts.
    Where it holds it is armed anew, and counted."""
    robot_tasks.need_extra()
    from tailbeat.link.status import State
    from tailbeat.robot.log import read_rows

    holds = [0]

    def each(own: Any) -> None:
        if own.stand.state is State.HOLD:
            holds[0] += own.arm(time.monotonic()).state is State.ARMED

    with tempfile.TemporaryDirectory(prefix="tailbeat-") as name:
        folder, log = Path(name), Path(name) / "pace.mcap"
        with robot_tasks.own_rig(fish, robot_tasks.TARGET, seed, folder) as (ports, key):
            told = robot_tasks.drive(
                policy, ports, key, None, MINUTE * minutes, log, say, each=each
            )
        rows = read_rows(log)
    late = 1e3 * np.array([row["late_s"] for row in rows])
    tenth = max(late.size // 10, 1)
    drift = float(np.median(late[-tenth:]) - np.median(late[:tenth]))
    return {**told, "armed_anew": holds[0], "drift_ms": drift}


def let_go(servo: str, ident: int, baud: int) -> None:
    """Torque off, from outside; raises BadInput where the servo does not confirm it."""
    robot_tasks.need_extra()
    from tailbeat.robot import watchdog as warden

    if not Path(servo).exists():
        raise BadInput(f"--servo {servo}: no such port; give the servo's, as /dev/ttyUSB0.")
    said = warden.let_go(servo, ident, baud, trying=3.0)
    if said:
        raise BadInput(f"{servo}: {said}; TORQUE MAY BE ON: cut the servo's power.")


def unit(out: Path, user: str, servo: str, words: list[str]) -> Path:
    """Write a systemd unit for `tailbeat drive` with these words. Raises BadInput."""
    from tailbeat.robot import systemd

    text = systemd.unit(sys.executable, user, servo, words)
    with new_file(out) as beside:
        beside.write_text(text, encoding="utf-8")
    return out
