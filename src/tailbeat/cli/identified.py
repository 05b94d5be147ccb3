"""Print the results of identification and prediction on the terminal."""

from collections.abc import Sequence
from statistics import median
from typing import Any

from tailbeat.cli.left_out import sentences
from tailbeat.cli.output import say, tables


def tail(report: dict[str, Any]) -> None:
    """Print shaft numbers, hinges and warnings of an identified tail."""
    _verdict(report)
    names = {"k_eff": "stiffness", "i_eff": "inertia", "c_eff": "damping", "coulomb": "friction"}
    shaft = [
        {
            "at the shaft": f"{name} ({key})",
            "value": report[key]["value"],
            "unit": report[key]["unit"],
            "95 % interval": report[key]["interval"],
        }
        for key, name in names.items()
    ]
    hinges = [
        {"hinge": i, "arm [mm]": 1e3 * arm, "stiffness [N m/rad]": k}
        for i, (arm, k) in enumerate(zip(report["arms"], report["joint_stiffness"], strict=True))
    ]
    tables({f"{len(report['conditions'])} conditions": shaft, "hinges": hinges})
    say(f"compiled twin at the shaft: {report['k_eff_compiled']:.4g} N m/rad")
    if report["static"] is not None:
        static = report["static"]
        say(
            f"a static test gives {static['loading']:.3g} N m/rad while loading"
            f" ({100 * static['bias']:+.0f} % off), {static['unloading']:.3g} while unloading"
        )
    if report["ring_down"] is not None:
        ring = report["ring_down"]
        say(
            f"ring-down: {ring['natural_frequency']['value']:.3g} Hz, damping ratio"
            f" {ring['damping_ratio']['value']:.3g}"
        )
    _warn(report["warnings"])
    _say_glitches(report)


def servo(report: dict[str, Any]) -> None:
    """Print numbers, recordings, trade-offs and warnings of an identified servo."""
    _verdict(report)
    runs = [
        {name.replace("_deg", " [deg]"): value for name, value in run.items()}
        for run in report["runs"]
    ]
    tables({"servo": parameters(report["parameters"]), "recordings": runs})
    for row in report.get("cross_validation", []):
        say(f"without {row['held_out']}: {row['mae_deg']:.2f} deg mean absolute error on it")
    for pair in report["trade_offs"]:
        a, b = pair["parameters"]
        say(
            f"the data do not separate {a} and {b} (correlation {pair['correlation']:.2f});"
            f" record {pair['separated_by']}"
        )
    _warn(report["warnings"])
    _say_glitches(report)
    held_out = report["validate_mae_deg"]
    rest = "" if held_out is None else f", {held_out:.2f} deg on the held-out recordings"
    say(f"mean absolute angle error {report['fit_mae_deg']:.2f} deg on the fitted{rest}")
    say(f"{report['error_over_best_naive']:.2f} times the error of the best naive predictor")


def whole(report: dict[str, Any]) -> None:
    """Print the main numbers of a fish whose tail, servo and fluid were identified."""
    found, stages = report["summary"], report["stages"]
    held_out = found["servo_mae_deg"] is not None
    row = {
        "stiffness [N m/rad]": found["k_eff"],
        "damping [N m s/rad]": found["c_eff"],
        "servo error, held out [deg]" if held_out else "servo error, fitted [deg]": (
            found["servo_mae_deg"] if held_out else stages["servo"]["fit_mae_deg"]
        ),
        "speed error [mm/s]": None if found["speed_mae"] is None else 1e3 * found["speed_mae"],
        "path error, median [%]": _median(found["position_error_share"], 100),
        "heading error, median [deg]": _median(found["heading_error_deg"]),
    }
    tables({f"{len(found['position_error_share'])} held-out swims": [row]})
    say(f"servo: {stages['servo']['error_over_best_naive']:.2f} times the error of the naive one")
    _say_naive(stages["fluid"])


def _median(values: Sequence[float | None], by: float = 1.0) -> float | None:
    """Median of the sizes of the values that there are, times `by`."""
    known = [abs(value) for value in values if value is not None]
    return by * median(known) if known else None


def first(verdict: Sequence[str]) -> None:
    """Print the verdict, before everything else."""
    for sentence in verdict:
        say(sentence)


def _verdict(report: dict[str, Any]) -> None:
    first(report["verdict"])


def _say_glitches(report: dict[str, Any]) -> None:
    for line in sentences(report["glitches"]):
        say(line)


def _warn(warnings: list[str]) -> None:
    for warning in warnings:
        say(f"warning: {warning}")


def parameters(known: dict[str, Any]) -> list[dict[str, Any]]:
    """One row per identified number of `known`, field -> its JSON (`estimate.as_row`)."""
    return [
        {
            "parameter": path,
            "value": row["value"],
            "unit": row["unit"],
            "95 % interval": row["interval"],
            "decided by data": "yes" if row["decided_by_data"] else "no",
        }
        for path, row in known.items()
    ]


