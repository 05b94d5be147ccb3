"""The pages of the verbs: one for each group of the command line, read from the command line."""

import types
import typing
from typing import Any

from reference.markdown import code, page, table
from tailbeat.cli.group import load
from tailbeat.cli.verbs import PANELS, Verb

EXIT_CODES = table(
    ["exit code", "meaning"],
    [
        ["0", "Done."],
        ["1", "The result misses what was asked for. The verb's text says when."],
        ["2", "Bad input: one sentence says what is wrong. Nothing half-written is left."],
        ["130", "Interrupted with Ctrl-C."],
    ],
)
NAMES = {"Path": "path", "str": "text", "float": "number", "int": "whole number", "bool": "yes/no"}


def pages() -> dict[str, str]:
    """Markdown by path below `reference/`."""
    groups = {panel: f"verbs/{panel.lower().replace(' ', '-')}.md" for panel in PANELS}
    bodies = {path: page(panel, *map(_entry, PANELS[panel])) for panel, path in groups.items()}
    return {"verbs/index.md": _index(groups), **bodies}


def _index(groups: dict[str, str]) -> str:
    rows = [
        [f"[`tailbeat {verb.name}`]({path.removeprefix('verbs/')}#{_anchor(verb)})", verb.sentence]
        for panel, path in groups.items()
        for verb in PANELS[panel]
    ]
    usage = "`tailbeat VERB --help` prints the same text in the terminal."
    return page("Verbs", usage, table(["verb", "what it does"], rows), "## Exit codes", EXIT_CODES)


def _anchor(verb: Verb) -> str:
    return f"tailbeat-{verb.name.replace(' ', '-')}"


def _entry(verb: Verb) -> str:
    command = load(verb)
    shown = [param for param in command.params if not param.hidden]
    options = table(["argument", "value", "default", "meaning"], map(_row, shown))
    example = f"```sh\ntailbeat {verb.name} {verb.example}\n```"
    return "\n\n".join([f"## tailbeat {verb.name}", escaped(command.help), example, options])


def _row(param: Any) -> list[str]:
    default = "required" if param.required else _default(param)
    return [_name(param), _kind(param), default, escaped(param.help or "")]


def _name(param: Any) -> str:
    """An argument in capitals, as in the help; an option with its opposite."""
    if param.param_type_name == "argument":
        return code(param.name.upper())
    return ", ".join(map(code, [*param.opts, *param.secondary_opts]))


def _default(param: Any) -> str:
    if param.default in (None, "", (), []):
        return "none"
    if isinstance(param.default, bool):
        return "yes" if param.default else "no"
    return code(param.default)


def _kind(param: Any) -> str:
    """What a value is, in words."""
    annotation = param.type_descriptor.annotation
    many = " ..." if param.multiple or param.nargs != 1 else ""
    return kind_of(annotation) + many


def kind_of(annotation: Any) -> str:
    """A type in words: `list[Path] | None` is a path."""
    if isinstance(annotation, types.UnionType) or typing.get_origin(annotation) is typing.Union:
        annotation = next(a for a in typing.get_args(annotation) if a is not type(None))
    if typing.get_origin(annotation) is typing.Literal:
        return ", ".join(map(code, typing.get_args(annotation)))
    if typing.get_origin(annotation) in (list, tuple):
        annotation = typing.get_args(annotation)[0]
    return NAMES.get(annotation.__name__, annotation.__name__)


def escaped(text: str) -> str:
    """Help as Markdown: brackets of units are no links, and a star is no emphasis."""
    for mark in "[]*<>_":
        text = text.replace(mark, f"\\{mark}")
    return text
