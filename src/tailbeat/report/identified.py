"""The page of an identified fish, and the figures of its stages."""

from typing import Any

from tailbeat.identify.chain import Drawings
from tailbeat.report import bench_figures, figures
from tailbeat.report.tables import markdown


def page(report: dict[str, Any], stem: str) -> str:
    """The result as one Markdown page."""
    stages = report["stages"]
    lines = [f"# {report['fish']}, identified", ""]
    for name, stage in stages.items():
        lines += [f"**{name}: {sentence}.**\n" for sentence in stage["verdict"]]
    lines += ["## Tail", "", f"![tail]({stem}-tail.png)", ""]
    names = ("k_eff", "i_eff", "c_eff", "coulomb")
    lines.append(
        markdown(
            ["number", "value", "unit", "95 % interval"],
            [[n, *_cells(stages["tail"][n]), _span(stages["tail"][n])] for n in names],
        )
    )
    lines += ["", "## Servo", "", f"![servo]({stem}-servo.png)", ""]
    servo = stages["servo"]["parameters"]
    lines.append(
        markdown(
            ["number", "value", "unit", "95 % interval"],
            [[n, *_cells(row), _span(row)] for n, row in servo.items()],
        )
    )
    lines += ["", "## Fluid", "", f"![fluid]({stem}-fluid.png)", ""]
    lines.append(
        markdown(
            ["swim", "role", "beat [Hz]", "speed [m/s]", "twin", "path error", "heading [deg]"],
            [_swim(run, role) for role in ("fit", "validate") for run in stages["fluid"][role]],
        )
    )
    lines += ["", "## Against naive predictors", "", _naive(stages)]
    warnings = dict.fromkeys(warning for one in stages.values() for warning in one["warnings"])
    undecided = ", ".join(stages["fluid"]["undecided"]) or "none"
    lines += ["", f"Not decided by the swims: {undecided}.", ""]
    return "\n".join([*lines, *(f"- {warning}" for warning in warnings)]) + "\n"


def _naive(stages: dict[str, Any]) -> str:
    """Errors on the held-out recordings over those of the best naive predictor."""
    servo = "angle of the servo", "best naive servo", stages["servo"]["error_over_best_naive"]
    swims = [(one["quantity"], one["best"], one["ratio"]) for one in stages["fluid"]["naive"]]
    return markdown(
        ["error of", "over that of", "ratio"],
        [[what, best, f"{ratio:.2f}"] for what, best, ratio in (servo, *swims)],
    )


def _cells(row: dict[str, Any]) -> list[str]:
    return [f"{row['value']:.4g}", row["unit"]]


def _span(row: dict[str, Any]) -> str:
    return f"{row['interval'][0]:.4g} … {row['interval'][1]:.4g}"


def _swim(run: dict[str, Any], role: str) -> list[str]:
    return [
        run["recording"],
        "fitted" if role == "fit" else "held out",
        _known(run["beat_frequency"], ".2f"),
        f"{run['measured_speed']:.3f}",
        f"{run['predicted_speed']:.3f}",
        f"{100 * run['position_error_share']:.1f} %",
        _known(run["heading_error_deg"], ".1f"),
    ]


def _known(value: float | None, form: str) -> str:
    return "-" if value is None else format(value, form)


DRAWINGS = Drawings(
    bench_figures.tail, bench_figures.servo_fit, figures.measured_against_twin, page
)
