"""Identify a whole fish from a folder of recordings: tail, then servo, then fluid."""

import hashlib
import math
import shutil
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from json import loads as from_json
from pathlib import Path
from typing import Any

from tailbeat.files import BadInput, new_file, refuse_existing, write_json
from tailbeat.fish.store import check_fish_name, fish_path, load_fish
from tailbeat.identify import job, posterior, stages
from tailbeat.identify.protocol import EVERY, HELD_OUT_SERVO, present_name
from tailbeat.identify.servo_search import ServoConfig
from tailbeat.identify.stages import DrawFluid, DrawServo, DrawTail, Paths, Progress

Report = Callable[[int, int], None]  # searches done, all searches
SERVO_MORE = 2  # further searches for the servo, while none agrees with the recordings
SERVO_GENERATIONS = 10  # of the servo's search for each of the fluid's; 150 by default


@dataclass(frozen=True)
class Folder:
    """The recordings of one fish, sorted by use."""

    sweeps: list[Path]
    static: Path | None
    release: Path | None
    servo_fit: list[Path]
    servo_validate: list[Path]
    fluid_fit: list[Path]
    fluid_validate: list[Path]
    check: list[Path]


@dataclass(frozen=True)
class Drawings:
    """Functions that draw the figure of each stage. `page` returns the page's text from the report
    and the stem of the outputs' names."""

    tail: DrawTail
    servo: DrawServo
    fluid: DrawFluid
    page: Callable[[dict[str, Any], str], str]


def read_folder(folder: Path) -> Folder:
    """Sort a folder's recordings by their names. Raises BadInput if sweeps, servo recordings or
    swims are missing."""
    names = sorted([*folder.glob("*.csv"), *folder.glob("*.parquet")])
    found = {
        kind: [path for path in names if present_name(path.stem).startswith(kind)]
        for kind in ("tail-sweep", "tail-static", "tail-release", "servo-", "fluid-", "check-")
    }
    for kind in ("tail-sweep", "servo-", "fluid-"):
        if not found[kind]:
            raise BadInput(
                f"{folder}: no recording whose name begins with {kind}; add one, or make one with"
                f" `tailbeat record`. docs/how-to/record.md lists the names."
            )
    servo = found["servo-"]
    several = len(servo) > 2
    held = [p for p in servo if several and present_name(p.stem) in HELD_OUT_SERVO]
    swims = found["fluid-"]
    return Folder(
        found["tail-sweep"],
        next(iter(found["tail-static"]), None),
        next(iter(found["tail-release"]), None),
        [p for p in servo if p not in held],
        held,
        [p for i, p in enumerate(swims) if (i + 1) % EVERY],
        swims[EVERY - 1 :: EVERY],
        found["check-"],
    )


@dataclass(frozen=True)
class ChainPaths:
    """What `identify_all` reads and writes: a `fish` by its shipped name or file, the `folder` of
    its recordings, the fish to write, `out`, and its report, `json` (None: beside `out`)."""

    fish: str
    folder: Path
    out: Path
    json: Path | None = None


@dataclass(frozen=True)
class Ahead:
    """Searches elsewhere, each before its stage, which then finds the results."""

    servo: Callable[[Paths, ServoConfig, Report], None]
    fluid: Callable[[Paths, job.FluidConfig, Report], None]


@dataclass(frozen=True)
class Summary:
    """The main numbers: stiffness `k_eff` [N m/rad] and damping `c_eff` [N m s/rad] at the shaft.
    Mean absolute errors on held-out recordings, of the servo's angle [deg] and of the swims' speed
    [m/s] (None without any). Of each held-out swim: position error as a fraction of the path
    length, and heading error [deg] (None without a heading). `verdict` must be read first;
    `trusted` is false if one of the three fits should not be used."""

    k_eff: float
    c_eff: float
    servo_mae_deg: float | None
    speed_mae: float | None
    position_error_share: tuple[float, ...]
    heading_error_deg: tuple[float | None, ...]
    verdict: tuple[str, ...] = ()
    trusted: bool = True


def identify_all(
    paths: ChainPaths,
    config: job.FluidConfig,
    progress: Progress,
    drawings: Drawings,
    ahead: Ahead | None = None,
) -> Summary:
    """Identify tail, then servo, then fluid, and write fish, report, page and figures.

    Each stage starts from the result of the one before. Finished stages are kept beside `out` until
    all are finished, so the same call resumes an interrupted one. `ahead` searches for servo and
    fluid elsewhere. Raises BadInput for a missing or unusable recording, and if an output exists.
    """
    job.check(config)
    described = load_fish(paths.fish)
    targets = _targets(paths)
    data = read_folder(paths.folder)
    work = paths.out.parent / f".{paths.out.stem}.chain"
    keys = _keys(paths.fish, data, config)
    places = {name: work / f"{name}-{key}" / paths.out.name for name, key in keys.items()}
    _run_tail_and_servo(paths.fish, data, places, config, progress, drawings, ahead)
    if not _done(places["fluid"]):
        swims = Paths(
            str(places["servo"]), data.fluid_fit, places["fluid"], data.fluid_validate,
            check=data.check,
        )  # fmt: skip
        if ahead is not None:
            ahead.fluid(swims, config, _as_search(config, progress))
        stages.fluid(swims, config, progress, drawings.fluid)
    reports = {name: _read_json(path.with_suffix(".json")) for name, path in places.items()}
    found = _summary(reports)
    report = {"fish": described.name, "source": str(fish_path(paths.fish)), "stages": reports}
    report["summary"] = asdict(found)
    _publish(places, targets, report, drawings.page(report, paths.out.stem))
    shutil.rmtree(work, ignore_errors=True)
    return found


