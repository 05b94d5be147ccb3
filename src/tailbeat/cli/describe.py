"""Describe a fish and see what it compiles to."""

from pathlib import Path
from typing import Annotated

import typer

from tailbeat.cli import identified, output
from tailbeat.cli.options import JsonOption
from tailbeat.files import BadInput


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
    """Print what a fish compiles to and render a picture. With a posterior beside the fish, also
    print which identified numbers its recordings decide."""
    from tailbeat.fish import show as compiled
    from tailbeat.identify import posterior

    shown = compiled.show(fish, picture, viewer, json)
    output.tables(shown.tables)
    try:
        if (known := posterior.of(fish)) is not None:
            output.tables({"identified numbers": identified.parameters(posterior.as_rows(known))})
    except BadInput as error:  # the numbers of the file were changed since
        output.say(f"warning: {error}")
    output.say(f"picture ({shown.how}): {shown.picture}")
