"""The verbs of the trials: `swim`, `evaluate`, `compare`, `report`. Parse, call, print."""

import sys
from pathlib import Path
from typing import Annotated, Any

import typer

from tailbeat import console, swim_tasks, tasks
from tailbeat.evaluate.evaluation import NAMES
from tailbeat.files import BadInput, refuse_existing, write_json

SHIPPED = "pulley-fish-pool-generator"
PolicyFile = Annotated[str, typer.Argument(help="A policy, .onnx, or a shipped one's name.")]
JsonOption = Annotated[Path | None, typer.Option("--json", help="Write the result here as JSON.")]
FishOption = Annotated[str, typer.Option("--fish", help="The pool's fish: a file or a name.")]
TwinOption = Annotated[
    str | None, typer.Option("--twin", help="The fish the policy was trained on, if not shipped.")
]
SeedOption = Annotated[int, typer.Option("--seed", help="Seed of everything random.")]


def swim(
    fish: Annotated[
        str | None, typer.Option("--fish", help="Beat this fish open-loop instead, no policy.")
    ] = None,
    policy: Annotated[str, typer.Option(help="A policy's file or a shipped one's name.")] = SHIPPED,
    pool_fish: Annotated[str, typer.Option(help="The pool's fish.")] = "pulley-fish",
    twin: TwinOption = None,
    headless: Annotated[
        bool, typer.Option("--headless", help="Swim to drawn targets and end, with a page.")
    ] = False,
    direct: Annotated[
        bool, typer.Option("--direct", help="The same without bytes, faster than real time.")
    ] = False,
    console_at: Annotated[
        str, typer.Option("--console", help="host:port of the operator's page; a tour takes any.")
    ] = "127.0.0.1:8080",
    targets: Annotated[int, typer.Option(help="Of a tour: how many, one after the other.")] = 8,
    seed: SeedOption = 0,
    out: Annotated[Path, typer.Option(help="Folder for page, film, log, summary.")] = Path("runs"),
    json: JsonOption = None,
) -> None:
    """The main job: fish, camera and laptop over a virtual pool, in real time. Drag the target on
    the page; or --headless (so too without a terminal): a tour of targets, then a page; exit code 1
    if it missed one by more than 20 cm."""
    if json is not None:
        refuse_existing(json)
    if fish is not None:
        done = tasks.open_loop(fish, out)
        console.summary(done)
    elif not (headless or direct) and sys.stdout.isatty():
        if json is not None:
            raise BadInput("--json: a swim that you attend has no result; add --headless.")
        swim_tasks.attended(policy, pool_fish, twin, seed, console_at, out, console.say)
        return
    else:
        asked = (policy, pool_fish, twin, targets, seed, out, console.counting)
        done = swim_tasks.swim(*asked) if direct else swim_tasks.live(*asked, console.say)
        console.tables({f"{done['fish']} in the virtual pool, {done['policy']}": done["targets"]})
        console.say(f"{done['within_5cm']} of {targets} within 5 cm; page: {out / 'report.html'}")
    if json is not None:
        write_json(json, done)
    if fish is None and done["within_20cm"] < targets:
        raise typer.Exit(1)


def evaluate(
    policy: PolicyFile,
    out: Annotated[Path, typer.Option("--out", help="Folder of the runs; taken up if it exists.")],
    fish: FishOption = "pulley-fish",
    twin: TwinOption = None,
    pool: Annotated[
        str, typer.Option(help="ensemble, full, no lag, no stall or no added inertia.")
    ] = "ensemble",
    task: Annotated[
        list[str] | None, typer.Option("--tasks", help=f"Of {', '.join(NAMES)}; default: all.")
    ] = None,
    episodes: Annotated[int, typer.Option(help="Swims in each arm of a task.")] = 250,
    walls: Annotated[
        str, typer.Option(help="Of the walled trials, length x width [m].")
    ] = "5.5x2.7",
    seed: SeedOption = 0,
    json: JsonOption = None,
) -> None:
    """Try a policy in the virtual pool: targets, disturbances, tracks, beyond its training."""
    if json is not None:
        refuse_existing(json)
    with console.counting() as progress:
        done = swim_tasks.evaluate(
            policy, fish, twin, pool, task or list(NAMES), episodes, seed, out, progress, walls
        )
    console.evaluated(done)
    _page(out, fish, twin, done, json)


def compare(
    policies: Annotated[list[str], typer.Argument(help="Policies of several kinds and seeds.")],
    out: Annotated[Path, typer.Option("--out", help="Folder of the cells; taken up if it exists.")],
    fish: FishOption = "pulley-fish",
    twin: TwinOption = None,
    targets: Annotated[int, typer.Option(help="Targets of each cell.")] = 100,
    share: Annotated[
        str, typer.Option(help="i/n: swim every n-th cell only, for n processes.")
    ] = "1/1",
    seed: SeedOption = 0,
    json: JsonOption = None,
) -> None:
    """The controlled comparison: every policy in its twin and in the pool, piece by piece."""
    if json is not None:
        refuse_existing(json)
    with console.counting() as progress:
        done = swim_tasks.compare(policies, fish, twin, targets, seed, share, out, progress)
    console.compared(done)
    _page(out, fish, twin, done, json)


def _page(out: Path, fish: str, twin: str | None, done: dict[str, Any], json: Path | None) -> None:
    """The page of numbers just made, and the numbers where they are asked for."""
    path, _ = swim_tasks.report(out, fish, twin, done)
    console.say(f"page: {path}")
    if json is not None:
        write_json(json, done)


def report(
    folder: Annotated[Path, typer.Argument(help="Folder of an evaluation or a comparison.")],
    fish: FishOption = "pulley-fish",
    twin: TwinOption = None,
    json: JsonOption = None,
) -> None:
    """One page of a folder's numbers and figures, the paper's beside them."""
    if json is not None:
        refuse_existing(json)
    path, data = swim_tasks.report(folder, fish, twin)
    console.say(f"page: {path}")
    if json is not None:
        write_json(json, data)
