"""Report a servo identification: JSON rows, the fish's fields, and cross-validation."""

from collections.abc import Sequence
from dataclasses import asdict, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from tailbeat.files import BadInput
from tailbeat.fish.description import Fish
from tailbeat.fish.store import Entry
from tailbeat.identify.datasheet import TOLD, Datasheet
from tailbeat.identify.estimate import as_row
from tailbeat.identify.glitch_report import as_rows
from tailbeat.identify.intervals import trade_offs
from tailbeat.identify.search import Fit
from tailbeat.identify.servo import BLOCK
from tailbeat.identify.servo_doubt import load_doubt
from tailbeat.identify.servo_job import LeftOut, Overlay, ServoFit, identify_servo
from tailbeat.identify.servo_search import Progress, ServoConfig
from tailbeat.identify.shaft import Bench
from tailbeat.identify.space import Parameter, values
from tailbeat.identify.trust import Contest, Errors, Verdict, doubts, share_left_out, verdict

# What to record if the data do not separate two numbers.
SEPARATES = {
    frozenset(("kv", "damping")): "steps large enough to reach the force limit (kv acts inside it)",
    frozenset(("force_limit", "damping")): "steps against a larger load",
    frozenset(("delay", "armature")): "a chirp beyond the servo's bandwidth",
    frozenset(("friction", "load_friction")): "the same commands with another load",
    frozenset(("friction", "stiction")): "the same commands with another load",
    frozenset(("load_friction", "stiction")): "slow ramps besides fast strokes",
}
OTHERWISE = "the same commands at a second gain, or with another known load"


def _run(overlay: Overlay) -> dict[str, Any]:
    return {
        "recording": overlay.bench.name,
        "role": overlay.role,
        "gain": overlay.bench.gain,
        "rmse_deg": overlay.rmse_deg(),
        "mae_deg": overlay.mae_deg,
        "idealised_rmse_deg": overlay.rmse_deg("idealised"),
    }


def as_report(found: ServoFit) -> dict[str, Any]:
    """The JSON report."""
    known = found.estimates()
    said = found_verdict(found)
    report = {
        "verdict": list(said.sentences),
        "trusted": said.trusted,
        "parameters": {name: as_row(one) for name, one in known.items()},
        "compiled": found.servo,
        "gain": found.gain,
        "load": sorted({overlay.bench.load.kind for overlay in found.overlays}),
        "undecided": [name for name, one in known.items() if not one.decided],
        "trade_offs": [
            {"parameters": [a, b], "correlation": r, "separated_by": remedy(a, b, found.datasheet)}
            for a, b, r in trade_offs(*given_load(found))
        ],
        "warnings": [*found.warnings, *doubts(_left(found), BLOCK)],
        "glitches": as_rows(glitch for one in found.overlays for glitch in one.bench.glitches),
        "naive": [asdict(one) for one in found.naive],
        "error_over_best_naive": found.to_naive,
        "seeds": [
            {"seed": fit.seed, "cost": fit.cost, "values": values(found.space, fit.z)}
            for fit in found.fits
        ],
        "runs": [_run(overlay) for overlay in found.overlays],
        **{f"{role}_mae_deg": found.mae_deg(role) for role in ("fit", "validate")},
        "tailbeat": version("tailbeat"),
        "seconds": found.seconds,
    }
    if found.datasheet is not None:
        report["datasheet"] = asdict(found.datasheet)
    if found.left_out:
        report["cross_validation"] = [asdict(one) for one in found.left_out]
    return report


def found_verdict(found: ServoFit) -> Verdict:
    """The verdict: does the fit lose to a naive predictor, are there too many glitches, or do
    recordings contradict each other?"""
    spoilt = [
        (one.bench.name, share_left_out(one.bench.glitches, one.bench.time.size))
        for one in found.overlays
        if one.role == "fit"
    ]
    best = min(found.naive, key=lambda one: one.judged_mae_deg)
    name = f"{best.name} model ({best.judged_mae_deg:.2f} deg)"
    return verdict([Contest("angle", found.to_naive, name)], spoilt, found.contradictions)


