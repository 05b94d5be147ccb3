"""Identify tail, servo and fluid: read recordings, write a fish, its report and its figure.

The caller passes the function that draws the figure, so that the three files are written together.
If the fit fails, nothing is written.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from tailbeat.files import refuse_existing, write_json
from tailbeat.fish.description import Fish
from tailbeat.fish.store import (
    Entries,
    check_fish_name,
    fish_path,
    load_fish,
    with_values,
    write_identified,
)
from tailbeat.fish.water import whole
from tailbeat.identify import (
    fluid_report,
    job,
    posterior,
    servo_job,
    servo_report,
    servo_search,
    step_check,
    tail_report,
)
from tailbeat.identify.clean import clean_pull, clean_tail
from tailbeat.identify.decay import ring_down, static_loop
from tailbeat.identify.predict import Prediction
from tailbeat.identify.runs import Run, as_runs
from tailbeat.identify.servo import as_benches, check_driven
from tailbeat.identify.servo_job import ServoFit
from tailbeat.identify.servo_search import ServoConfig
from tailbeat.identify.shaft import Bench
from tailbeat.identify.step_check import Held
from tailbeat.identify.tail import identify_tail
from tailbeat.identify.tail_report import TailResult
from tailbeat.recording import Recording, read_recording, read_recordings, refuse_shared

Progress = Callable[[int, str, float, float], None]
DrawTail = Callable[[TailResult, Recording | None, Path], None]
DrawServo = Callable[[ServoFit, Path], None]
DrawFluid = Callable[[list[tuple[str, Prediction]], Path], None]


@dataclass(frozen=True)
class Paths:
    """What an identification reads and writes: the `fish` by its shipped name or file, recordings
    to `fit`, held-out ones to `validate`, the fish to write, `out`, and its report, `json` (None:
    beside `out`). `check` are swims unlike the fitted ones, for the twin's discrepancy."""

    fish: str
    fit: Sequence[Path]
    out: Path
    validate: Sequence[Path] = ()
    json: Path | None = None
    check: Sequence[Path] = ()

    @property
    def written(self) -> tuple[Path, Path, Path]:
        """Fish, report and figure."""
        return self.out, self.json or self.out.with_suffix(".json"), self.out.with_suffix(".png")

    @property
    def scratch(self) -> Path:
        """Folder of a search's checkpoints until it is done."""
        return self.out.parent / f".{self.out.stem}.search"


def tail(paths: Paths, static: Path | None, release: Path | None, draw: DrawTail) -> TailResult:
    """Fit the tail, distribute it over the hinges, write fish, report and figure. `static` is a
    slow pull, `release` a released tail. Raises BadInput for recordings that cannot be used, or if
    an output exists."""
    _refuse_taken(paths)
    described = load_fish(paths.fish)
    recordings = read_recordings(paths.fit)
    pull, pulled = (None, ()) if static is None else clean_pull(read_recording(static))
    rung, listed = (None, ()) if release is None else clean_tail(read_recording(release))
    ring = None if rung is None else ring_down(rung)
    loop = None if pull is None else static_loop(pull)
    fit = identify_tail(recordings)
    found = tail_report.combine(described, fit, loop, ring, (*pulled, *listed))
    named = tail_report.toml_values(found, [recording.name for recording in recordings])
    values = _reported(paths, named, tail_report.as_report(found), partial(draw, found, pull))
    write_identified(paths.fish, paths.out, values, tail_report.heading(found))
    return found


def servo(paths: Paths, config: ServoConfig, progress: Progress, draw: DrawServo) -> ServoFit:
    """Fit the servo, write fish, report and figure. Raises BadInput as `tail` does."""
    described, (fit, validate) = benches_of(paths, config)
    found = servo_job.identify_servo(described, fit, validate, config, paths.scratch, progress)
    if config.cross_validate:
        left_out = servo_report.cross_validate(described, fit, config, paths.scratch, progress)
        found = replace(found, left_out=left_out)
    named = servo_report.toml_values(found, [bench.name for bench in fit])
    values = _reported(paths, named, servo_report.as_report(found), partial(draw, found))
    write_identified(paths.fish, paths.out, values, servo_report.heading(found))
    job.clear(paths.scratch)
    return found


