"""Identify a whole fish from a folder of recordings: tail, then motor, then fluid."""

import hashlib
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from json import loads as from_json
from pathlib import Path
from typing import Any

from tailbeat.files import BadInput, new_file, refuse_existing, write_json
from tailbeat.fish.store import check_fish_name, fish_path, load_fish, write_identified
from tailbeat.identify import job, stages
from tailbeat.identify.protocol import EVERY, HELD_OUT_MOTOR
from tailbeat.identify.stages import DrawFluid, DrawMotor, DrawTail, Progress


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


@dataclass(frozen=True)
class Drawings:
    """What draws the figure of each stage, and what writes the page of a report and a stem."""

    tail: DrawTail
    motor: DrawMotor
    fluid: DrawFluid
    page: Callable[[dict[str, Any], str], str]


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
    config: job.FluidConfig,
    json: Path | None,
    progress: Progress,
    drawings: Drawings,
) -> dict[str, Any]:
    """Tail, then motor, then fluid, each fixed before the next; fish, report, page, figures.

    Stages that are done are kept beside `out` until all are, and taken up again after a stop.
    """
    described = load_fish(fish)
    targets = _targets(out, json)
    data = read_folder(folder)
    work = out.parent / f".{out.stem}.chain" / _key(fish, data, config)
    places = {name: work / f"{name}.toml" for name in ("tail", "motor", "fluid")}
    reports: dict[str, Any] = {}
    _stage(places["tail"], lambda path: _tail(fish, data, path, drawings))
    _stage(places["motor"], lambda path: _motor(places, data, path, config, progress, drawings))
    _stage(places["fluid"], lambda path: _fluid(places, data, path, config, progress, drawings))
    for name, path in places.items():
        reports[name] = _read_json(path.with_suffix(".json"))
    report = {"fish": described.name, "source": str(fish_path(fish)), "stages": reports}
    report["summary"] = summary(reports)
    _publish(places, targets, report, drawings.page(report, out.stem))
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


def _key(fish: str, data: Folder, config: job.FluidConfig) -> str:
    """Names the work by what it is made of: other work is never resumed by mistake."""
    digest = hashlib.sha256(fish_path(fish).read_bytes() + repr(config).encode())
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


def _tail(fish: str, data: Folder, out: Path, drawings: Drawings) -> None:
    stages.tail(fish, data.sweeps, data.static, data.release, out, None, drawings.tail)


def _motor(
    places: dict[str, Path],
    data: Folder,
    out: Path,
    config: job.FluidConfig,
    progress: Progress,
    drawings: Drawings,
) -> None:
    stages.motor(
        str(places["tail"]),
        data.motor_fit,
        data.motor_validate,
        out,
        None,
        stages.motor_config(config.seeds, config.first_seed, True, None),
        False,
        None,
        progress,
        drawings.motor,
    )


def _fluid(
    places: dict[str, Path],
    data: Folder,
    out: Path,
    config: job.FluidConfig,
    progress: Progress,
    drawings: Drawings,
) -> None:
    fish = str(places["motor"])
    stages.fluid(
        fish, data.fluid_fit, data.fluid_validate, out, config, None, progress, drawings.fluid
    )


def _read_json(path: Path) -> Any:
    return from_json(path.read_text(encoding="utf-8"))


def _publish(
    places: dict[str, Path], targets: dict[str, Path], report: dict[str, Any], text: str
) -> None:
    for name, path in places.items():
        with new_file(targets[name]) as beside:
            shutil.copyfile(path.with_suffix(".png"), beside)
    write_json(targets["json"], report)
    with new_file(targets["page"]) as beside:
        beside.write_text(text, encoding="utf-8")
    write_identified(places["fluid"], targets["fish"], {"name": targets["fish"].stem}, "")


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
