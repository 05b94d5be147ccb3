"""Identify tail, motor and fluid: read recordings, write a fish, its report and its figure.

Whoever calls gives the function that draws the figure, so that the three files are written
together.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from tailbeat.files import BadInput, write_json
from tailbeat.fish.store import (
    Done,
    fish_path,
    load_fish,
    new_fish_files,
    with_values,
    write_identified,
)
from tailbeat.fish.water import whole
from tailbeat.identify import job, motor_job, motor_report, tail_report
from tailbeat.identify.decay import ring_down, static_loop
from tailbeat.identify.motor import as_bench
from tailbeat.identify.motor_job import MotorConfig, ServoFit
from tailbeat.identify.predict import Prediction
from tailbeat.identify.runs import as_run
from tailbeat.identify.search import Effort
from tailbeat.identify.tail import identify_tail
from tailbeat.identify.tail_report import TailResult
from tailbeat.recording import Recording, read_recording

Progress = Callable[[int, str, float, float], None]
DrawTail = Callable[[TailResult, Recording | None, Path], None]
DrawMotor = Callable[[ServoFit, Path], None]
DrawFluid = Callable[[list[tuple[str, Prediction]], Path], None]


def tail(
    fish: str,
    sweeps: Sequence[Path],
    static: Path | None,
    release: Path | None,
    out: Path,
    json: Path | None,
    draw: DrawTail,
) -> Done:
    """Fit the tail, spread it over the hinges, write fish, report and figure."""
    files = new_fish_files(out, json)
    described = load_fish(fish)
    recordings = [read_recording(path) for path in sweeps]
    pull = None if static is None else read_recording(static)
    ring = None if release is None else ring_down(read_recording(release))
    loop = None if pull is None else static_loop(pull)
    found = tail_report.combine(described, identify_tail(recordings), loop, ring)
    report = {"fish": str(fish_path(fish)), **tail_report.as_report(found)}
    draw(found, pull, files[2])
    write_json(files[1], report)
    names = [recording.name for recording in recordings]
    write_identified(fish, out, tail_report.toml_values(found, names), tail_report.heading(found))
    return Done(report, files)


def motor_config(seeds: int, seed: int, gears: bool, gain: float | None) -> MotorConfig:
    """Check the options of a servo identification."""
    if seeds < 1:
        raise BadInput(f"--seeds {seeds}: give 1 or more.")
    if gain is not None and not gain > 0:
        raise BadInput(f"--gain {gain:g}: give the gain register's value, above 0.")
    return MotorConfig(seeds=seeds, first_seed=seed, gears=gears, gain=gain)


def motor(
    fish: str,
    fit: Sequence[Path],
    validate: Sequence[Path],
    out: Path,
    load: str | None,
    config: MotorConfig,
    across: bool,
    json: Path | None,
    progress: Progress,
    draw: DrawMotor,
) -> Done:
    """Fit the servo, write fish, report and figure; nothing is written if anything fails."""
    files = new_fish_files(out, json)
    described = load_fish(fish)
    fitted, held_out = (
        [as_bench(read_recording(path), described, load) for path in paths]
        for paths in (fit, validate)
    )
    scratch = out.parent / f".{out.stem}.search"
    found = motor_job.identify_motor(described, fitted, held_out, config, scratch, progress)
    report = {"fish": str(fish_path(fish)), **motor_report.as_report(found)}
    if across:
        report["cross_validation"] = motor_report.cross_validate(
            described, fitted, config, scratch, progress
        )
    draw(found, files[2])
    write_json(files[1], report)
    names = [bench.name for bench in fitted]
    values, note = motor_report.toml_values(found, names), motor_report.heading(report)
    write_identified(fish, out, values, note)
    job.clear(scratch)
    return Done(report, files)


def fluid_config(
    zones: int,
    seeds: int,
    seed: int,
    generations: int,
    start_weight: bool | None,
    added_inertia: float | None = None,
    whole: bool = False,
) -> job.FluidConfig:
    """Check the options of an identification."""
    if zones not in (1, 3):
        raise BadInput(f"--zones {zones}: give 1 (one coefficient set) or 3 (one per zone).")
    if seeds < 1 or generations < 1:
        raise BadInput(f"--seeds {seeds} --generations {generations}: both must be 1 or more.")
    if added_inertia is not None and not 0 <= added_inertia <= 2:
        raise BadInput(f"--added-inertia {added_inertia:g}: give a share from 0 to 2.")
    if added_inertia is not None and whole:
        raise BadInput("--added-inertia with --law whole, which sets it to 1; leave one out.")
    effort = Effort(generations=generations)
    return job.FluidConfig(zones, seeds, seed, effort, start_weight, added_inertia, whole)


def fluid(
    fish: str,
    fit: Sequence[Path],
    validate: Sequence[Path],
    out: Path,
    config: job.FluidConfig,
    json: Path | None,
    progress: Progress,
    draw: DrawFluid,
) -> Done:
    """Fit, then write fish, report and figure; nothing is written if anything fails."""
    files = new_fish_files(out, json)
    described = load_fish(fish)
    if config.added_inertia is not None:
        described = with_values(described, {"added_inertia": config.added_inertia})
    if config.whole:
        described = whole(described)
    fitted, held_out = (
        [as_run(read_recording(path), described) for path in paths] for paths in (fit, validate)
    )
    scratch = out.parent / f".{out.stem}.search"
    found = job.identify_fluid(described, fitted, held_out, config, scratch, progress)
    report = write_fluid(found, config, fish, files, draw)
    job.clear(scratch)
    return Done(report, files)


def write_fluid(
    found: job.Identified,
    config: job.FluidConfig,
    fish: str,
    files: tuple[Path, Path, Path],
    draw: DrawFluid,
) -> dict[str, Any]:
    """Write fish, report and figure; returns the report."""
    out, json, figure = files
    names = [p.run.name for p in found.fitted]
    report = {"fish": str(fish_path(fish)), **job.as_report(found, config)}
    rows = [("fitted", found.fitted[0])] + [("held out", p) for p in found.validated[:1]]
    draw(rows, figure)
    write_json(json, report)
    values: dict[str, Any] = {"name": out.stem, **job.toml_values(found, names)}
    write_identified(fish, out, values, job.heading(found, config))
    return report
