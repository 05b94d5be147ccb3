"""Every command on every page can be typed: the verb and its options exist, none is missing."""

import re
import shlex
from collections.abc import Iterable
from itertools import chain
from pathlib import Path

import pytest
import typer

from tailbeat.cli.app import spread_lists
from tailbeat.cli.group import load
from tailbeat.cli.verbs import HEADS, PANELS

ROOT = Path(__file__).parents[1]
DOCS = [page for page in sorted((ROOT / "docs").rglob("*.md")) if not page.name.startswith("TODO-")]
# An experiment's page keeps the commands of its day.
PAGES = [page for page in DOCS if page.parent.name != "experiments"]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *PAGES]
VERBS = {verb.name: verb for verbs in PANELS.values() for verb in verbs}
OF_ALL = {"--version", "--help", "--install-completion", "--show-completion"}
FENCE = re.compile(r"^ *```([^\n]*)\n(.*?)^ *```", re.M | re.S)
SHELL = {"", "sh", "bash", "console"}
BEFORE = re.compile(r"^(?:\$ |sudo |(?:\w+=\S+ )+|\.venv/bin/)+")  # what may stand before a command
RULE = re.compile(r"^([a-z]+):", re.M)
TARGETS = set(RULE.findall((ROOT / "Makefile").read_text("utf-8")))


def typed(text: str) -> list[str]:
    """Commands in fenced blocks: continued lines joined, comments and what stands before left
    out."""
    blocks = [body for info, body in FENCE.findall(text) if info.strip() in SHELL]
    lines = re.sub(r"\\\n\s*", " ", "\n".join(blocks)).splitlines()
    bare = [line.split(" #")[0] for line in lines]
    parts = [part.split() for line in bare for part in re.split(r";|&&| \| | &$", line)]
    return ours(BEFORE.sub("", " ".join(part)) for part in parts)


def named(text: str) -> list[str]:
    """Commands in code spans. They may be cut short."""
    spans = re.findall(r"(?<!`)`([^`]+)`", FENCE.sub("", text))
    return ours(" ".join(span.split()) for span in spans)


def ours(commands: Iterable[str]) -> list[str]:
    return [one for one in commands if re.match(r"(tailbeat|make) \S", one)]


def fault(command: str) -> str:
    """What is wrong with a command's verb and options, or nothing."""
    words = command.split()[1:]
    if command.startswith("make "):
        return "" if words[0] in TARGETS else f"no target {words[0]!r} in the Makefile"
    if words[0] in OF_ALL or (words[0] in HEADS and len(words) == 1):
        return ""
    name = verb_of(words)
    if name not in VERBS:
        return f"no verb {name!r}"
    known = {
        one for param in load(VERBS[name]).params for one in (*param.opts, *param.secondary_opts)
    }
    options = {word.split("=")[0] for word in words if re.match(r"--[a-z]", word)}
    unknown = options - known - OF_ALL
    return f"{name} has no {sorted(unknown)}" if unknown else ""


def verb_of(words: list[str]) -> str:
    return " ".join(words[: 2 if words[0] in HEADS else 1])


def incomplete(command: str) -> str:
    """What the parser says against a whole command, or nothing. Nothing is run."""
    words = spread_lists(shlex.split(command)[1:])
    if command.startswith("make ") or OF_ALL & set(words):
        return ""
    name = verb_of(words)
    try:
        load(VERBS[name]).make_context(name, words[len(name.split()) :])
    except typer.TyperException as error:
        return error.format_message()
    return ""


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_documented_commands_can_be_typed(page):
    text = page.read_text("utf-8")
    faults = [f"{c}: {why}" for c in chain(typed(text), named(text)) if (why := fault(c))]
    assert not faults, "\n".join(faults)
    faults = [f"{c}: {why}" for c in typed(text) if (why := incomplete(c))]
    assert not faults, "\n".join(faults)


def test_the_pages_have_commands():
    assert len(typed((ROOT / "README.md").read_text("utf-8"))) >= 10
    assert {"how-to", "explain"} <= {page.parent.name for page in PAGES}


def test_the_check_can_fail():
    text = (
        "```python\ntailbeat = 1\n```\n"
        "```sh\n$ sudo tailbeat swim --headless \\\n    --nothing x  # a remark\n```\n"
        "- in a list\n  ```\n  cd here && make swimm\n  ```\n"
        "`tailbeat flutter`, `make test`"
    )
    assert typed(text) == ["tailbeat swim --headless --nothing x", "make swimm"]
    assert named(text) == ["tailbeat flutter", "make test"]
    assert [fault(one) for one in (*typed(text), *named(text))] == [
        "swim has no ['--nothing']",
        "no target 'swimm' in the Makefile",
        "no verb 'flutter'",
        "",
    ]
    assert "issing option" in incomplete("tailbeat train --fish pulley-fish")
    assert not incomplete("tailbeat train --fish pulley-fish --out runs/a")


def test_commands_that_the_source_names_exist():
    sources = [
        p for end in ("py", "toml", "html", "service") for p in (ROOT / "src").rglob(f"*.{end}")
    ]
    spans = {
        " ".join(re.sub(r"[\"']\s*f?[\"']|{[^}]*}", "", span).split())
        for path in sources
        for span in re.findall(r"`(tailbeat [a-z][^`]*)`", path.read_text("utf-8"))
    }
    assert len(spans) > 5
    faults = [f"{span}: {why}" for span in sorted(spans) if (why := fault(span))]
    assert not faults, "\n".join(faults)
