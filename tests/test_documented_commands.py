"""Every command in README and docs exists, with the options it uses."""

import re
from pathlib import Path

import pytest

from tailbeat.cli.group import load
from tailbeat.cli.verbs import HEADS, PANELS

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
VERBS = {verb.name: verb for verbs in PANELS.values() for verb in verbs}
OF_ALL = {"--version", "--help", "--install-completion", "--show-completion"}


def commands(text: str) -> list[str]:
    """Commands in fenced blocks (continued lines joined, comments left out) and in code spans."""
    blocks = "\n".join(re.findall(r"^```\w*\n(.*?)^```", text, re.M | re.S))
    lines = re.sub(r"\\\n\s*", " ", blocks).splitlines()
    parts = [part.strip() for line in lines for part in line.split(" #")[0].split(";")]
    spans = re.findall(
        r"(?<!`)`(tailbeat [^`]*)`", re.sub(r"^```.*?^```", "", text, flags=re.M | re.S)
    )
    return [" ".join(part.split()) for part in [*parts, *spans] if part.startswith("tailbeat ")]


def fault(command: str) -> str:
    """What is wrong with a command, or nothing."""
    words = command.split()[1:]
    if words[0] in OF_ALL or (words[0] in HEADS and len(words) == 1):
        return ""
    name = " ".join(words[: 2 if words[0] in HEADS else 1])
    if name not in VERBS:
        return f"no verb {name!r}"
    known = {
        one for param in load(VERBS[name]).params for one in (*param.opts, *param.secondary_opts)
    }
    options = {word.split("=")[0] for word in words if re.match(r"--[a-z]", word)}
    unknown = options - known - OF_ALL
    return f"{name} has no {sorted(unknown)}" if unknown else ""


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_documented_commands_exist_with_their_options(page):
    faults = [f"{c}: {why}" for c in commands(page.read_text("utf-8")) if (why := fault(c))]
    assert not faults, "\n".join(faults)


def test_the_readme_has_commands_and_the_check_can_fail():
    assert len(commands((ROOT / "README.md").read_text("utf-8"))) >= 10
    text = (
        "```sh\ntailbeat swim --headless \\\n    --nothing x  # a remark\n```\n`tailbeat flutter`"
    )
    assert commands(text) == ["tailbeat swim --headless --nothing x", "tailbeat flutter"]
    assert [fault(one) for one in commands(text)] == [
        "swim has no ['--nothing']",
        "no verb 'flutter'",
    ]


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
