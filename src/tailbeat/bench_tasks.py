"""What do the bench verbs do? Tail, servo, protocol and the logs they read."""

from collections.abc import Callable, Sequence
from pathlib import Path

from tailbeat import importers
from tailbeat.files import BadInput, refuse_existing, write_json
from tailbeat.fish.store import Done, fish_path, load_fish, new_fish_files, write_identified
from tailbeat.identify import job, motor_job, motor_report, protocol, tail_report
from tailbeat.identify.decay import ring_down, static_loop
from tailbeat.identify.manoeuvres import manoeuvres
from tailbeat.identify.motor import as_bench
from tailbeat.identify.tail import identify_tail as fit_tail
from tailbeat.recording import Recording, read_recording, write_recording
from tailbeat.report import bench_figures

Progress = Callable[[int, str, float, float], None]
PROTOCOLS = ("tail", "motor", "fluid")


def identify_tail(
    fish: str,
    sweeps: Sequence[Path],
    static: Path | None,
    release: Path | None,
    out: Path,
    json: Path | None,
) -> Done:
    """Fit the tail, spread it over the hinges, write fish, report and figure."""
    files = new_fish_files(out, json)
    described = load_fish(fish)
    recordings = [read_recording(path) for path in sweeps]
    pull = None if static is None else read_recording(static)
    ring = None if release is None else ring_down(read_recording(release))
    loop = None if pull is None else static_loop(pull)
    found = tail_report.combine(described, fit_tail(recordings), loop, ring)
    report = {"fish": str(fish_path(fish)), **tail_report.as_report(found)}
    bench_figures.tail(found, pull, files[2])
    write_json(files[1], report)
    names = [recording.name for recording in recordings]
    write_identified(fish, out, tail_report.toml_values(found, names), tail_report.heading(found))
    return Done(report, files)


def motor_plan(seeds: int, seed: int, gears: bool, gain: float | None) -> motor_job.Plan:
    """Check the options of a servo identification."""
    if seeds < 1:
        raise BadInput(f"--seeds {seeds}: give 1 or more.")
    if gain is not None and not gain > 0:
        raise BadInput(f"--gain {gain:g}: give the gain register's value, above 0.")
    return motor_job.Plan(seeds=seeds, first_seed=seed, gears=gears, gain=gain)


def identify_motor(
    fish: str,
    fit: Sequence[Path],
    validate: Sequence[Path],
    out: Path,
    load: str | None,
    plan: motor_job.Plan,
    across: bool,
    json: Path | None,
    progress: Progress,
) -> Done:
    """Fit the servo, write fish, report and figure; nothing is written if anything fails."""
    files = new_fish_files(out, json)
    described = load_fish(fish)
    fitted, held_out = (
        [as_bench(read_recording(path), described, load) for path in paths]
        for paths in (fit, validate)
    )
    scratch = out.parent / f".{out.stem}.search"
    found = motor_job.identify_motor(described, fitted, held_out, plan, scratch, progress)
    report = {"fish": str(fish_path(fish)), **motor_report.as_report(found)}
    if across:
        report["cross_validation"] = motor_report.cross_validate(
            described, fitted, plan, scratch, progress
        )
    bench_figures.motor(found, files[2])
    write_json(files[1], report)
    names = [bench.name for bench in fitted]
    values, note = motor_report.toml_values(found, names), motor_report.heading(report)
    write_identified(fish, out, values, note)
    job.clear(scratch)
    return Done(report, files)


def import_xl330(log: Path, out: Path, json: Path | None) -> Recording:
    """Read a pendulum log, write a recording."""
    for path in filter(None, (out, json)):
        refuse_existing(path)
    recording = importers.import_xl330(log)
    write_recording(recording, out)
    if json is not None:
        write_json(json, {"recording": str(out), "rows": recording.time.size, **recording.meta})
    return recording


def write_protocol(kind: str, fish: str, out: Path, speed: float) -> list[Path]:
    """Write the command recordings of one bench into a folder; returns their paths."""
    if kind not in PROTOCOLS:
        raise BadInput(f"protocol {kind!r}: allowed are {', '.join(PROTOCOLS)}.")
    described = load_fish(fish)
    limit = protocol.limits(described, speed)
    if kind == "tail":
        made = {
            "tail-sweep": protocol.tail_sweep(described, limit),
            "tail-static": protocol.tail_static(limit),
        }
    elif kind == "motor":
        made = protocol.motor_commands(described, limit)
    else:
        made = {**protocol.fluid_runs(described, limit), **manoeuvres(described, limit)}
    paths = [out / f"{name}.csv" for name in made]
    for path in paths:
        refuse_existing(path)
    for path, recording in zip(paths, made.values(), strict=True):
        write_recording(recording, path)
    return paths
