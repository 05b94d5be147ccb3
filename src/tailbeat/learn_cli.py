"""The learning verbs: `train`, `policy show`, `policy diff`, `policy try`. Parse, call, print."""

from pathlib import Path
from typing import Annotated

import typer

from tailbeat import console, learn_tasks
from tailbeat.files import refuse_existing, write_json

policy = typer.Typer(help="Look at policies, compare and try them.", no_args_is_help=True)
PolicyFile = Annotated[str, typer.Argument(help="A policy, .onnx, or a shipped one's name.")]
JsonOption = Annotated[Path | None, typer.Option("--json", help="Write the result here as JSON.")]
FishOption = Annotated[str, typer.Option("--fish", help="A TOML file or a shipped fish's name.")]
SeedOption = Annotated[int, typer.Option("--seed", help="Seed of everything random.")]


def train(
    fish: FishOption,
    out: Annotated[Path, typer.Option("--out", help="Folder of the run.")],
    actions: Annotated[str, typer.Option(help="generator, direct or filtered.")] = "generator",
    recipe: Annotated[str, typer.Option(help="quick, paper or smoke.")] = "quick",
    seed: SeedOption = 0,
    hours: Annotated[float, typer.Option(help="End after this long, resumably.")] = 12.0,
    resume: Annotated[bool, typer.Option(help="Go on from the folder's checkpoint.")] = False,
    device: Annotated[str, typer.Option(help="cpu, or cuda for the updates.")] = "cpu",
    servo: Annotated[str | None, typer.Option(help="Another of the fish's servos.")] = None,
    binds: Annotated[
        str | None,
        typer.Option(help="What the generator's ceiling binds: fundamental (paper) or signal."),
    ] = None,
    floor: Annotated[
        float, typer.Option(help="Lowest fundamental of the generator, in Hz; 0 lets it stop.")
    ] = 0.0,
    stage: Annotated[str | None, typer.Option(help="Go on in this stage, by hand.")] = None,
    json: JsonOption = None,
) -> None:
    """Train a policy through the stages; exit code 1 if it did not pass them all."""
    if json is not None:
        refuse_existing(json)
    with console.training() as report:
        done = learn_tasks.train(
            fish,
            out,
            actions,
            recipe,
            seed,
            hours,
            resume,
            device,
            servo,
            binds,
            floor,
            stage,
            report,
            console.say,
        )
    console.trained(done)
    if json is not None:
        write_json(json, done)
    if not done["finished"]:
        raise typer.Exit(1)


@policy.command("show")
def show(file: PolicyFile, json: JsonOption = None) -> None:
    """Print a policy's contract; its golden pairs are checked on the way."""
    contract = learn_tasks.show_policy(file)
    console.contract(contract)
    if json is not None:
        write_json(json, contract)


@policy.command("diff")
def diff(
    first: PolicyFile,
    second: Annotated[str, typer.Argument(help="Another.")],
    json: JsonOption = None,
) -> None:
    """Every field in which two policies' contracts differ; exit code 1 if any does."""
    rows = learn_tasks.diff_policies(first, second)
    console.differences(rows)
    if json is not None:
        write_json(json, rows)
    if rows:
        raise typer.Exit(1)


@policy.command("try")
def try_(
    file: PolicyFile,
    fish: FishOption,
    arc: Annotated[float, typer.Option(help="Half angle of the targets' bearings [deg].")] = 120.0,
    targets: Annotated[int, typer.Option(help="How many.")] = 1000,
    exact: Annotated[bool, typer.Option(help="Without noise and randomisation.")] = False,
    pools: Annotated[
        int, typer.Option(help="Swim in so many waters of the virtual pool; give the pool's fish.")
    ] = 0,
    seed: SeedOption = 0,
    json: JsonOption = None,
) -> None:
    """Swim a policy to seeded targets in its twin, all noise and randomisation on, or in pools."""
    if json is not None:
        refuse_existing(json)
    done = learn_tasks.try_policy(file, fish, arc, targets, seed, exact, pools)
    where = "in the virtual pool" if pools else "in the twin"
    console.tables({f"{where}, by bearing": done["sectors"]})
    console.tables({where: [{k: v for k, v in done.items() if k != "sectors"}]})
    if json is not None:
        write_json(json, done)
