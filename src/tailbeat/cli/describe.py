"""Describe a fish and see what it compiles to."""

from pathlib import Path
from typing import Annotated

import typer

from tailbeat.cli import output
from tailbeat.cli.options import JsonOption


def new_fish(path: Annotated[Path, typer.Argument(help="TOML file to write.")]) -> None:
    """Write a commented fish to start from."""
    from tailbeat.fish import store

    store.new_fish(path)
    output.say(f"wrote {path}; look at it with: tailbeat show {path}")


def show(
    fish: Annotated[str, typer.Argument(help="A TOML file or a shipped fish's name.")],
    picture: Annotated[Path | None, typer.Option(help="Picture to write, .png.")] = None,
    viewer: Annotated[bool, typer.Option(help="Open MuJoCo's viewer.")] = False,
    json: JsonOption = None,
) -> None:
    """Print what a fish compiles to and render a picture."""
    from tailbeat.fish import show as compiled

    shown = compiled.show(fish, picture, viewer, json)
    output.tables(shown.tables)
    output.say(f"picture ({shown.how}): {shown.picture}")
