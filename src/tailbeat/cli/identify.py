"""Identify a fish: tail, servo and water."""

from collections.abc import Mapping
from dataclasses import asdict, replace
from functools import partial
from json import loads
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from tailbeat.cli import identified, output, progress
from tailbeat.cli.options import AddedOption, AddressOption, FishOption, JsonOption, SeedOption
from tailbeat.files import check_json, need, put_json

if TYPE_CHECKING:
    from tailbeat.identify.chain import Ahead
    from tailbeat.identify.stages import Paths

OutFish = Annotated[Path, typer.Option("--out", help="Fish to write, .toml.")]
LawOption = Annotated[
    Literal["described", "whole"],
    typer.Option(
        "--law",
        help="Fluid law. described: the fish's own; whole: less added mass along the parts, and"
        " lift with a trailing edge.",
    ),
]
IterationsOption = Annotated[
    int, typer.Option(help="Most least-squares iterations after the search of the fluid.")
]
DrawsOption = Annotated[int, typer.Option(help="Number of draws of the posterior.")]


def _on_cluster(address: str) -> "Ahead":
    """Searches on the cluster of this address, to which this connects. Raises BadInput."""
    need("a cluster", "ray")
    from tailbeat.cluster import connection, identification
    from tailbeat.identify.chain import Ahead

    connection.connect(address)
    return Ahead(
        partial(identification.servo_ahead, address), partial(identification.fluid_ahead, address)
    )


def _exit_untrusted(report: Mapping[str, Any]) -> None:
    if not report["trusted"]:
        raise typer.Exit(1)


def identify_fluid(
    fish: FishOption,
    fit: Annotated[list[Path], typer.Option("--fit", help="Recordings to fit.")],
    out: OutFish,
    validate: Annotated[
        list[Path] | None, typer.Option("--validate", help="Recordings to test on; not fitted.")
    ] = None,
    check: Annotated[
        list[Path] | None,
        typer.Option(
            help="Swims unlike the fitted ones, from which the width of predictions comes."
        ),
    ] = None,
    zones: Annotated[int, typer.Option(help="1: one set of coefficients; 3: one per zone.")] = 3,
    seeds: Annotated[
        int, typer.Option(help="Number of independent searches; the best is kept.")
    ] = 5,
    seed: SeedOption = 0,
    generations: Annotated[int, typer.Option(help="CMA-ES generations of each search.")] = 15,
    iterations: IterationsOption = 30,
    start_weight: Annotated[
        bool | None,
        typer.Option(help="Weight the start of a run 4:1; default: if it starts from rest."),
    ] = None,
    added_inertia: AddedOption = None,
    law: LawOption = "described",
    draws: DrawsOption = 100,
    address: AddressOption = None,
    json: JsonOption = None,
) -> None:
    """Fit the fluid coefficients to recorded swims. Writes the fish and, beside it, a report
    (.json), a figure (.png) and the posterior (.parquet). The same command resumes an interrupted
    search."""
    from tailbeat.identify import job, stages
    from tailbeat.identify.posterior import beside
    from tailbeat.identify.search import Effort
    from tailbeat.report.figures import measured_against_twin

    effort, whole = Effort(generations=generations, polish=iterations), law == "whole"
    config = job.FluidConfig(zones, seeds, seed, effort, start_weight, added_inertia, whole, draws)
    paths = stages.Paths(fish, fit, out, validate or [], json, check or [])
    if address is not None:
        ahead = _on_cluster(address)
        with progress.counting() as count:
            ahead.fluid(paths, config, partial(count, "searches"))
    with progress.search_progress() as report:
        stages.fluid(paths, config, report, measured_against_twin)
    said = _report(paths)
    identified.identified(said)
    written = *paths.written, beside(out)
    output.say(f"wrote {', '.join(map(str, written))}")
    _exit_untrusted(said)