def benches_of(paths: Paths, config: ServoConfig) -> tuple[Fish, list[list[Bench]]]:
    """The fish as it is fitted, and its servo's recordings to fit and to validate. Raises BadInput,
    also for what `servo` may not overwrite."""
    servo_search.check(config)
    _refuse_taken(paths)
    described = load_fish(paths.fish)
    refuse_shared({"--fit": paths.fit, "--validate": paths.validate})
    fit, validate = (
        [b for one in read_recordings(group) for b in as_benches(one, described, config.load)]
        for group in (paths.fit, paths.validate)
    )
    check_driven(fit)
    if config.cross_validate:
        servo_report.groups(fit)
    return described, [fit, validate]


def fluid(
    paths: Paths, config: job.FluidConfig, progress: Progress, draw: DrawFluid
) -> job.Identified:
    """Fit the fluid coefficients, write fish, report and figure. Raises BadInput as `tail` does."""
    described, (fit, validate, check) = swims_of(paths, config)
    found = job.identify_fluid(described, fit, validate, config, paths.scratch, progress, check)
    _write_fluid(paths, found, config, draw)
    job.clear(paths.scratch)
    return found


def swims_of(paths: Paths, config: job.FluidConfig) -> tuple[Fish, list[list[Run]]]:
    """The fish as it is fitted, and its swims to fit, to validate and to check on. A step that no
    user chose becomes the cheapest that repeats the swims. Raises BadInput, also for what `fluid`
    may not overwrite."""
    job.check(config)
    _refuse_taken(paths)
    refuse_existing(posterior.beside(paths.out))
    described = load_fish(paths.fish)
    if config.added_inertia is not None:
        described = with_values(described, {"added_inertia": config.added_inertia})
    if config.whole:
        described = whole(described)
    given = {"--fit": paths.fit, "--validate": paths.validate, "--check": paths.check}
    refuse_shared(given)
    groups = [
        [run for one in read_recordings(group) for run in as_runs(one, described)]
        for group in given.values()
    ]
    if groups[0] and step_check.is_ours(paths.fish):
        described = step_check.for_swims(described, groups[0], config.zones)
    return described, groups


def _write_fluid(
    paths: Paths, found: job.Identified, config: job.FluidConfig, draw: DrawFluid
) -> None:
    """Write fish, report and figure of identified coefficients."""
    fish, shown = (
        paths.out,
        [("fitted", found.fitted[0])] + [("held out", p) for p in found.validated[:1]],
    )
    named = fluid_report.toml_values(found, [p.run.name for p in found.fitted])
    if step_check.is_ours(paths.fish):
        named |= step_check.entries(found.fish.simulation)
    report = fluid_report.as_report(found, config)
    values = _reported(paths, named, report, partial(draw, shown), swum=True)
    note = fluid_report.heading(found, config)
    first = paths.scratch / fish.name  # the posterior needs its digest; the fish is written last
    write_identified(paths.fish, first, {"name": fish.stem, **values}, note, overwrite=True)
    known = posterior.drawn_for(
        load_fish(first), found.space, found.draws, [p.run for p in found.fitted], found.drawn
    )
    posterior.write(posterior.beside(fish), known)
    write_identified(paths.fish, fish, {"name": fish.stem, **values}, note)


def _reported(
    paths: Paths,
    values: Entries,
    report: dict[str, Any],
    draw: Callable[[Path], None],
    swum: bool = False,
) -> Entries:
    """Draw the figure and write the report, with the step that the fish holds; returns the values
    with that step. Numbers that were fitted on swims (`swum`) belong to their step, which stays if
    it holds. Raises BadInput, before anything is written, if no step holds."""
    step = _held(paths, values, not swum and step_check.is_ours(paths.fish))
    _, place, figure = paths.written
    draw(figure)
    warnings = [*report.get("warnings", []), *step.warnings]
    added = {"warnings": warnings, "step": step_check.as_row(step)}
    write_json(place, {**_source(paths), **report, **added})
    return {**values, **step_check.toml_values(step)}


def _held(paths: Paths, values: Entries, ours: bool) -> Held:
    """The step that the fish with these identified values holds (`ours` as in `step_check`). Raises
    BadInput for none."""
    trial = paths.scratch / "step.toml"
    write_identified(paths.fish, trial, values, "", overwrite=True)
    try:
        return step_check.held(load_fish(trial), ours)
    finally:
        trial.unlink()
        if not any(paths.scratch.iterdir()):
            paths.scratch.rmdir()


def _refuse_taken(paths: Paths) -> None:
    for path in paths.written:
        refuse_existing(path)
    check_fish_name(paths.out)


def _source(paths: Paths) -> dict[str, str]:
    return {"fish": str(fish_path(paths.fish))}
