"""Print tags, calibrate a camera, track a fish with it."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from tailbeat.cli import output
from tailbeat.cli.extras import need_camera
from tailbeat.cli.options import JsonOption
from tailbeat.files import check_json, put_json

FishTag = Annotated[int, typer.Option("--fish-tag", help="Id of the fish's tag (family 36h11).")]
TargetTag = Annotated[int, typer.Option("--target-tag", help="Id of the target's tag.")]
SizedFor = Annotated[
    str | None,
    typer.Option(
        "--fish", help="Fish whose description has the tag's size: a TOML file or a shipped name."
    ),
]
SquareOption = Annotated[float, typer.Option(help="Side of the board's squares [m], as measured.")]
CAMERAS = "/dev/video0, unix:/path (a virtual camera) or a video file"


def tags(
    out: Annotated[Path, typer.Option("--out", help="Sheet to write: .pdf, .svg or .png.")],
    fish_tag: FishTag = 0,
    target_tag: TargetTag = 1,
    fish: SizedFor = None,
    side: Annotated[
        float | None,
        typer.Option(help="Side of the tags' black squares [m]; default: the fish's, else 0.08."),
    ] = None,
    square: SquareOption = 0.026,
    json: JsonOption = None,
) -> None:
    """Write the sheets to print: fish tag, target tag and calibration board, at true size."""
    check_json(json)
    need_camera()
    from tailbeat.vision.sheet import write_sheets
    from tailbeat.vision.tags import board_of

    paths = write_sheets(out, (fish_tag, target_tag), _side(side, fish), board_of(square))
    put_json(json, {"sheets": [str(path) for path in paths]})
    output.say(f"wrote {', '.join(map(str, paths))}; print at 100 % and measure")


def _side(given: float | None, fish: str | None) -> float:
    """Side of a tag's black square [m]: as given, else the fish's, else the paper's. Raises
    BadInput for a fish that cannot be read."""
    from tailbeat.fish.store import load_fish
    from tailbeat.vision.tags import SIDE

    described = load_fish(fish).tag if fish is not None else None
    return next((side for side in (given, described) if side is not None), SIDE)


def calibrate(
    views: Annotated[
        str, typer.Option(help=f"Views of the board: a folder of pictures, {CAMERAS}.")
    ],
    survey: Annotated[
        Path, typer.Option(help="Table of surveyed points: x_m,y_m,z_m and tag, or u_px,v_px.")
    ],
    picture: Annotated[
        str, typer.Option(help=f"Picture of the surveyed points: a picture file, {CAMERAS}.")
    ],
    out: Annotated[Path, typer.Option("--out", help="Calibration to write, .json.")],
    fish_height: Annotated[
        float, typer.Option(help="Height of the fish's tag above the water [m]; negative below.")
    ] = -0.03,
    target_height: Annotated[
        float, typer.Option(help="Height of the target's tag above the water [m].")
    ] = 0.0,
    fish: SizedFor = None,
    fish_side: Annotated[
        float | None,
        typer.Option(
            help="Side of the black square of the fish's tag [m]; default: the fish's, else 0.08."
        ),
    ] = None,
    target_side: Annotated[
        float | None,
        typer.Option(help="Side of the black square of the target's tag [m]; default: the same."),
    ] = None,
    square: SquareOption = 0.026,
    pool: Annotated[
        str, typer.Option(help="Length,width of the pool [m]; its middle is x = y = 0.")
    ] = "5.5,2.7",
    count: Annotated[
        int, typer.Option(help="Number of views taken from a video or a camera.")
    ] = 20,
    json: JsonOption = None,
) -> None:
    """Find the camera's lens parameters and its pose above the pool. The steps are in
    docs/how-to/calibrate-the-camera.md."""
    check_json(json)
    need_camera()
    from tailbeat.link.places import pool_size
    from tailbeat.vision import calibrate as camera
    from tailbeat.vision.tags import Tag

    own = _side(fish_side, fish)
    other = own if target_side is None else target_side
    tags_ = Tag(own, fish_height), Tag(other, target_height)
    sheet = camera.Measured(square, *tags_, pool_size(pool))
    done = asdict(camera.calibrate(views, survey, picture, sheet, out, count, output.say))
    output.tables({"calibration": [done]})
    put_json(json, done)


def track(
    camera: Annotated[str, typer.Option(help=f"{CAMERAS}.")],
    calibration: Annotated[Path, typer.Option(help="Calibration made by `tailbeat calibrate`.")],
    fish_tag: FishTag = 0,
    target_tag: TargetTag = 1,
    seconds: Annotated[float, typer.Option(help="Duration [s]; 0: until Ctrl-C.")] = 0.0,
    oldest: Annotated[
        float, typer.Option(help="Largest accepted age of the calibration [days].")
    ] = 30.0,
    exposure: Annotated[
        float, typer.Option(help="Exposure time [s]; half of it is subtracted from the time stamp.")
    ] = 0.002,
    latency: Annotated[
        float, typer.Option(help="Time from the end of the exposure to the time stamp [s].")
    ] = 0.0,
    json: JsonOption = None,
) -> None:
    """Print the poses of fish and target from a camera, live. Exit code 1 if the fish was never
    seen."""
    check_json(json)
    need_camera()
    from tailbeat.vision import follow

    ids = fish_tag, target_tag
    config = follow.TrackConfig(camera, calibration, ids, exposure, latency, oldest)
    done = follow.track(config, seconds, output.say)
    output.tables({"track": [vars(done)]})
    put_json(json, vars(done))
    if not done.fish_seen:
        raise typer.Exit(1)
