"""Print each result on the terminal, as tables and sentences."""

from typing import TYPE_CHECKING, Any

from tailbeat.cli.output import say, tables
from tailbeat.control.measure import Measure, centimetres
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
        say("warning: the stage was not passed in its time; look at curve.png.")
    say(f"{done.stages_passed} of {done.stages} stages; policy: {done.policy}")


def contract(held: dict[str, Any]) -> None:
    """Print a policy's contract, with the observation table at the end."""
    aside = ("golden", "observation", "description")
    rest = {k: v for k, v in held.items() if k not in aside}
    rows = [{"field": name, "value": value} for name, value in leaves("", rest).items()]
    tables({"contract": rows, "observation": list(held["observation"])})
    say(f"{len(held['golden'][0])} golden pairs agree")
    inside = "no" if held["description"] is None else "yes"
    say(f"carries its fish: {inside}")


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
        {"condition": name, **_rates(row, done.run.measure), "median time [s]": row.median_seconds}
        for name, row in done.reach.items()
    ]
    rows += [
        {"condition": row.condition, **_rates(row, done.run.measure), "median time [s]": None}
        for row in (*done.disturb, *done.out_of_distribution, *done.messy)
    ]
    power = as_rows(done.spectrum, "cumulative")
    tables({"targets": rows, "tracks": as_rows(done.track), "velocity power": power})
    if done.cut_short:
        say(f"warning: cut off, and read up to their ends: {', '.join(done.cut_short)}")


def _rates(row: "ReachResult | ConditionResult", m: Measure) -> dict[str, Any]:
    """Percentages with their intervals."""
    return {
        "swims": row.swims,
        f"within {centimetres(m.arrival)} [%]": percent(row.arrived, row.arrived_interval),
        f"within {centimetres(m.near)} [%]": percent(row.near, row.near_interval),
        "lost": row.lost,
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
        "virtual pool: labs with all sensors": as_rows(result.messy),
        "physics: a control step": as_rows(result.physics),
        "environment": as_rows(result.env, "pairs"),
        "against SB3": as_rows(peers),
        "an update of the training": as_rows(result.update),
        "control loop beside busy programs": as_rows(result.loop),
        "a sweep, against one training after the other": as_rows(filter(None, [result.sweep])),
        "by arithmetic, on more cores": as_rows(result.more_cores),
    })  # fmt: skip
