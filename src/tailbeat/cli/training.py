"""Train policies."""

from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from tailbeat.cli import output, progress, results
from tailbeat.cli.extras import need_training
from tailbeat.cli.learn import SeenImu, expect_or_say, source
from tailbeat.cli.options import FishOption, JsonOption, SeedOption
from tailbeat.files import check_json, put_json

PhysicsOption = Annotated[
    Literal["ranges", "posterior"],
    typer.Option(
        help="Coefficients of the water. ranges: within 20 % of the fish's; posterior: from the"
        " draws beside the fish."
    ),
]

BindsOption = Annotated[
    str | None,
    typer.Option(
        help="What the frequency ceiling limits: fundamental or signal; default: the recipe's."
    ),
]

TrainedServo = Annotated[
    str | None, typer.Option(help="Servo of the fish to train with; default: its own.")
]
FloorOption = Annotated[
    float, typer.Option(help="Lowest fundamental of the generator [Hz]; with 0 it can stop.")
]
CentreOption = Annotated[
    float | None,
    typer.Option(help="Largest centre of the generator [rad]; default: 1.2 of a range of ±80°."),
]
TrainedMess = Annotated[
    str,
    typer.Option(
        help="What robots get wrong in training, up to a level's sizes: clean, everyday, rough,"
        " wrecked, or a TOML file with a table [lab]."
    ),
]

TrainedBuild = Annotated[
    str,
    typer.Option(
        help="How wrong fish are built in training, up to a level's sizes if these are above the"
        " usual ranges: clean, everyday, rough, wrecked, or a TOML file with a table [lab]."
    ),
]

TrainedHard = Annotated[
    str,
    typer.Option(
        help="After the last stage, a polish of ten times the length with robots that are worse, up"
        " to a level's sizes: clean (none), everyday, rough, wrecked, or a TOML file with a table"
        " [lab]."
    ),
]

SeesVelocities = Annotated[
    bool,
    typer.Option(help="The policy also observes filtered velocities, its own and the target's."),
]

SeesAverages = Annotated[
    bool,
    typer.Option(
        help="The policy also observes averages of its own signals over seconds, and velocities."
    ),
]

Normalised = Annotated[
    bool | None,
    typer.Option(
        help="Critics with normalised layers and no targets, which need fewer updates; default:"
        " the recipe's."
    ),
]

TrainedActions = Annotated[
    str | None,
    typer.Option(help="generator, direct or filtered; of a crank turning. Default: the first."),
]

HorizonOption = Annotated[
    float | None,
    typer.Option(
        help="How far the policy looks ahead in training [s], 1 to 60: rewards that much later"
        " count 1/e. Default: the recipe's."
    ),
]

StartOption = Annotated[
    Path | None,
    typer.Option(
        help="Folder of a run with whose networks to begin, in the last stage: for a newer"
        " identification of its fish."
    ),
]

ContinuedStage = Annotated[
    str | None, typer.Option(help="Stage to continue in; default: the checkpoint's.")
]


def train(
    fish: FishOption,
    out: Annotated[Path, typer.Option("--out", help="Folder of the run.")],
    actions: TrainedActions = None,
    recipe: Annotated[str, typer.Option(help="Recipe: quick, paper or smoke.")] = "quick",
    task: Annotated[
        str, typer.Option(help="reach: targets that stay; follow: those that move, too.")
    ] = "reach",
    seed: SeedOption = 0,
    hours: Annotated[
        float, typer.Option(help="Longest training time [h]; continue later with --resume.")
    ] = 12.0,
    resume: Annotated[bool, typer.Option(help="Continue from the checkpoint in --out.")] = False,
    device: Annotated[str, typer.Option(help="Device of the updates: cpu or cuda.")] = "cpu",
    servo: TrainedServo = None,
    binds: BindsOption = None,
    floor: FloorOption = 0.0,
    centre: CentreOption = None,
    physics: PhysicsOption = "ranges",
    imu: SeenImu = None,
    mess: TrainedMess = "clean",
    build: TrainedBuild = "clean",
    hard: TrainedHard = "clean",
    velocities: SeesVelocities = False,
    averages: SeesAverages = False,
    normalised: Normalised = None,
    horizon: HorizonOption = None,
    start: StartOption = None,
    stage: ContinuedStage = None,
    json: JsonOption = None,
) -> None:
    """Train a policy through the stages of a recipe. Exit code 1 if it did not pass them all."""
    check_json(json)
    need_training()
    from tailbeat.fish.store import load_fish, with_servo
    from tailbeat.pool.mess import for_training
    from tailbeat.report.learning_figures import courses
    from tailbeat.train.config import RunConfig
    from tailbeat.train.recipes import recipe_of
    from tailbeat.train.spaces import action_space
    from tailbeat.train.train import result
    from tailbeat.train.train import train as learn

    with progress.training() as report:
        described, chosen = with_servo(load_fish(fish), servo), recipe_of(recipe, task, horizon)
        chosen = chosen if normalised is None else replace(chosen, normalised=normalised)
        space = action_space(actions, described, binds or chosen.binds, floor, centre)
        run = RunConfig(described, out, chosen, space, seed, hours, device, velocities=velocities)
        run = replace(run, draws=_draws(fish, physics), yaw_rate=source(imu) or "imu")
        wrong, drawn, worse = for_training(mess, build, hard)
        run = replace(run, errors=wrong, build=drawn, hard=worse, averages=averages, start=start)
        output.say(f"replay buffer: {run.buffer_bytes / 1e6:.0f} MB, in every checkpoint too")
        course = learn(run, resume, report, stage)
    courses({f"{space.kind}, seed {seed}": course.history}, out / "curve.png")
    results.trained(done := result(run, course))
    if done.finished and space.kind != "turning":
        expect_or_say(str(done.policy), recipe)
    put_json(json, asdict(done) | {"folder": str(done.folder), "policy": str(done.policy)})
    if not done.finished:
        raise typer.Exit(1)


def _draws(fish: str, physics: str) -> Any:
    if physics != "posterior":
        return None
    from tailbeat.identify.posterior import factors_of

    return factors_of(fish)
