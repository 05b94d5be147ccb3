"""Refit a fish to the logs of one robot: reads logs, writes the fish with what they tell."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tailbeat.control.corrections import Corrections, corrected_frames
from tailbeat.files import refuse_existing, write_json
from tailbeat.fish.description import Fish
from tailbeat.fish.store import Entry, check_new_fish, value_at, write_identified
from tailbeat.identify.logs import Built, Progress, changed, fit_logs
from tailbeat.identify.swim_columns import Logged
from tailbeat.robot.logged import swims_of

UNITS = {
    "kp": "N m/rad", "kv": "N m s/rad", "damping": "N m s/rad", "force_limit": "N m",
    "friction": "N m", "k_eff": "N m/rad",
}  # fmt: skip


@dataclass(frozen=True)
class Refitted:
    """A fish refitted to `logs` of one robot: its file, what the fit found, and what the logs
    lack."""

    fish: str
    logs: tuple[str, ...]
    built: Built
    damage: tuple[str, ...] = ()


def refit(
    source: str,
    fish: Fish,
    logs: Sequence[Path],
    out: Path,
    known: Corrections | None = None,
    progress: Progress = lambda what, done, of: None,
) -> Refitted:
    """Fit the `fish` of the file `source` to logs whose readings are freed of `known` errors;
    writes the file `out` and, beside it, a report (.json). Raises BadInput for logs of two robots,
    or that are too short; nothing is written then."""
    report = out.with_suffix(".json")
    check_new_fish(out)
    refuse_existing(report)
    swims, damage = swims_of(logs)
    built = fit_logs(fish, [freed(swim, known) for swim in swims], progress)
    done = Refitted(str(out), tuple(str(path) for path in logs), built, damage)
    note = f"Refitted to {len(logs)} logs of one robot by `tailbeat identify logs`."
    write_identified(source, out, {"name": out.stem, **_entries(fish, built, len(logs))}, note)
    write_json(report, done)
    return done


def freed(swim: Logged, known: Corrections | None) -> Logged:
    """A logged swim without the errors that are known: of a straight tag on the midline, with
    angles and setpoints from straight."""
    if known is None:
        return swim
    frames = np.zeros((len(swim.time), 1, 6))
    frames[:, 0, :3] = swim.pose
    return replace(
        swim,
        pose=corrected_frames(known, frames)[:, 0, :3],
        angle=swim.angle - known.shaft,
        command=swim.command - known.setpoint,
    )


def _entries(fish: Fish, built: Built, logs: int) -> dict[str, Entry]:
    """The fish's new fields with their intervals."""
    low = changed(fish, {one.name: one.interval[0] for one in built.numbers})
    high = changed(fish, {one.name: one.interval[1] for one in built.numbers})
    found: dict[str, Entry] = {}
    for one in built.numbers:
        doubt = "" if one.told else "; not told by them alone"
        for field in one.fields:
            found[field] = {
                "value": built.fields[field],
                "unit": UNITS.get(field.rsplit(".", 1)[-1], "1"),
                "interval": [low[field], high[field]],
                "source": f"fitted to {logs} logs of swims{doubt}",
            }
    return {
        field: entry for field, entry in found.items() if entry["value"] != value_at(fish, field)
    }
