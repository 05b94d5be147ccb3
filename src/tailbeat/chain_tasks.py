"""What do the pool's verbs do? Record experiments, and identify a whole fish from a folder."""

import hashlib
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from json import loads as from_json
from pathlib import Path
from typing import Any

from tailbeat import bench_tasks, tasks
from tailbeat.evaluate.bench_day import EVERY, HELD_OUT_MOTOR
from tailbeat.evaluate.flutter import flutter as speeds_of
from tailbeat.files import BadInput, new_file, refuse_existing, write_json
from tailbeat.fish.store import check_fish_name, fish_path, load_fish, write_identified
from tailbeat.identify import job
from tailbeat.pool.protocols import record_fluid, record_motor, record_tail
from tailbeat.recording import Recording, read_recording, write_recording
from tailbeat.report import figures

Progress = Callable[[int, str, float, float], None]
RECORDERS: dict[str, Callable[..., Iterator[Recording]]] = {
    "tail": record_tail,
    "motor": record_motor,
    "fluid": record_fluid,
}


@dataclass(frozen=True)
class Folder:
    """The recordings of one fish, sorted by what they are for."""

    sweeps: list[Path]
    static: Path | None
    release: Path | None
    motor_fit: list[Path]
    motor_validate: list[Path]
    fluid_fit: list[Path]
    fluid_validate: list[Path]


def record(kind: str, fish: str, out: Path, seed: int, commands: Sequence[Path] = ()) -> list[Path]:
    """Play one bench's protocol (or given commands) in the virtual pool; writes its recordings,
    returns their paths."""
    if kind not in RECORDERS:
        raise BadInput(f"record {kind!r}: allowed are {', '.join(RECORDERS)}.")
    if any(out.glob(f"{kind}-*.csv")):
        raise BadInput(f"{out}: {kind} recordings exist already; give another folder.")
    paths = []
    given = [read_recording(path) for path in commands]
    for recording in RECORDERS[kind](load_fish(fish), seed, commands=given):
        paths.append(out / f"{recording.name}.csv")
        write_recording(recording, paths[-1])
    return paths


def read_folder(folder: Path) -> Folder:
    """Sort a folder's recordings by their names. Raises BadInput where a bench is missing."""
    names = sorted([*folder.glob("*.csv"), *folder.glob("*.parquet")])
    found = {
        kind: [path for path in names if path.stem.startswith(kind)]
        for kind in ("tail-sweep", "tail-static", "tail-release", "motor-", "fluid-")
    }
    for kind in ("tail-sweep", "motor-", "fluid-"):
        if not found[kind]:
            raise BadInput(
                f"{folder}: no recording whose name begins with {kind}; record it, or make one with"
                f" `tailbeat record` (docs/bench.md names them)."
            )
    motor = found["motor-"]
    held = [p for p in motor if p.stem in HELD_OUT_MOTOR] if len(motor) > 2 else []
    swims = found["fluid-"]
    return Folder(
        found["tail-sweep"],
        next(iter(found["tail-static"]), None),
        next(iter(found["tail-release"]), None),
        [p for p in motor if p not in held],
        held,
        [p for i, p in enumerate(swims) if (i + 1) % EVERY],
        swims[EVERY - 1 :: EVERY],
    )


def identify_all(
    fish: str,
    folder: Path,
    out: Path,
    plan: job.Plan,
    json: Path | None,
    progress: Progress,
) -> dict[str, Any]:
    """Tail, then motor, then fluid, each fixed before the next; fish, report, page, figures.

    Stages that are done are kept beside `out` until all are, and taken up again after a stop.
    """
    described = load_fish(fish)
    targets = _targets(out, json)
    data = read_folder(folder)
    work = out.parent / f".{out.stem}.chain" / _key(fish, data, plan)
    stages = {name: work / f"{name}.toml" for name in ("tail", "motor", "fluid")}
    reports: dict[str, Any] = {}
    _stage(stages["tail"], lambda path: _tail(fish, data, path))
    _stage(stages["motor"], lambda path: _motor(stages, data, path, plan, progress))
    _stage(stages["fluid"], lambda path: _fluid(stages, data, path, plan, progress))
    for name, path in stages.items():
        reports[name] = _read_json(path.with_suffix(".json"))
    report = {"fish": described.name, "source": str(fish_path(fish)), "stages": reports}
    report["summary"] = summary(reports)
    _publish(stages, targets, report, page(report, out.stem))
    shutil.rmtree(work.parent, ignore_errors=True)
    return report


def _targets(out: Path, json: Path | None) -> dict[str, Path]:
    check_fish_name(out)
    stem = out.with_suffix("")
    targets = {
        "fish": out,
        "json": json or out.with_suffix(".json"),
        "page": out.with_suffix(".md"),
    }
    targets |= {name: Path(f"{stem}-{name}.png") for name in ("tail", "motor", "fluid")}
    for path in targets.values():
        refuse_existing(path)
    return targets


