"""Write the policy of a hand-made steering rule."""

from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from tailbeat.cli import output, progress
from tailbeat.cli.extras import need_training
from tailbeat.cli.learn import expect_or_say
from tailbeat.cli.options import FishOption, JsonOption, SeedOption
from tailbeat.files import BadInput, check_json, put_json


def rule(
    fish: FishOption,
    out: Annotated[Path, typer.Option("--out", help="Policy to write, .onnx.")],
    course: Annotated[
        bool, typer.Option(help="Steer the direction in which it swims, not the one it looks in.")
    ] = False,
    task: Annotated[
        str, typer.Option(help="reach: targets that stay; follow: those that move, too.")
    ] = "reach",
    seed: SeedOption = 0,
    json: JsonOption = None,
) -> None:
    """Write the policy of a hand-made steering rule, to compare learned ones with. Its tail beats
    at one frequency, and its centre turns towards the target. The best of twelve rules is chosen in
    the twin. It is a policy like any other: evaluate it, swim it, refine it."""
    check_json(json)
    if course and task == "follow":
        raise BadInput("--course: of the rule that reaches targets; omit it with --task follow.")
    need_training()
    from tailbeat.cluster.jobs import map_jobs
    from tailbeat.fish.store import load_fish
    from tailbeat.train.config import RunConfig
    from tailbeat.train.recipes import recipe_of
    from tailbeat.train.rule import make

    with progress.counting() as count:
        chosen = recipe_of("quick", task)
        run = RunConfig(load_fish(fish), out.parent, chosen, seed=seed, averages=course)
        done = make(run, out, count, partial(map_jobs, preload=("tailbeat.train.rule",)))
    output.tables({"best rule, as actions": [asdict(done.rule)]})
    how = f"median {done.median_seconds:.1f} s"
    if task == "follow":
        how = f"mean distance {100 * done.mean_distance:.0f} cm"
    share = f"{100 * done.reached:.0f} % of {done.targets} targets in the twin"
    output.say(f"{share}, {how}; policy: {done.policy}")
    expect_or_say(done.policy, chosen.name)
    put_json(json, done)
