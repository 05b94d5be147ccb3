"""Print each result on the terminal, as tables and sentences."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from tailbeat.cli.left_out import sentences
from tailbeat.cli.output import say, tables
from tailbeat.files import leaves
from tailbeat.report.tables import as_rows, percent

if TYPE_CHECKING:
    from tailbeat.benchmarks.suite import Benchmark
    from tailbeat.evaluate.comparison import Comparison
    from tailbeat.evaluate.evaluation import Evaluation
    from tailbeat.evaluate.rates import ConditionResult
    from tailbeat.evaluate.reach import ReachResult
    from tailbeat.report.open_loop import OpenLoopReport
    from tailbeat.train.progress import TrainingResult


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
    tables({"servo": _parameters(report), "recordings": runs})
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


def _parameters(report: dict[str, Any]) -> list[dict[str, Any]]:
    return [
        {
            "parameter": path,
            "value": row["value"],
            "unit": row["unit"],
            "95 % interval": row["interval"],
            "decided by data": "yes" if row["decided_by_data"] else "no",
        }
        for path, row in report["parameters"].items()
    ]


def identified(report: dict[str, Any]) -> None:
    """Print parameters with intervals, seeds, runs and trade-offs of identified coefficients."""
    _verdict(report)
    seeds = [{k: v for k, v in row.items() if k != "values"} for row in report["seeds"]]
    runs = [
        {"role": role, **_run_cells(run)}
        for role, runs in (("fit", report["fit"]), ("held out", report["validate"]))
        for run in runs
    ]
    tables({"parameters": _parameters(report), "seeds, best first": seeds, "runs": runs})
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
    if "naive" in result:
        _say_rival(result)


def _say_rival(result: dict[str, Any]) -> None:
    for who, key in (("twin", ""), ("naive model of five numbers", "naive_")):
        path = 100 * result[f"{key}median_position_error_share"]
        say(f"{who}: median path error {path:.1f} %, heading"
            f" {result[f'{key}median_heading_error_deg']:.1f} deg")  # fmt: skip
    say(f"the twin is better on {100 * result['twin_better_share']:.0f} % of the swims")


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
    for line in (*result["missing"], *result["advice"]):
        say(line)
    if result["covered"]:
        say("The recordings cover the swims.")


def open_loop(report: "OpenLoopReport") -> None:
    """Print the numbers of an open-loop swim, and where the files are."""
    tables({"open-loop swim": as_rows([report], "files")})
    say(f"rendered: {report.rendered}; see {report.folder}/: {', '.join(report.files)}")


def trained(done: "TrainingResult") -> None:
    """Print the stages that were passed, and where the policy is."""
    rows = [
        {
            "stage": f"{row.stage} {row.name}",
            "passed after [min]": row.seconds / 60,
            "updates": row.updates,
            "greedy": row.greedy.reached if row.greedy else None,
        }
        for row in done.promotions
    ]
    tables({"stages passed": rows})
    if done.stalled:
        say("warning: the stage was not passed in its time; look at curve.json and the films.")
    say(f"{done.stages_passed} of {done.stages} stages; policy: {done.policy}")


def contract(held: dict[str, Any]) -> None:
    """Print a policy's contract, with the observation table at the end."""
    rest = {k: v for k, v in held.items() if k not in ("golden", "observation")}
    rows = [{"field": name, "value": value} for name, value in leaves("", rest).items()]
    tables({"contract": rows, "observation": list(held["observation"])})
    say(f"{len(held['golden'][0])} golden pairs agree")


def differences(rows: list[dict[str, Any]]) -> None:
    """Print the fields in which two contracts differ."""
    tables(
        {"differences": [{"field": r["field"], "a": str(r["a"]), "b": str(r["b"])} for r in rows]}
    )
    if not rows:
        say("the contracts are equal")


def evaluated(done: "Evaluation") -> None:
    """Print success rates per condition, tracks and velocity power."""
    rows = [
        {"condition": name, **_rates(row), "median time [s]": row.median_seconds}
        for name, row in done.reach.items()
    ]
    rows += [
        {"condition": row.condition, **_rates(row), "median time [s]": None}
        for row in (*done.disturb, *done.out_of_distribution)
    ]
    power = as_rows(done.spectrum, "cumulative")
    tables({"targets": rows, "tracks": as_rows(done.track), "velocity power": power})
    if done.cut_short:
        say(f"warning: cut off, and read up to their ends: {', '.join(done.cut_short)}")


def _rates(row: "ReachResult | ConditionResult") -> dict[str, Any]:
    """Percentages with their intervals."""
    return {
        "swims": row.swims,
        "within 5 cm [%]": percent(row.within_5cm, row.interval_5cm),
        "within 20 cm [%]": percent(row.within_20cm, row.interval_20cm),
    }


def compared(done: "Comparison") -> None:
    """Print a row per kind of policy and condition of the pool."""
    tables({"kinds": as_rows(done.kinds)})


def benched(result: "Benchmark") -> None:
    """Print the benchmark of step, pool, camera, environment and updates."""
    tables({result.machine: as_rows(result.fish), "virtual pool": as_rows(result.pool)})
    if result.vision is not None:
        rows = as_rows(result.vision.pictures)
        costs = ("draw_ms", "whole_ms", "window_ms", "poses_per_s_core")
        errors = [name for name in rows[0] if name not in ("pictures", *costs)]
        tables({
            "camera: errors of poses": [{n: row[n] for n in ("pictures", *errors)} for row in rows],
            "camera: CPU time": [{n: row[n] for n in ("pictures", *costs)} for row in rows],
            "camera and tracker as processes": as_rows([result.vision.live]),
        })  # fmt: skip
    peers = [] if result.peers is None else [result.peers]
    tables({
        "physics: a control step": as_rows(result.physics),
        "environment": as_rows(result.env, "pairs"),
        "against SB3": as_rows(peers),
        "an update of the training": as_rows(result.update),
    })  # fmt: skip
