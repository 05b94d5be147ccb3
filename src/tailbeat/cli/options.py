"""Arguments and options that several verbs share."""

from pathlib import Path
from typing import Annotated

import typer

SHIPPED = "pulley-fish-pool-generator"  # the policy that is taken by default
JsonOption = Annotated[Path | None, typer.Option("--json", help="Write the result here as JSON.")]
SeedOption = Annotated[int, typer.Option("--seed", min=0, help="Seed of all random numbers.")]
FishOption = Annotated[str, typer.Option("--fish", help="A TOML file or a shipped fish's name.")]
PoolFish = Annotated[
    str,
    typer.Option("--fish", help="Fish in the virtual pool: a TOML file or a shipped fish's name."),
]
TwinOption = Annotated[
    str | None,
    typer.Option("--twin", help="Fish that the policy was trained on, if it is not shipped."),
]
PolicyFile = Annotated[str, typer.Argument(help="A policy, .onnx, or a shipped one's name.")]
PolicyOption = Annotated[str, typer.Option("--policy", help="A policy, .onnx, or a shipped name.")]
ServoPort = Annotated[str, typer.Option("--servo", help="Serial port of the servo.")]
PageOption = Annotated[str, typer.Option("--page", help="host:port of the operator page.")]
TargetOption = Annotated[str, typer.Option("--target", help="Place of the target: x,y [m].")]
TourJson = Annotated[
    Path | None, typer.Option("--json", help="Write the tour's result here as JSON.")
]
TourPolicy = Annotated[
    str | None,
    typer.Option(
        "--policy", help="Policy of the fish: it says how near and how soon a tour must arrive."
    ),
]
TourBegin = Annotated[
    str | None,
    typer.Option(
        "--begin", help="Arm the fish once, with the target at x,y [m]; drag it from there."
    ),
]
ReplayOption = Annotated[
    Path | None,
    typer.Option("--replay", help="Show this log on the operator page, without a fish: .mcap."),
]
ReplayPool = Annotated[
    str, typer.Option("--pool", help="Length,width of the pool of a replay [m].")
]
