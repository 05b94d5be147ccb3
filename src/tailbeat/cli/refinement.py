"""Measure in messy labs what refining a policy from its logs gains."""

from typing import TYPE_CHECKING, Annotated, Any

import typer

from tailbeat.cli import output, progress
from tailbeat.cli.extras import need_training
from tailbeat.cli.options import JsonOption, PolicyFile, PoolFish, SeedOption, TwinOption
from tailbeat.files import check_json, put_json

if TYPE_CHECKING:
    from tailbeat.evaluate.refinement import Estimate, LabResult, Refinement


def refinement(
    policy: PolicyFile,
    fish: PoolFish = "pulley-fish",
    twin: TwinOption = None,
    mess: Annotated[
        str, typer.Option(help="everyday, rough, wrecked, or a TOML file with a table [lab].")
    ] = "rough",
    labs: Annotated[int, typer.Option(help="Number of labs, each one robot in one pool.")] = 40,
    targets: Annotated[int, typer.Option(help="Targets in each lab.")] = 4,
    swims: Annotated[int, typer.Option(help="Logged swims of a minute before refining.")] = 3,
    rounds: Annotated[int, typer.Option(help="How often to swim and refine.")] = 1,
    walls: Annotated[
        bool, typer.Option(help="Logged swims in the pool; else in open water.")
    ] = True,
    seed: SeedOption = 0,
    json: JsonOption = None,
) -> None:
    """Measure in messy labs what refining a policy from its logs gains. It swims, is refined, and
    swims again. Beside it stand the policy as it is, and one with corrections that nobody can
    know."""
    check_json(json)
    need_training()
    from tailbeat.control.measure import centimetres
    from tailbeat.control.policy import load_policy
    from tailbeat.evaluate.refinement import RefinementConfig
    from tailbeat.evaluate.refinement import refinement as swim

    config = RefinementConfig(
        fish, twin, mess, labs, targets, swims, rounds=rounds, walled=walls, seed=seed
    )
    loaded = load_policy(policy)
    with progress.counting() as count:
        done = swim(loaded, config, count)
    _print(done, centimetres(loaded.contract.measure.arrival))
    put_json(json, done)


def _print(done: "Refinement", ring: str) -> None:
    names = list(dict.fromkeys(_named(e) for lab in done.labs for e in lab.estimates))
    rows = [_row(number, one, names) for number, one in enumerate(done.labs)]
    output.tables({f"targets reached of {done.config.targets}": rows})
    for what, share in (
        ("as it is", done.before),
        ("refined", done.after),
        ("with true corrections", done.true),
        ("gain of refining", done.gain),
        ("gain of true corrections", done.most),
    ):
        value, low, high = (100 * one for one in share)
        output.say(f"{what}: {value:.0f} % of targets within {ring} ({low:.0f} to {high:.0f} %)")
    held = [one.held for lab in done.labs for one in lab.estimates]
    output.say(f"95 % intervals that hold the lab's own value: {sum(held)} of {len(held)}")


def _named(one: "Estimate") -> str:
    return f"{one.name} [{one.unit}]"


def _row(number: int, one: "LabResult", names: list[str]) -> dict[str, Any]:
    found = {_named(e): f"{e.value:.2g} ({e.truth:.2g})" for e in one.estimates}
    return {
        "lab": number,
        "as it is": one.before,
        "refined": ", ".join(map(str, one.after)),
        "true corrections": one.true,
        **{name: found.get(name, "seen too little") for name in names},
    }