def _key(fish: str, data: Folder, plan: job.Plan) -> str:
    """Names the work by what it is made of: other work is never resumed by mistake."""
    digest = hashlib.sha256(fish_path(fish).read_bytes() + repr(plan).encode())
    singles = [path for path in (data.static, data.release) if path is not None]
    for path in [*data.sweeps, *singles, *data.motor_fit, *data.motor_validate, *data.fluid_fit]:
        digest.update(path.read_bytes())
    for path in data.fluid_validate:
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _stage(done: Path, run: Callable[[Path], Any]) -> None:
    """A stage's fish is written last, so its presence says that the stage is done."""
    if done.is_file():
        return
    for stale in (done.with_suffix(".json"), done.with_suffix(".png")):
        stale.unlink(missing_ok=True)
    run(done)


def _tail(fish: str, data: Folder, out: Path) -> None:
    bench_tasks.identify_tail(fish, data.sweeps, data.static, data.release, out, None)


def _motor(
    stages: dict[str, Path], data: Folder, out: Path, plan: job.Plan, progress: Progress
) -> None:
    bench_tasks.identify_motor(
        str(stages["tail"]),
        data.motor_fit,
        data.motor_validate,
        out,
        None,
        bench_tasks.motor_plan(plan.seeds, plan.first_seed, True, None),
        False,
        None,
        progress,
    )


def _fluid(
    stages: dict[str, Path], data: Folder, out: Path, plan: job.Plan, progress: Progress
) -> None:
    fish = str(stages["motor"])
    tasks.identify_fluid(fish, data.fluid_fit, data.fluid_validate, out, plan, None, progress)


def _read_json(path: Path) -> Any:
    return from_json(path.read_text(encoding="utf-8"))


def _publish(
    stages: dict[str, Path], targets: dict[str, Path], report: dict[str, Any], text: str
) -> None:
    for name, path in stages.items():
        with new_file(targets[name]) as beside:
            shutil.copyfile(path.with_suffix(".png"), beside)
    write_json(targets["json"], report)
    with new_file(targets["page"]) as beside:
        beside.write_text(text, encoding="utf-8")
    write_identified(stages["fluid"], targets["fish"], {"name": targets["fish"].stem}, "")


def flutter(
    fish: str, servos: Sequence[str] | None, out: Path, json: Path | None
) -> dict[str, Any]:
    """Speeds of twin and plant; figure and JSON."""
    for path in filter(None, (out, json)):
        refuse_existing(path)
    described = load_fish(fish)
    chosen = list(servos or [described.servo])
    for name in chosen:
        if name not in described.servos:
            allowed = ", ".join(described.servos)
            raise BadInput(f"--servo {name!r}: {described.name} has {allowed}.")
    report = speeds_of(described, chosen)
    figures.speed_map(report, out)
    if json is not None:
        write_json(json, report)
    return report


# ---- one page -----------------------------------------------------------------------------------


def summary(reports: dict[str, Any]) -> dict[str, Any]:
    """The numbers one asks for first."""
    held_out = reports["fluid"]["validate"]
    return {
        "k_eff": reports["tail"]["k_eff"]["value"],
        "c_eff": reports["tail"]["c_eff"]["value"],
        "servo_mae_deg": reports["motor"]["validate_mae_deg"],
        "speed_mae": reports["fluid"]["validate_speed_mae"],
        "position_error_share": [run["position_error_share"] for run in held_out],
        "heading_error_deg": [run["heading_error_deg"] for run in held_out],
    }


def page(report: dict[str, Any], stem: str) -> str:
    """The result as one Markdown page."""
    stages = report["stages"]
    lines = [f"# {report['fish']}, identified", "", "## Tail", "", f"![tail]({stem}-tail.png)", ""]
    names = ("k_eff", "i_eff", "c_eff", "coulomb")
    lines += _table(
        ["number", "value", "unit", "95 % interval"],
        [[n, *_cells(stages["tail"][n]), _span(stages["tail"][n])] for n in names],
    )
    lines += ["", "## Servo", "", f"![servo]({stem}-motor.png)", ""]
    servo = stages["motor"]["parameters"]
    lines += _table(
        ["number", "value", "unit", "95 % interval"],
        [[n, *_cells(row), _span(row)] for n, row in servo.items()],
    )
    lines += ["", "## Fluid", "", f"![fluid]({stem}-fluid.png)", ""]
    lines += _table(
        ["swim", "role", "beat [Hz]", "speed [m/s]", "twin", "path error", "heading [deg]"],
        [_swim(run, role) for role in ("fit", "validate") for run in stages["fluid"][role]],
    )
    warnings = [*stages["tail"]["warnings"], *stages["motor"]["warnings"]]
    undecided = ", ".join(stages["fluid"]["undecided"]) or "none"
    lines += ["", f"Not decided by the swims: {undecided}.", ""]
    return "\n".join([*lines, *(f"- {warning}" for warning in warnings)]) + "\n"


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    rule = "|" + "---|" * len(head)
    return [f"| {' | '.join(head)} |", rule, *(f"| {' | '.join(row)} |" for row in rows)]


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
