"""What can I do? The verbs of `tailbeat`: parse, call, print. No logic."""

import sys
from pathlib import Path
from typing import Annotated, Literal

import typer

from tailbeat import (
    bench_tasks,
    chain_tasks,
    console,
    laptop_cli,
    learn_cli,
    robot_cli,
    safety_cli,
    swim_cli,
    tasks,
    track_cli,
)
from tailbeat.files import BadInput, write_json

app = typer.Typer(
    name="tailbeat",
    help="From bench recordings of a soft robotic fish to a twin that swims like it.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
identify = typer.Typer(help="Find a fish's parameters from recordings.", no_args_is_help=True)
importing = typer.Typer(help="Turn other people's files into recordings.", no_args_is_help=True)
app.add_typer(identify, name="identify")
app.add_typer(importing, name="import")
app.add_typer(learn_cli.policy, name="policy")
app.command("train")(learn_cli.train)
for verb in (
    swim_cli.swim,
    swim_cli.evaluate,
    swim_cli.compare,
    swim_cli.report,
    robot_cli.key,
    robot_cli.rig,
    robot_cli.drive,
    robot_cli.export,
    track_cli.tags,
    track_cli.calibrate,
    track_cli.track,
    track_cli.camera,
    laptop_cli.laptop,
    safety_cli.faults,
    safety_cli.pace,
    safety_cli.let_go,
    safety_cli.doctor,
    safety_cli.unit,
):
    app.command(verb.__name__.replace("_", "-"))(verb)

# options that take any number of values; a servo's port, elsewhere, is one
LISTS = {"--fit": "identify", "--validate": "identify", "--commands": "record"}
LISTS |= {"--servo": "flutter", "--tasks": "evaluate", "--only": "faults"}
LISTS |= {"--against": "coverage", "--fitted-on": "predict"}
FishOption = Annotated[str, typer.Option("--fish", help="A TOML file or a shipped fish's name.")]
JsonOption = Annotated[Path | None, typer.Option("--json", help="Write the result here as JSON.")]
SeedOption = Annotated[int, typer.Option("--seed", help="Seed of everything random.")]
OutFish = Annotated[Path, typer.Option("--out", help="The identified fish to write.")]
AddedOption = Annotated[
    float | None,
    typer.Option(help="Share of the described added mass that is inertia; default: as described."),
]
LawOption = Annotated[
    Literal["described", "whole"],
    typer.Option(
        "--law",
        help="whole: added mass across the parts, lift with a trailing edge (docs/twin.md).",
    ),
]
Recordings = Annotated[list[Path], typer.Argument(help="Recordings, CSV or Parquet.")]


@app.command("new-fish")
def new_fish(path: Annotated[Path, typer.Argument(help="The TOML file to write.")]) -> None:
    """Write a commented fish to start from."""
    tasks.new_fish(path)
    console.say(f"wrote {path}; see what it makes with: tailbeat show {path}")


@app.command()
def show(
    fish: Annotated[str, typer.Argument(help="A TOML file or a shipped fish's name.")],
    picture: Annotated[Path | None, typer.Option(help="Where the PNG goes.")] = None,
    viewer: Annotated[bool, typer.Option(help="Open MuJoCo's viewer.")] = False,
    json: JsonOption = None,
) -> None:
    """Print what was compiled, and render a picture."""
    shown = tasks.show(fish, picture, viewer, json)
    console.tables(shown.tables)
    console.say(f"picture ({shown.how}): {shown.picture}")


@importing.command("fishsim")
def import_fishsim(
    csv: Annotated[Path, typer.Argument(help="A marker file of srl-ethz/fishsim.")],
    out: Annotated[Path, typer.Option("--out", help="The recording to write, .csv or .parquet.")],
    frame_rate: Annotated[float, typer.Option(help="Frames per second of the film.")] = 60.0,
    json: JsonOption = None,
) -> None:
    """Marker tracks in pixels to a recording in metres."""
    recording = tasks.import_fishsim(csv, out, frame_rate, json)
    dropped = recording.meta["frames_dropped_per_marker"]
    console.say(f"wrote {out}: {recording.time.size} frames, dropped per marker {dropped}")


@identify.command("fluid")
def identify_fluid(
    fish: FishOption,
    fit: Annotated[list[Path], typer.Option("--fit", help="Recordings to fit; repeat.")],
    out: OutFish,
    validate: Annotated[
        list[Path] | None, typer.Option("--validate", help="Recordings held out; repeat.")
    ] = None,
    zones: Annotated[int, typer.Option(help="1: one coefficient set; 3: one per zone.")] = 3,
    seeds: Annotated[int, typer.Option(help="Independent searches, the best one kept.")] = 5,
    seed: SeedOption = 0,
    generations: Annotated[int, typer.Option(help="CMA-ES generations per seed.")] = 15,
    start_weight: Annotated[
        bool | None,
        typer.Option(help="Weigh a run's start 4:1; default: when it starts from rest."),
    ] = None,
    added_inertia: AddedOption = None,
    law: LawOption = "described",
    json: JsonOption = None,
) -> None:
    """Fit the fluid coefficients; writes fish, report (.json) and figure (.png) side by side."""
    with console.search_progress() as progress:
        plan = tasks.plan(
            zones, seeds, seed, generations, start_weight, added_inertia, law == "whole"
        )
        done = tasks.identify_fluid(fish, fit, validate or [], out, plan, json, progress)
    console.identified(done.report)
    console.say(f"wrote {', '.join(map(str, done.files))}")


@identify.command("tail")
def identify_tail(
    fish: FishOption,
    sweeps: Annotated[list[Path], typer.Argument(help="Driven sweeps, CSV or Parquet.")],
    out: OutFish,
    static: Annotated[Path | None, typer.Option(help="A slow pull: the loop it makes.")] = None,
    ring_down: Annotated[Path | None, typer.Option(help="A released tail.")] = None,
    json: JsonOption = None,
) -> None:
    """Stiffness and damping from driven sweeps with shaft torque, spread over the hinges."""
    done = bench_tasks.identify_tail(fish, sweeps, static, ring_down, out, json)
    console.tail(done.report)
    console.say(f"wrote {', '.join(map(str, done.files))}")


@identify.command("motor")
def identify_motor(
    fish: FishOption,
    fit: Annotated[list[Path], typer.Option("--fit", help="Recordings to fit; repeat.")],
    out: OutFish,
    validate: Annotated[
        list[Path] | None, typer.Option("--validate", help="Recordings held out; repeat.")
    ] = None,
    load: Annotated[
        str | None, typer.Option(help="tail, pendulum or nothing; default: as recorded, else tail.")
    ] = None,
    gain: Annotated[
        float | None, typer.Option(help="Gain register the fish will run with; default: middle.")
    ] = None,
    gears: Annotated[bool, typer.Option(help="Fit the gears' load-dependent friction.")] = True,
    cross_validate: Annotated[bool, typer.Option(help="Also leave out each gain in turn.")] = False,
    seeds: Annotated[int, typer.Option(help="Independent searches, the best one kept.")] = 5,
    seed: SeedOption = 0,
    json: JsonOption = None,
) -> None:
    """Servo from recorded commands and encoder angles, free-running against a known load."""
    plan = bench_tasks.motor_plan(seeds, seed, gears, gain)
    with console.search_progress() as progress:
        done = bench_tasks.identify_motor(
            fish, fit, validate or [], out, load, plan, cross_validate, json, progress
        )
    console.motor(done.report)
    console.say(f"wrote {', '.join(map(str, done.files))}")


@identify.command("all")
def identify_all(
    fish: FishOption,
    folder: Annotated[Path, typer.Option("--from", help="Folder with all recordings.")],
    out: OutFish,
    zones: Annotated[int, typer.Option(help="1: one coefficient set; 3: one per zone.")] = 3,
    seeds: Annotated[int, typer.Option(help="Independent searches per stage.")] = 3,
    seed: SeedOption = 0,
    generations: Annotated[int, typer.Option(help="CMA-ES generations of the fluid.")] = 15,
    added_inertia: AddedOption = None,
    law: LawOption = "described",
    json: JsonOption = None,
) -> None:
    """Tail, then servo, then fluid from one folder; writes fish, report, page and figures."""
    plan = tasks.plan(zones, seeds, seed, generations, None, added_inertia, law == "whole")
    with console.search_progress() as progress:
        report = chain_tasks.identify_all(fish, folder, out, plan, json, progress)
    console.tables({"summary": [report["summary"]]})
    console.say(f"wrote {out} and, beside it, {out.with_suffix('.md').name}")


@importing.command("xl330")
def import_xl330(
    log: Annotated[Path, typer.Argument(help="A pendulum log of Rhoban/bam, JSON.")],
    out: Annotated[Path, typer.Option("--out", help="The recording to write, .csv or .parquet.")],
    json: JsonOption = None,
) -> None:
    """A servo's pendulum log to a recording; gain and load go into its metadata."""
    recording = bench_tasks.import_xl330(log, out, json)
    gain = recording.meta["gain"]
    console.say(f"wrote {out}: {recording.time.size} samples at gain {gain}")


@app.command("protocol")
def protocol(
    kind: Annotated[str, typer.Argument(help="tail, motor or fluid.")],
    fish: FishOption,
    out: Annotated[Path, typer.Option("--out", help="Folder for the command recordings.")],
    speed: Annotated[float, typer.Option(help="Shaft speed never asked beyond, rad/s.")] = 4.0,
    json: JsonOption = None,
) -> None:
    """Write the commands that a bench should play; docs/bench.md says how to record them."""
    paths = bench_tasks.write_protocol(kind, fish, out, speed)
    if json is not None:
        write_json(json, {"recordings": [str(path) for path in paths]})
    for path in paths:
        console.say(f"wrote {path}")


@app.command("record")
def record(
    kind: Annotated[str, typer.Argument(help="tail, motor or fluid.")],
    fish: FishOption,
    out: Annotated[Path, typer.Option("--out", help="Folder for the recordings.")],
    commands: Annotated[
        list[Path] | None, typer.Option("--commands", help="Play these; default: the protocol's.")
    ] = None,
    seed: SeedOption = 0,
    json: JsonOption = None,
) -> None:
    """Play a bench's protocol in the virtual pool and record it as a lab would."""
    paths = chain_tasks.record(kind, fish, out, seed, commands or ())
    if json is not None:
        write_json(json, {"recordings": [str(path) for path in paths]})
    for path in paths:
        console.say(f"wrote {path}")


@app.command("flutter")
def flutter(
    fish: FishOption,
    out: Annotated[Path, typer.Option("--out", help="The figure to write, .png.")],
    servo: Annotated[list[str] | None, typer.Option(help="Servo variants; repeat.")] = None,
    json: JsonOption = None,
) -> None:
    """Speed of twin and virtual pool over frequency and stroke, in and far beyond the band."""
    report = chain_tasks.flutter(fish, servo, out, json)
    console.tables({f"speed [m/s], water {report['water']}": report["rows"]})


@app.command()
def predict(
    fish: FishOption,
    recordings: Annotated[
        list[Path], typer.Argument(help="Recordings or logs, CSV or Parquet, or OUT/runs/*.npz.")
    ],
    fitted_on: Annotated[
        list[Path] | None,
        typer.Option("--fitted-on", help="Fit a naive model of five numbers on these; repeat."),
    ] = None,
    json: JsonOption = None,
) -> None:
    """Predict recorded swims with the twin, beside what was measured; exit code 1 if the twin
    diverged or reached no steady speed. With --fitted-on, compare it with a naive model."""
    result = tasks.predict(fish, recordings, fitted_on or [], json)
    console.predicted(result)
    if not all(run["settled"] for run in result["runs"]):
        raise typer.Exit(1)


@app.command()
def coverage(
    swims: Annotated[
        list[Path],
        typer.Argument(help="A policy's swims: logs as CSV or Parquet, or OUT/runs/*.npz."),
    ],
    against: Annotated[
        list[Path], typer.Option("--against", help="Recordings the fish was identified on; repeat.")
    ],
    fish: FishOption,
    json: JsonOption = None,
) -> None:
    """Check whether an identification's recordings cover a policy's swims, and say what to record
    next; exit code 1 if over 5 % of some quantity lies outside the recorded range."""
    result = tasks.coverage(fish, swims, against, json)
    console.covered(result)
    if not result["covered"]:
        raise typer.Exit(1)


@app.command()
def bench(
    env: Annotated[bool, typer.Option(help="Also environment and updates, against SB3's.")] = True,
    json: JsonOption = None,
) -> None:
    """Measure the step against a bare engine loop on this machine, pool and environment too."""
    result = tasks.bench(env)
    console.tables({result["machine"]: result["fish"], "virtual pool": result["pool"]})
    rows = [{"fish": int(count), **row} for count, row in result.get("env", {}).items()]
    vision = result.get("vision", {"pictures": [], "live": []})
    costs = ("draw_ms", "whole_ms", "window_ms", "poses_per_s_core")
    console.tables({
        "camera: errors of poses": [
            {name: value for name, value in row.items() if name not in costs}
            for row in vision["pictures"]
        ],
        "camera: CPU time": [
            {name: row[name] for name in ("pictures", *costs)} for row in vision["pictures"]
        ],
        "camera and tracker as processes": vision["live"],
    })  # fmt: skip
    common = ("fish", "steps_per_s", "bare_engine", "of_bare_engine")
    peers = ("dummy_vec_env", "subproc_vec_env", "of_sb3")
    console.tables({
        "physics: a control step": result.get("physics", []),
        "environment": [{name: row[name] for name in common} for row in rows],
        "against SB3": [{n: row[n] for n in ("fish", *peers)} for row in rows if "of_sb3" in row],
        "an update of the training": result.get("update", []),
    })  # fmt: skip
    if json is not None:
        write_json(json, result)


def spread_lists(arguments: list[str]) -> list[str]:
    """`--fit A B` as `--fit A --fit B`, the only way the parser takes lists."""
    spread: list[str] = []
    option = None
    for word in arguments:
        if word.startswith("-"):
            option = word if LISTS.get(word) == arguments[0] else None
        elif option is not None and spread[-1] != option:
            spread.append(option)
        spread.append(word)
    return spread


def main() -> None:
    """Entry point: bad input is one sentence and exit code 2."""
    try:
        app(args=spread_lists(sys.argv[1:]), standalone_mode=True)
    except BadInput as error:
        console.complain(str(error))
        sys.exit(2)
    except KeyboardInterrupt:
        resumes = sys.argv[1:2] == ["identify"]
        again = "; the same command takes the search up where it stopped." if resumes else "."
        console.complain(f"interrupted{again}")
        sys.exit(130)