def identify_posterior(
    fish: FishOption,
    fit: Annotated[list[Path], typer.Option("--fit", help="Recordings it was fitted to.")],
    check: Annotated[
        list[Path] | None,
        typer.Option(help="Swims unlike those, from which the width of predictions comes."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", help="File to write, .parquet; default: beside the fish."),
    ] = None,
    zones: Annotated[int, typer.Option(help="As the fish was fitted with: 1 or 3.")] = 3,
    seed: SeedOption = 0,
) -> None:
    """Write the posterior of a fish that is identified already. Nothing is fitted. Use it when you
    have new swims to check the fish on."""
    from tailbeat.identify import posterior, posterior_job
    from tailbeat.identify.job import FluidConfig

    config = FluidConfig(zones, first_seed=seed)
    path = posterior_job.write_posterior(fish, fit, check or [], out, config)
    known = posterior.read(path)
    output.tables({"identified numbers": identified.parameters(posterior.as_rows(known))})
    output.say(f"wrote {path}")


def identify_next(
    fish: FishOption,
    goal: Annotated[
        str, typer.Option(help="Prediction to improve: speed, turning or reach.")
    ] = "turning",
    count: Annotated[int, typer.Option(help="Number of recordings to choose.")] = 3,
    json: JsonOption = None,
) -> None:
    """Rank the recordings that could be made next by what a prediction would gain.
    They are swims, servo commands and conditions of the tail. Needs the fish's posterior. Each is
    chosen by its gain per minute, given those above it."""
    from tailbeat.identify import next_recording

    check_json(json)
    found = next_recording.advise_on(fish, goal, count)
    rows = [{**asdict(one), "gain_per_minute": one.gain_per_minute} for one in found]
    output.tables({f"for {goal}": identified.advice(rows)})
    put_json(json, {"goal": goal, "recordings": rows})


def identify_tail(
    fish: FishOption,
    sweeps: Annotated[
        list[Path], typer.Argument(help="Recordings of driven sweeps, .csv or .parquet.")
    ],
    out: OutFish,
    static: Annotated[Path | None, typer.Option(help="Recording of a slow pull.")] = None,
    ring_down: Annotated[Path | None, typer.Option(help="Recording of a released tail.")] = None,
    json: JsonOption = None,
) -> None:
    """Fit the tail's stiffness and damping to driven sweeps with shaft torque. Both are distributed
    over the hinges."""
    from tailbeat.identify import stages
    from tailbeat.report import bench_figures

    paths = stages.Paths(fish, sweeps, out, json=json)
    stages.tail(paths, static, ring_down, bench_figures.tail)
    said = _report(paths)
    identified.tail(said)
    output.say(f"wrote {', '.join(map(str, paths.written))}")
    _exit_untrusted(said)


def identify_servo(
    fish: FishOption,
    fit: Annotated[list[Path], typer.Option("--fit", help="Recordings to fit.")],
    out: OutFish,
    validate: Annotated[
        list[Path] | None, typer.Option("--validate", help="Recordings to test on; not fitted.")
    ] = None,
    load: Annotated[
        str | None,
        typer.Option(help="Load: tail, pendulum or nothing; default: as recorded, else tail."),
    ] = None,
    gain: Annotated[
        float | None,
        typer.Option(help="Gain register that the fish will run with; default: the middle one."),
    ] = None,
    gears: Annotated[bool, typer.Option(help="Fit the gears' load-dependent friction.")] = True,
    cross_validate: Annotated[
        bool, typer.Option(help="Also fit with each gain left out in turn.")
    ] = False,
    datasheet: Annotated[
        str | None,
        typer.Option(
            help="Stall torque [N m] and no-load speed [rev/min] at the recordings' supply, as"
            " 4.9,75, or a servo of the catalogue with that supply [V], as xl330@7.4; for what"
            " slow recordings leave open."
        ),
    ] = None,
    seeds: Annotated[
        int, typer.Option(help="Number of independent searches; the best is kept.")
    ] = 5,
    seed: SeedOption = 0,
    generations: Annotated[int, typer.Option(help="CMA-ES generations of each search.")] = 150,
    address: AddressOption = None,
    json: JsonOption = None,
) -> None:
    """Fit the servo to recorded commands and encoder angles. The load on the shaft is known."""
    from tailbeat.identify import servo_search, stages
    from tailbeat.identify.datasheet import datasheet as read_datasheet
    from tailbeat.report import bench_figures

    effort = replace(servo_search.ServoConfig().effort, generations=generations)
    sheet = None if datasheet is None else read_datasheet(datasheet)
    config = servo_search.ServoConfig(
        seeds, seed, effort, gears, gain, load, cross_validate, datasheet=sheet
    )
    paths = stages.Paths(fish, fit, out, validate or [], json)
    if address is not None:
        ahead = _on_cluster(address)
        with progress.counting() as count:
            ahead.servo(paths, config, partial(count, "searches"))
    with progress.search_progress() as report:
        stages.servo(paths, config, report, bench_figures.servo_fit)
    said = _report(paths)
    identified.servo(said)
    output.say(f"wrote {', '.join(map(str, paths.written))}")
    _exit_untrusted(said)


def identify_all(
    fish: FishOption,
    folder: Annotated[
        Path,
        typer.Option("--from", help="Folder of all recordings, as `tailbeat record` names them."),
    ],
    out: OutFish,
    zones: Annotated[int, typer.Option(help="1: one set of coefficients; 3: one per zone.")] = 3,
    seeds: Annotated[int, typer.Option(help="Number of independent searches per stage.")] = 1,
    seed: SeedOption = 0,
    generations: Annotated[
        int, typer.Option(help="CMA-ES generations of the fluid; ten times as many of the servo.")
    ] = 15,
    iterations: IterationsOption = 30,
    added_inertia: AddedOption = None,
    law: LawOption = "described",
    draws: DrawsOption = 100,
    address: AddressOption = None,
    json: JsonOption = None,
) -> None:
    """Fit tail, servo and fluid to the recordings of one folder. Writes fish, report, page and
    figures; the same command resumes an interrupted search. With --address, a cluster searches for
    servo and fluid."""
    from tailbeat.identify import chain, job
    from tailbeat.identify.search import Effort
    from tailbeat.report.identified import DRAWINGS

    effort, whole = Effort(generations=generations, polish=iterations), law == "whole"
    config = job.FluidConfig(zones, seeds, seed, effort, None, added_inertia, whole, draws)
    paths = chain.ChainPaths(fish, folder, out, json)
    ahead = None if address is None else _on_cluster(address)
    with progress.search_progress() as report:
        found = chain.identify_all(paths, config, report, DRAWINGS, ahead)
    identified.first(found.verdict)
    said = loads((json or out.with_suffix(".json")).read_text("utf-8"))
    identified.whole(said)
    output.say(
        f"wrote {out} and, beside it, page, report, posterior and three figures: {out.stem}*"
    )
    _exit_untrusted(asdict(found))


def _report(paths: "Paths") -> Any:
    """The report that an identification wrote."""
    return loads(paths.written[1].read_text("utf-8"))
