"""What a servo identification says: JSON rows, the fish's fields, and what other gains predict."""

from collections.abc import Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from tailbeat.files import BadInput
from tailbeat.fish.description import Fish
from tailbeat.identify.motor import load_doubt
from tailbeat.identify.motor_job import MotorConfig, Overlay, Progress, ServoFit, identify_motor
from tailbeat.identify.search import Fit, Parameter, intervals, told_apart, trade_offs, values
from tailbeat.identify.shaft import Bench

# What to record when the data trade one number against another.
SEPARATES = {
    frozenset(("kv", "damping")): "steps large enough to reach the force limit (kv acts inside it)",
    frozenset(("force_limit", "damping")): "steps against a larger load",
    frozenset(("delay", "armature")): "a chirp beyond the servo's bandwidth",
    frozenset(("friction", "load_friction")): "the same commands with another load",
    frozenset(("friction", "stiction")): "the same commands with another load",
    frozenset(("load_friction", "stiction")): "slow ramps besides fast strokes",
}
OTHERWISE = "the same commands at a second gain, or with another known load"


def parameter_rows(found: ServoFit) -> dict[str, dict[str, Any]]:
    """Per number: value, unit, 95 % interval, whether the data decide it."""
    spans = intervals(found.space, found.fits)
    decided = told_apart(found.space, found.fits)
    best = values(found.space, found.fits[0].z)
    rows = {
        p.path: _row(best[p.path], p.unit, span, bool(known))
        for p, span, known in zip(found.space, spans, decided, strict=True)
    }
    if found.gain is not None:
        scale = rows["gain_scale"]
        edges = tuple(found.gain * edge for edge in scale["interval"])
        kp = _row(found.gain * scale["value"], "N m/rad", edges, scale["decided_by_data"])
        rows = {"kp": kp, **rows}
    return rows


def _row(value: float, unit: str, interval: Sequence[float], decided: bool) -> dict[str, Any]:
    return {"value": value, "unit": unit, "interval": list(interval), "decided_by_data": decided}


def run_row(overlay: Overlay) -> dict[str, Any]:
    """Errors of one recording [deg]."""
    error, ideal = overlay.error_deg(), overlay.error_deg("idealised")
    return {
        "recording": overlay.bench.name,
        "role": overlay.role,
        "gain": overlay.bench.gain,
        "rmse_deg": float(np.sqrt(np.square(error).mean())),
        "mae_deg": float(np.abs(error).mean()),
        "idealised_rmse_deg": float(np.sqrt(np.square(ideal).mean())),
    }


def as_report(found: ServoFit) -> dict[str, Any]:
    """The JSON report."""
    rows = parameter_rows(found)
    runs = [run_row(overlay) for overlay in found.overlays]
    return {
        "parameters": rows,
        "compiled": found.servo,
        "gain": found.gain,
        "load": sorted({overlay.bench.load.kind for overlay in found.overlays}),
        "undecided": [name for name, row in rows.items() if not row["decided_by_data"]],
        "trade_offs": [
            {"parameters": [a, b], "correlation": r, "separated_by": remedy(a, b)}
            for a, b, r in trade_offs(*given_load(found))
        ],
        "warnings": list(found.warnings),
        "seeds": [
            {"seed": fit.seed, "cost": fit.cost, "values": values(found.space, fit.z)}
            for fit in found.fits
        ],
        "runs": runs,
        **{f"{role}_mae_deg": mean_error(runs, role) for role in ("fit", "validate")},
        "tailbeat": version("tailbeat"),
        "seconds": found.seconds,
    }


def mean_error(runs: Sequence[dict[str, Any]], role: str) -> float | None:
    """Mean absolute error over the recordings of a role [deg]."""
    errors = [run["mae_deg"] for run in runs if run["role"] == role]
    return float(np.mean(errors)) if errors else None


def given_load(found: ServoFit) -> tuple[tuple[Parameter, ...], Fit]:
    """Space and best fit as if the load were known exactly: doubt about it moves every torque
    alike, which the intervals hold and which no other command could undo."""
    best = found.fits[0]
    benches = [overlay.bench for overlay in found.overlays]
    doubt = load_doubt(found.space, best.z, benches)
    return found.space, replace(best, covariance=best.covariance - doubt)


def remedy(a: str, b: str) -> str:
    """The experiment that tells two numbers apart."""
    return SEPARATES.get(frozenset((a, b)), OTHERWISE)


def toml_values(found: ServoFit, recordings: Sequence[str]) -> dict[str, dict[str, Any] | str]:
    """Field -> {value, unit, interval, source} for `store.write_identified`."""
    rows = parameter_rows(found)
    source = f"identified on {', '.join(recordings)}"
    written: dict[str, dict[str, Any] | str] = {"servo": "identified"}
    for name, value in found.servo.items():
        row = rows[name]
        remark = source if row["decided_by_data"] else f"{source}; not decided by the data"
        shift = value - row["value"]
        written[f"servos.identified.{name}"] = {
            "value": float(f"{value:.6g}"),
            "unit": row["unit"],
            "interval": [float(f"{edge + shift:.4g}") for edge in row["interval"]],
            "source": remark,
        }
    return written


def heading(report: dict[str, Any]) -> str:
    """The lines that head an identified fish."""
    held_out = report["validate_mae_deg"]
    lines = [
        "Servo identified by `tailbeat identify servo`; the report beside this file has the rest.",
        f"Mean absolute angle error {report['fit_mae_deg']:.2f} deg fitted"
        + ("." if held_out is None else f", {held_out:.2f} deg held out."),
        f"tailbeat {report['tailbeat']}.",
    ]
    if report["gain"] is not None:
        lines.insert(1, f"kp is for gain register {report['gain']:g}; it scales in proportion.")
    return "\n".join(lines)


# ---- cross-validation ---------------------------------------------------------------------------


def cross_validate(
    fish: Fish, benches: Sequence[Bench], config: MotorConfig, scratch: Path, progress: Progress
) -> list[dict[str, Any]]:
    """Leave out each gain in turn (each recording where there is one gain): what is predicted?"""
    groups = sorted({_group(bench, benches) for bench in benches})
    if len(groups) < 2:
        raise BadInput("--cross-validate needs two recordings or more, best at several gains.")
    rows = []
    for group in groups:
        kept = [b for b in benches if _group(b, benches) != group]
        out = [b for b in benches if _group(b, benches) == group]
        found = identify_motor(fish, kept, out, config, scratch, progress)
        runs = [run_row(overlay) for overlay in found.overlays]
        held = [run for run in runs if run["role"] == "validate"]
        rmse = float(np.sqrt(np.mean([run["rmse_deg"] ** 2 for run in held])))
        rows.append({"held_out": group, "mae_deg": mean_error(runs, "validate"), "rmse_deg": rmse})
    return rows


def _group(bench: Bench, benches: Sequence[Bench]) -> str:
    several = len({b.gain for b in benches}) > 1
    return f"gain {bench.gain:g}" if several and bench.gain is not None else bench.name
