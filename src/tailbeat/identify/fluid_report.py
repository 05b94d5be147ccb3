"""The report of a fluid identification, and what it writes into the fish."""

from collections.abc import Sequence
from dataclasses import asdict
from importlib.metadata import version
from typing import Any

import mujoco
import numpy as np

from tailbeat.fish.description import Fish
from tailbeat.fish.store import Entry
from tailbeat.identify import bands
from tailbeat.identify.estimate import as_row
from tailbeat.identify.glitch_report import as_rows
from tailbeat.identify.intervals import trade_offs
from tailbeat.identify.job import FluidConfig, Identified
from tailbeat.identify.kinematic import errors_row
from tailbeat.identify.launch import stuck
from tailbeat.identify.naive_swim import Compared, compare
from tailbeat.identify.predict import row, speed_mae
from tailbeat.identify.search import Fit
from tailbeat.identify.trust import Contest, Verdict, share_left_out, verdict

# Root mean square residual of a fit, in assumed deviations, above which it is not trusted. Chosen:
# the shipped fish has 2.6, and a fish described at a third of its mass 7.5. One described at three
# times its mass has 1.9: all forces grow with it, and no swim tells.
MISSES = 5.0
NAMED = 8  # most swims that every identified number names; if there are more, the heading does


def as_report(found: Identified, config: FluidConfig) -> dict[str, Any]:
    """The JSON report."""
    known = found.estimates()
    naive = compare(found.fitted, found.validated, found.rival)
    said = _verdict(found, naive)
    return {
        "verdict": list(said.sentences),
        "trusted": said.trusted,
        "parameters": {path: as_row(one) for path, one in known.items()},
        "undecided": [path for path, one in known.items() if not one.decided],
        "without_effect": list(found.idle),
        "trade_offs": [
            {"parameters": [a, b], "correlation": r}
            for a, b, r in trade_offs(found.space, found.fits[0])
        ],
        "zones": config.zones,
        "added_inertia": found.fish.added_inertia,
        "seeds": [asdict(one) for one in found.spread],
        "fit": [row(p) for p in found.fitted],
        "validate": [row(p) for p in found.validated],
        "fit_speed_mae": speed_mae(found.fitted),
        "validate_speed_mae": speed_mae(found.validated) if found.validated else None,
        "doubt": _doubt(found),
        "launches": [asdict(one) for one in found.launched],
        "launches_that_end_backward": len(stuck(found.launched)),
        "naive": [{**asdict(one), "best": one.best, "ratio": one.ratio} for one in naive],
        "glitches": as_rows(g for p in (*found.fitted, *found.validated) for g in p.run.glitches),
        "rival": [errors_row(p) for p in found.rival],
        "engine": f"mujoco {mujoco.__version__}",
        "tailbeat": version("tailbeat"),
        "seconds": found.seconds,
    }


def _doubt(found: Identified) -> dict[str, Any]:
    """How much the swims disagree, and the held-out swims' bands: each from the draws and from the
    discrepancy of the other held-out swims."""
    best, known = found.doubts[0], found.discrepancy
    return {
        "excess": best.excess,
        "freedom": best.freedom,
        "discrepancy": None if known is None else asdict(known),
        **bands.as_json(bands.left_out(found.drawn)),
    }


def _verdict(found: Identified, naive: Sequence[Compared]) -> Verdict:
    contests = [Contest(one.quantity, one.ratio, one.best) for one in naive]
    spoilt = [(p.run.name, share_left_out(p.run.glitches, p.run.rows)) for p in found.fitted]
    return verdict(contests, spoilt, misfit(found.fits[0]))


def misfit(best: Fit) -> list[str]:
    """A sentence if the twin misses the swims that it was fitted to by too much."""
    missed = float(np.sqrt(np.square(best.residuals).mean()))
    if missed <= MISSES:
        return []
    return [
        f"the twin misses its own fitted swims by {missed:.1f} assumed deviations (2 to 3 are"
        f" usual): the described fish is not the one that swam, or the search was too short; check"
        f" masses, sizes and units, then raise --generations"
    ]


def toml_values(found: Identified, recordings: Sequence[str]) -> dict[str, Entry | str]:
    """Fields for `store.write_identified`, one for each zone."""
    few = len(recordings) <= NAMED
    swims = ", ".join(recordings) if few else f"{len(recordings)} swims, named on top"
    source = f"identified on {swims}"
    written: dict[str, Entry | str] = {}
    for path, known in found.estimates().items():
        remark = source if known.decided else f"{source}; not decided by the data"
        entry: Entry = {
            "value": float(f"{known.value:.6g}"),
            "unit": known.unit,
            "interval": [float(f"{edge:.4g}") for edge in known.interval],
            "source": remark,
        }
        for zone in found.fish.zones if "*" in path else [""]:
            written[path.replace("*", zone)] = entry
    return {**_assumed(found.fish), **written}


def _assumed(fish: Fish) -> dict[str, Entry | str]:
    """The numbers of the fluid law that the fit assumed, from the fitted fish."""
    numbers = {"added_inertia": (fish.added_inertia, "1"), "added_along": (fish.added_along, "1")}
    if (blend := fish.trailing_edge) is not None:
        numbers["trailing_edge.speed"] = (blend.speed, "m/s")
        numbers["trailing_edge.reverse"] = (blend.reverse, "1")
    written: dict[str, Entry | str] = {
        path: {"value": value, "unit": unit, "source": "the fit's assumption"}
        for path, (value, unit) in numbers.items()
    }
    return {**written, "simulation.integrator": fish.simulation.integrator}


def heading(found: Identified, config: FluidConfig) -> str:
    """The first lines of an identified fish: what was fitted, with which error and engine."""
    lines = [
        "Identified by `tailbeat identify fluid`; the report beside this file has the details.",
        f"Fitted on {', '.join(p.run.name for p in found.fitted)}, cost {found.fits[0].cost:.3g},"
        f" best of {len(found.fits)} seeds, {config.zones} zone(s).",
        f"Mean absolute speed error {speed_mae(found.fitted):.4f} m/s fitted"
        + (f", {speed_mae(found.validated):.4f} m/s held out." if found.validated else "."),
        f"mujoco {mujoco.__version__}, tailbeat {version('tailbeat')}.",
    ]
    return "\n".join(lines)
