"""What does a verb do? Reads what it needs, calls the floors below, writes what comes out."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import resources
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from tailbeat import importers
from tailbeat.benchmarks import step as benchmark
from tailbeat.evaluate import runs as swims_store
from tailbeat.files import BadInput, new_file, refuse_existing, write_json
from tailbeat.fish.render import save_picture
from tailbeat.fish.show import tables
from tailbeat.fish.store import (
    Done,
    check_fish_name,
    fish_path,
    load_fish,
    new_fish_files,
    with_values,
    write_identified,
)
from tailbeat.fish.twin import Options, compile_twin
from tailbeat.fish.water import whole
from tailbeat.identify import coverage as cover
from tailbeat.identify import job
from tailbeat.identify import kinematic as rival
from tailbeat.identify.predict import as_json
from tailbeat.identify.predict import predict as predict_runs
from tailbeat.identify.runs import Run, as_run
from tailbeat.identify.search import Effort
from tailbeat.recording import Recording, read_recording, write_recording
from tailbeat.report import figures
from tailbeat.report import open_loop as loop

Progress = Callable[[int, str, float, float], None]


@dataclass(frozen=True)
class Shown:
    """What `show` found: tables of rows, and the picture with how it was made."""

    tables: dict[str, list[dict[str, Any]]]
    picture: Path
    how: str


def new_fish(path: Path) -> None:
    """Write the commented template. Raises BadInput if `path` exists."""
    check_fish_name(path)
    text = (resources.files("tailbeat.fish") / "models" / "template.txt").read_text("utf-8")
    with new_file(path) as beside:
        beside.write_text(text.replace("my-fish", path.stem), encoding="utf-8")


def show(fish: str, picture: Path | None, viewer: bool, json: Path | None) -> Shown:
    """Compile a fish, read it back, draw it."""
    described = load_fish(fish)
    target = picture or Path("runs") / f"{described.name}.png"
    for path in filter(None, (picture, json)):
        refuse_existing(path)
    found = tables(described)
    twin = compile_twin(described, Options(looks=True))
    how = save_picture(twin, np.zeros(twin.model.nq), target, overwrite=picture is None)
    if json is not None:
        write_json(json, found)
    if viewer:
        from mujoco import viewer as mujoco_viewer  # needs a screen, so only when asked for

        mujoco_viewer.launch(twin.model)
    return Shown(found, target, how)


def import_fishsim(csv: Path, out: Path, frame_rate: float, json: Path | None) -> Recording:
    """Read a fishsim marker file, write a recording."""
    for path in filter(None, (out, json)):
        refuse_existing(path)
    if not frame_rate > 0:
        raise BadInput(f"--frame-rate {frame_rate:g}: give the film's frames per second, above 0.")
    recording = importers.import_fishsim(csv, frame_rate)
    write_recording(recording, out)
    if json is not None:
        write_json(json, {"recording": str(out), "frames": recording.time.size, **recording.meta})
    return recording


def plan(
    zones: int,
    seeds: int,
    seed: int,
    generations: int,
    start_weight: bool | None,
    added_inertia: float | None = None,
    whole: bool = False,
) -> job.Plan:
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
    return job.Plan(zones, seeds, seed, effort, start_weight, added_inertia, whole)


def identify_fluid(
    fish: str,
    fit: Sequence[Path],
    validate: Sequence[Path],
    out: Path,
    plan: job.Plan,
    json: Path | None,
    progress: Progress,
) -> Done:
    """Fit, then write fish, report and figure; nothing is written if anything fails."""
    files = new_fish_files(out, json)
    described = load_fish(fish)
    if plan.added_inertia is not None:
        described = with_values(described, {"added_inertia": plan.added_inertia})
    if plan.whole:
        described = whole(described)
    fitted, held_out = _runs(fit, described), _runs(validate, described)
    scratch = out.parent / f".{out.stem}.search"
    found = job.identify_fluid(described, fitted, held_out, plan, scratch, progress)
    report = write_identification(found, plan, fish, files)
    job.clear(scratch)
    return Done(report, files)


def write_identification(
    found: job.Identified, plan: job.Plan, fish: str, files: tuple[Path, Path, Path]
) -> dict[str, Any]:
    """Write fish, report and figure; returns the report."""
    out, json, figure = files
    names = [p.run.name for p in found.fitted]
    report = {"fish": str(fish_path(fish)), **job.as_report(found, plan)}
    rows = [("fitted", found.fitted[0])] + [("held out", p) for p in found.validated[:1]]
    figures.measured_against_twin(rows, figure)
    write_json(json, report)
    values: dict[str, Any] = {"name": out.stem, **job.toml_values(found, names)}
    write_identified(fish, out, values, job.heading(found, plan))
    return report


def _runs(paths: Sequence[Path], fish: Any) -> list[Run]:
    return [as_run(read_recording(path), fish) for path in paths]


def predict(
    fish: str, swims: Sequence[Path], fitted_on: Sequence[Path], json: Path | None
) -> dict[str, Any]:
    """Measured and predicted figures of recordings, logs or an evaluation's chunks; with
    `fitted_on`, those of the naive model fitted on these recordings too."""
    if json is not None:
        refuse_existing(json)
    described = load_fish(fish)
    runs = [as_run(recording, described) for path in swims for recording in _swims(path)]
    result = as_json(predict_runs(described, runs))
    if fitted_on:
        result |= rival.beside(result, runs, _runs(fitted_on, described))
    if json is not None:
        write_json(json, result)
    return result


def coverage(
    fish: str, swims: Sequence[Path], against: Sequence[Path], json: Path | None
) -> dict[str, Any]:
    """Compare swims, logs or an evaluation's chunks, with the recordings of an identification."""
    if json is not None:
        refuse_existing(json)
    described = load_fish(fish)
    played = [recording for path in swims for recording in _swims(path)]
    found = cover.coverage(played, [read_recording(path) for path in against], described)
    result = cover.as_json(found)
    if json is not None:
        write_json(json, result)
    return result


def _swims(path: Path) -> list[Recording]:
    """The swims of a file. Raises BadInput where an evaluation's chunk holds none long enough."""
    if path.suffix != ".npz":
        return [read_recording(path)]
    found = swims_store.as_recordings(swims_store.read_chunk(path), path.stem)
    if not found:
        raise BadInput(f"{path}: no swim of 1 s or more; give another chunk.")
    return found


def open_loop(fish: str, out: Path) -> dict[str, Any]:
    """Swim a fish without a policy; see `report/open_loop.py`."""
    return loop.open_loop(load_fish(fish), out)


def bench(env: bool = True) -> dict[str, Any]:
    """Speed on this machine; with `env`, of environment and updates, where the train extra is; of
    the camera's side where the robot extra is."""
    result = benchmark.bench()
    if find_spec("cv2") is not None and find_spec("pyapriltags") is not None:
        from tailbeat.benchmarks.vision import live_bench, vision_bench  # needs the extra

        result["vision"] = {"pictures": vision_bench(), "live": [live_bench()]}
    if env and find_spec("stable_baselines3") is not None:
        from tailbeat.benchmarks.environment import env_bench  # needs the extra
        from tailbeat.benchmarks.physics import physics_bench  # and so does the environment
        from tailbeat.benchmarks.update import update_bench

        result["physics"] = physics_bench()
        result["env"] = env_bench()
        result["update"] = update_bench()
    return result
