"""The command line's tree. A verb's module is imported when the verb is called."""

from importlib import import_module
from itertools import groupby
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from tailbeat.cli.verbs import HEADS, PANELS, Verb

PLAIN = None  # no markup in help: it would remove units like [m], and takes 0.2 s to import


class Listed(TyperCommand):
    """A verb in a list of verbs, whose module is not imported yet."""

    def __init__(self, verb: Verb, panel: str) -> None:
        super().__init__(verb.name.split()[-1], help=verb.sentence, rich_help_panel=panel)
        self.verb = verb


class Group(TyperGroup):
    """Verbs that are imported when they are called, not when they are listed."""

    def resolve_command(self, ctx: Any, args: list[str]) -> tuple[str | None, Any, list[str]]:
        """The verb that `args` name, imported, and the words after it."""
        name, found, rest = super().resolve_command(ctx, args)
        return name, load(found.verb) if isinstance(found, Listed) else found, rest

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """List the verbs panel by panel."""
        widest = max(map(len, self.commands))
        shown: Any = self.commands.values()
        for panel, verbs in groupby(shown, lambda verb: verb.rich_help_panel):
            with formatter.section(panel):
                rows = [(f"{verb.name:<{widest}}", verb.help) for verb in verbs]
                formatter.write_dl(rows, col_max=widest)


def load(verb: Verb) -> Any:
    """Import a verb's function; returns the command that parses its words."""
    module, function = verb.place.split(":")
    single = typer.Typer(add_completion=False, rich_markup_mode=PLAIN)
    add = single.command(verb.name.split()[-1], epilog=_example(verb))
    add(getattr(import_module(f"tailbeat.cli.{module}"), function))
    return typer.main.get_command(single)


def _example(verb: Verb) -> str:
    return f"Example: tailbeat {verb.name} {verb.example}"


def tree() -> Any:
    """`tailbeat` with all its verbs."""
    app = typer.Typer(
        name="tailbeat",
        cls=Group,
        help="Identify a soft robotic fish from recordings, and train a policy that swims.",
        epilog="Example: tailbeat swim --headless",
        rich_markup_mode=PLAIN,
    )
    app.callback()(_options_of_all)
    root = typer.main.get_command(app)
    assert isinstance(root, Group)
    for panel, verbs in PANELS.items():
        for verb in verbs:
            _hang(root, verb, panel)
    return root


def _hang(root: Group, verb: Verb, panel: str) -> None:
    head, _, name = verb.name.partition(" ")
    if not name:
        root.commands[head] = Listed(verb, panel)
        return
    if head not in root.commands:
        given: dict[str, Any] = {"rich_help_panel": panel, "rich_markup_mode": PLAIN}
        root.commands[head] = Group(name=head, help=HEADS[head], epilog=_example(verb), **given)
    branch = root.commands[head]
    assert isinstance(branch, Group)
    branch.commands[name] = Listed(verb, "Verbs")


def say_version(asked: bool) -> None:
    """Print the version and end."""
    if asked:
        from tailbeat import __version__

        print(f"tailbeat {__version__}")
        raise typer.Exit


def _options_of_all(
    version: Annotated[
        bool,
        typer.Option("--version", callback=say_version, is_eager=True, help="Print the version."),
    ] = False,
) -> None:
    """The options that come before a verb."""