def _left(found: ServoFit) -> list[Errors]:
    fitted = [one for one in found.overlays if one.role == "fit"]
    return [Errors(o.bench.name, o.bench.time[o.bench.good], o.error_deg()) for o in fitted]


def given_load(found: ServoFit) -> tuple[tuple[Parameter, ...], Fit]:
    """Space and best fit as if the load were known exactly. Its uncertainty scales all torques
    together; the intervals include it, and no other command could reduce it."""
    best = found.fits[0]
    benches = [overlay.bench for overlay in found.overlays]
    doubt = load_doubt(found.space, best.z, benches)
    return found.space, replace(best, covariance=best.covariance - doubt)


def remedy(a: str, b: str, sheet: Datasheet | None = None) -> str:
    """What to record to separate two numbers, or to give if no datasheet was."""
    open_to_it = sheet is None and {a, b} <= set(TOLD)
    recorded = SEPARATES.get(frozenset((a, b)), OTHERWISE)
    return f"{recorded}, or give --datasheet" if open_to_it else recorded


def toml_values(found: ServoFit, recordings: Sequence[str]) -> dict[str, Entry | str]:
    """Fields for `store.write_identified`."""
    rows = found.estimates()
    source = f"identified on {', '.join(recordings)}"
    written: dict[str, Entry | str] = {"servo": "identified"}
    for name, value in found.servo.items():
        row = rows[name]
        told = found.datasheet is not None and name in TOLD
        sources = f"{source} and by the datasheet" if told else source
        remark = sources if row.decided else f"{sources}; not decided by the data"
        shift = value - row.value
        written[f"servos.identified.{name}"] = {
            "value": float(f"{value:.6g}"),
            "unit": row.unit,
            "interval": [float(f"{edge + shift:.4g}") for edge in row.interval],
            "source": remark,
        }
    return written


def heading(found: ServoFit) -> str:
    """The first lines of an identified fish."""
    held_out = found.mae_deg("validate")
    lines = [
        "Servo identified by `tailbeat identify servo`; the report beside this file has the rest.",
        f"Mean absolute angle error {found.mae_deg('fit'):.2f} deg fitted"
        + ("." if held_out is None else f", {held_out:.2f} deg held out."),
        f"tailbeat {version('tailbeat')}.",
    ]
    if found.gain is not None:
        lines.insert(1, f"kp is for gain register {found.gain:g}; it scales in proportion.")
    return "\n".join(lines)


# ---- cross-validation ---------------------------------------------------------------------------


def cross_validate(
    fish: Fish, benches: Sequence[Bench], config: ServoConfig, scratch: Path, progress: Progress
) -> tuple[LeftOut, ...]:
    """Fit without each gain in turn (without each recording if there is one gain), and measure the
    error on it. Raises BadInput for fewer than two groups."""
    rows = []
    for group in groups(benches):
        kept = [b for b in benches if _group(b, benches) != group]
        out = [b for b in benches if _group(b, benches) == group]
        found = identify_servo(fish, kept, out, config, scratch, progress)
        held = [one for one in found.overlays if one.role == "validate"]
        rmse = float(np.sqrt(np.mean([one.rmse_deg() ** 2 for one in held])))
        rows.append(LeftOut(group, float(np.mean([one.mae_deg for one in held])), rmse))
    return tuple(rows)


def groups(benches: Sequence[Bench]) -> list[str]:
    """What `cross_validate` leaves out in turn. Raises BadInput for fewer than two."""
    found = sorted({_group(bench, benches) for bench in benches})
    if len(found) < 2:
        raise BadInput(
            "--cross-validate: give --fit two recordings or more, preferably at several gains."
        )
    return found


def _group(bench: Bench, benches: Sequence[Bench]) -> str:
    several = len({b.gain for b in benches}) > 1
    return f"gain {bench.gain:g}" if several and bench.gain is not None else bench.name