def _targets(paths: ChainPaths) -> dict[str, Path]:
    out, stem = paths.out, paths.out.with_suffix("")
    check_fish_name(out)
    targets = {
        "fish": out,
        "json": paths.json or out.with_suffix(".json"),
        "page": out.with_suffix(".md"),
        "posterior": posterior.beside(out),
    }
    targets |= {name: Path(f"{stem}-{name}.png") for name in ("tail", "servo", "fluid")}
    for path in targets.values():
        refuse_existing(path)
    return targets


def _keys(fish: str, data: Folder, config: job.FluidConfig) -> dict[str, str]:
    """Digest of every stage's inputs, by its name: a stage is resumed, or kept, for the same work
    alone. What only the swims' fit reads does not begin tail and servo anew."""
    singles = [path for path in (data.static, data.release) if path is not None]
    seeds = f"{config.seeds} {config.first_seed} {config.effort.generations}"
    inputs = {
        "tail": ("", [fish_path(fish), *data.sweeps, *singles]),
        "servo": (seeds, [*data.servo_fit, *data.servo_validate]),
        "fluid": (repr(config), [*data.fluid_fit, *data.fluid_validate, *data.check]),
    }
    digest, keys = hashlib.sha256(version("tailbeat").encode()), {}
    for name, (words, files) in inputs.items():  # each stage starts from the one before it
        digest.update(words.encode())
        for path in files:
            digest.update(path.read_bytes())
        keys[name] = digest.hexdigest()[:16]
    return keys


def _as_search(config: job.FluidConfig, progress: Progress) -> Report:
    """Tells of searches that are over as if the first seed's were so far."""
    return lambda done, of: progress(config.first_seed, "search", done / of, math.nan)


def _run_tail_and_servo(
    fish: str,
    data: Folder,
    places: dict[str, Path],
    config: job.FluidConfig,
    progress: Progress,
    drawings: Drawings,
    ahead: Ahead | None,
) -> None:
    """Each stage starts from the fish that the one before it wrote."""
    tail, servo = places["tail"], places["servo"]
    servo_config = _servo_config(config)
    if not _done(tail):
        sweeps = Paths(fish, data.sweeps, tail)
        stages.tail(sweeps, data.static, data.release, drawings.tail)
    if not _done(servo):
        commands = Paths(str(tail), data.servo_fit, servo, data.servo_validate)
        if ahead is not None:
            ahead.servo(commands, servo_config, _as_search(config, progress))
        stages.servo(commands, servo_config, progress, drawings.servo)


def _servo_config(config: job.FluidConfig) -> ServoConfig:
    """The servo is searched with the fluid's seeds, as thoroughly, and again if none agrees."""
    effort = ServoConfig().effort
    generations = SERVO_GENERATIONS * config.effort.generations
    effort = replace(effort, generations=generations)
    return ServoConfig(config.seeds, config.first_seed, effort, more=SERVO_MORE)


def _done(fish: Path) -> bool:
    """Whether a stage is finished: its fish is written last. Files of an unfinished one are
    removed."""
    if fish.is_file():
        return True
    for stale in (fish.with_suffix(".json"), fish.with_suffix(".png"), posterior.beside(fish)):
        stale.unlink(missing_ok=True)
    return False


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
    with new_file(targets["posterior"]) as beside:
        shutil.copyfile(posterior.beside(places["fluid"]), beside)
    with new_file(targets["fish"]) as beside:
        shutil.copyfile(places["fluid"], beside)


def _summary(reports: dict[str, Any]) -> Summary:
    held_out = reports["fluid"]["validate"]
    return Summary(
        reports["tail"]["k_eff"]["value"],
        reports["tail"]["c_eff"]["value"],
        reports["servo"]["validate_mae_deg"],
        reports["fluid"]["validate_speed_mae"],
        tuple(run["position_error_share"] for run in held_out),
        tuple(run["heading_error_deg"] for run in held_out),
        tuple(f"{name}: {said}" for name, one in reports.items() for said in one["verdict"]),
        all(one["trusted"] for one in reports.values()),
    )