def identified(report: dict[str, Any]) -> None:
    """Print parameters with intervals, seeds, runs and trade-offs of identified coefficients."""
    _verdict(report)
    _warn(report["warnings"])
    seeds = [{k: v for k, v in row.items() if k != "values"} for row in report["seeds"]]
    runs = [
        {"role": role, **_run_cells(run)}
        for role, runs in (("fit", report["fit"]), ("held out", report["validate"]))
        for run in runs
    ]
    found = parameters(report["parameters"])
    tables({"parameters": found, "seeds, best first": seeds, "runs": runs})
    if report["without_effect"]:
        say(f"no effect on the result, not fitted: {', '.join(report['without_effect'])}")
    for pair in report["trade_offs"]:
        a, b = pair["parameters"]
        say(f"the data do not separate {a} and {b} (correlation {pair['correlation']:.2f})")
    _say_glitches(report)
    _say_errors(report)


def _say_errors(report: dict[str, Any]) -> None:
    held_out = report["validate_speed_mae"]
    tail = "" if held_out is None else f", {1e3 * held_out:.1f} mm/s on the held-out runs"
    say(f"mean absolute speed error {1e3 * report['fit_speed_mae']:.1f} mm/s on the fitted{tail}")
    _say_naive(report)


def _say_naive(report: dict[str, Any]) -> None:
    for one in report["naive"]:
        say(f"{one['quantity']}: {one['ratio']:.2f} times the error of the {one['best']}")


def _run_cells(run: dict[str, Any]) -> dict[str, Any]:
    return {
        "recording": run["recording"],
        "beat [Hz]": run["beat_frequency"],
        "speed [m/s]": run["measured_speed"],
        "twin [m/s]": run["predicted_speed"],
        "stroke [m]": run["measured_tail_amplitude"],
        "twin [m]": run["predicted_tail_amplitude"],
        "marker error [mm]": 1e3 * run["marker_error"],
        "settled": "yes" if run["settled"] else "NO",
        **_path_cells(run),
    }


def _path_cells(run: dict[str, Any]) -> dict[str, Any]:
    """Errors of a replayed run's path; empty for a cruise."""
    if "distance" not in run:
        return {}
    return {
        "path error [%]": 100 * run["position_error_share"],
        "heading [deg]": run["heading_error_deg"],
    }


def predicted(result: dict[str, Any]) -> None:
    """Print one row per recording, and the mean absolute speed error."""
    tables({"measured and predicted": [_run_cells(run) for run in result["runs"]]})
    _say_glitches(result)
    say(f"mean absolute speed error {1e3 * result['speed_mae']:.1f} mm/s")
    if "bands" in result:
        _say_bands(result)
    else:
        say("no 95 % bands: they need a posterior, and --check SWIM if it has no discrepancy")
    if "naive" in result:
        _say_rival(result)


def _say_bands(result: dict[str, Any]) -> None:
    """One row per swim and quantity, then how many bands hold."""
    rows = [
        {
            "recording": band["recording"],
            "quantity": f"{band['quantity'].replace('_', ' ')} [{band['unit']}]",
            "measured": band["measured"],
            "95 % band from": band["low"],
            "to": band["high"],
            "inside": "yes" if band["inside"] else "NO",
        }
        for band in result["bands"]
    ]
    tables({"95 % bands": rows})
    _say_factors(result["discrepancy"])
    _say_held(result["held"])


def _say_factors(known: dict[str, Any]) -> None:
    """By what the twin's predictions were multiplied for the bands."""
    for name, one in known.items():
        if isinstance(one, dict) and one["swims"]:
            say(
                f"{name.replace('_', ' ')}: {one['factor']:.3f} ± {1.96 * one['error']:.3f} times"
                f" the twin's, by {one['swims']} check swims"
            )


def _say_held(held: Sequence[dict[str, Any]]) -> None:
    for one in held:
        say(
            f"{one['quantity'].replace('_', ' ')}: {one['inside']} of {one['swims']} swims inside;"
            f" median half width {one['half_width']:.3g} {one['unit']}, median error"
            f" {one['error']:.3g} {one['unit']}"
        )


def _say_rival(result: dict[str, Any]) -> None:
    for who, key in (("twin", ""), ("naive model of five numbers", "naive_")):
        path = 100 * result[f"{key}median_position_error_share"]
        say(f"{who}: median path error {path:.1f} %, heading"
            f" {result[f'{key}median_heading_error_deg']:.1f} deg")  # fmt: skip
    say(f"the twin is better on {100 * result['twin_better_share']:.0f} % of the swims")


def advice(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Table of what to record next."""
    return [
        {
            "record": row["record"],
            "kind": row["kind"],
            "band shrinks by [%]": 100 * row["gain"],
            "lab time [min]": row["minutes"],
            "per minute [%]": 100 * row["gain_per_minute"],
        }
        for row in rows
    ]


def covered(result: dict[str, Any]) -> None:
    """Print ranges and fractions of each quantity, power by band, and what to record next."""
    rows = [
        {
            "quantity": f"{one['quantity']} [{one['unit']}]",
            "recorded from": one["low"],
            "to": one["high"],
            "below [%]": 100 * one["below"],
            "above [%]": 100 * one["above"],
            "histogram overlap [%]": 100 * one["overlap"],
            "covered": "yes" if one["covered"] else "NO",
        }
        for one in result["quantities"]
    ]
    bands = [
        {
            "from [Hz]": band["low"],
            "to": band["high"],
            "swims [%]": 100 * band["swims"],
            "recordings [%]": 100 * band["recordings"],
        }
        for band in result["bands"]
    ]
    tables({"swims against recordings": rows, "the motor's power": bands})
    _say_glitches(result)
    for line in (*result["missing"], *result["advice"]):
        say(line)
    if result["covered"]:
        say("The recordings cover the swims.")
