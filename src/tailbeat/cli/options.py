"""Arguments and options that several verbs share."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from tailbeat.files import BadInput

if TYPE_CHECKING:
    from tailbeat.operator.target_path import PathAsked

SHIPPED = "pulley-fish-pool-reach"  # the policy that is taken by default
FOLLOWS = "pulley-fish-pool-follow"  # where the target moves
JsonOption = Annotated[Path | None, typer.Option("--json", help="Write the result here as JSON.")]
SeedOption = Annotated[int, typer.Option("--seed", min=0, help="Seed of all random numbers.")]
FishOption = Annotated[str, typer.Option("--fish", help="A TOML file or a shipped fish's name.")]
PoolFish = Annotated[
    str,
    typer.Option("--fish", help="Fish in the virtual pool: a TOML file or a shipped fish's name."),
]
PoolOption = Annotated[
    str, typer.Option("--pool", help="Length,width of the virtual pool [m]; the camera sees all.")
]
TwinOption = Annotated[
    str | None,
    typer.Option("--twin", help="Fish that the policy was trained on, if it is not shipped."),
]
PolicyFile = Annotated[str, typer.Argument(help="A policy, .onnx, or a shipped one's name.")]
PolicyOption = Annotated[str, typer.Option("--policy", help="A policy, .onnx, or a shipped name.")]
ServoPort = Annotated[str, typer.Option("--servo", help="Serial port of the servo.")]
DrivenFish = Annotated[
    str | None,
    typer.Option(
        "--fish",
        help="The fish that drives: its [hardware] counts. Refused if the policy is not for it."
        " Default: the fish inside the policy.",
    ),
]
ImuPort = Annotated[
    str,
    typer.Option(
        "--imu", help="Serial port of the IMU, a BNO055 or a BNO085; none: the robot has no IMU."
    ),
]
ForceCamera = Annotated[
    bool,
    typer.Option(
        "--force-camera-yaw-rate",
        help="With --imu none: swim a policy that was trained with an IMU.",
    ),
]
AddedOption = Annotated[
    float | None,
    typer.Option(
        help="Fraction of the described added mass that acts as inertia; default: the fish's own."
    ),
]
AddressOption = Annotated[
    str | None,
    typer.Option(
        "--address",
        help="Ray cluster with this machine in it: auto, or HOST:PORT. Default: no cluster.",
    ),
]
MessOption = Annotated[
    str,
    typer.Option(
        "--mess",
        help="What the lab gets wrong: clean, everyday, rough, wrecked, or a TOML file with a table"
        " [lab]; drawn from the seed.",
    ),
]
PageOption = Annotated[str, typer.Option("--page", help="host:port of the operator page.")]
TargetOption = Annotated[
    str, typer.Option("--target", help="Place of the target: x,y [m]; default: ahead, left.")
]
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
PathOption = Annotated[
    str | None,
    typer.Option(
        "--path",
        help="The target moves by the clock and never waits: figure-eight, circle, square, or a"
        " CSV file with columns x, y [m] and perhaps time [s].",
    ),
]
PathSpeed = Annotated[
    float | None,
    typer.Option(
        "--speed",
        help="Speed of the target on its --path [m/s]. Default: 0.12; a lap of the figure-eight"
        " takes 73 s (for another fish, in its measure).",
    ),
]
PathLaps = Annotated[
    int | None, typer.Option("--laps", help="Laps of the target on its --path. Default: 1.")
]
PathSeconds = Annotated[
    float | None,
    typer.Option("--seconds", help="Duration on the --path [s], instead of --laps."),
]
DrawnFish = Annotated[
    str | None,
    typer.Option(
        "--fish", help="Fish to draw, a TOML file or a name; default: the paper's, or a log's own."
    ),
]
ReplayOption = Annotated[
    Path | None,
    typer.Option("--replay", help="Show this log on the operator page, without a fish: .mcap."),
]
ReplayPool = Annotated[
    str, typer.Option("--pool", help="Length,width of the pool of a replay [m].")
]


def path_asked(
    path: str | None, speed: float | None, laps: int | None, seconds: float | None
) -> "PathAsked | None":
    """What --path and its options ask for; None without a path. Raises BadInput for options that
    have no path."""
    from tailbeat.operator.target_path import PathAsked

    if path is not None:
        return PathAsked(path, speed, laps, seconds)
    for option, value in (("--speed", speed), ("--laps", laps), ("--seconds", seconds)):
        if value is not None:
            raise BadInput(f"{option} {value:g}: it is for a target on a path; add --path.")
    return None
