"""What our prose must hold, beyond spelling: short lines, short sentences, our words.

`python tools/prose.py` checks README, CHANGELOG, CONTRIBUTING, docs/ and the words of help texts,
and exits with 1 if one fails.
"""

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
LINE, SENTENCE = 100, 25  # characters, words
# The reader's first pages: here a long sentence is a fault. "" would mean all.
FIRST = ("README.md", "CONTRIBUTING.md", "docs/index.md", "docs/start/", "docs/your-fish/")
# One thing has one name: what we do not write, and what we write.
WORDS = {
    "warden": "watchdog",
    "let(s|ting)?[ -]go": "turn torque off, or torque-off",
    "console": "terminal or operator page",
    "desk": "operator page, or computer",
    "flutter": "speed map",
    "pace": "latency",
    "rigs?": "emulator",
    "pilot": "policy runner",
    "coach": "training callback",
    "rehears[a-z]+": "synthetic recordings",
    "close-?up": "target features",
    "arms of (a|the) trial": "conditions",
    "at sight": "without further training",
    "old news": "out of date",
    "of before": "earlier",
    "of the way": "of the path length",
    "reckoned": "estimated",
    "shares? of": "fraction, or success rate",
}
HELP = "src/tailbeat/cli"
# The changelog and the experiments name what things were called before.
FORMER = ("CHANGELOG.md", "docs/experiments/")


def pages() -> list[Path]:
    """Every page that is held, README first."""
    named = [ROOT / f"{name}.md" for name in ("README", "CONTRIBUTING", "CHANGELOG", "SECURITY")]
    docs = sorted((ROOT / "docs").rglob("*.md"))
    return [*named, *(page for page in docs if not page.name.startswith("TODO-"))]


def helps() -> list[Path]:
    """Every file with help texts of verbs."""
    return sorted((ROOT / HELP).glob("*.py"))


def faults(path: Path) -> list[str]:
    """What is wrong with a page, as `file:line: what`."""
    name, text = path.relative_to(ROOT).as_posix(), path.read_text("utf-8")
    found = [*long_lines(text)]
    if not name.startswith(FORMER):
        found += wrong_words(text)
    if name.startswith(FIRST):
        found += long_sentences(text)
    return [f"{name}:{line}: {what}" for line, what in sorted(found)]


def help_faults(path: Path) -> list[str]:
    """Words of a verb's help texts for which we have another, as `file:line: what`."""
    texts = [
        (node.lineno, node.value)
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value
    ]
    name = path.relative_to(ROOT).as_posix()
    return [f"{name}:{line}: {what}" for line, text in texts for _, what in wrong_words(text)]


def long_lines(text: str) -> Iterator[tuple[int, str]]:
    """Lines of prose over 100 characters. A link's address does not count."""
    for number, line in prose(text):
        length = len(re.sub(r"\]\([^)]*\)", "]", line))
        if length > LINE and not line.lstrip().startswith(("|", "<", "[![")):
            yield number, f"{length} characters; {LINE} are allowed, so break the line"


def wrong_words(text: str) -> Iterator[tuple[int, str]]:
    """Words for which we have another; code may hold them."""
    for number, line in prose(text):
        plain = re.sub(r"`[^`]*`|\]\([^)]*\)", "", line).lower()
        for word, better in WORDS.items():
            if found := re.search(rf"\b{word}\b", plain):
                yield number, f"{found[0]!r}: write {better}"


def long_sentences(text: str) -> Iterator[tuple[int, str]]:
    """Sentences over 25 words. Code is one word; a table's cell is no sentence."""
    for number, block in paragraphs(text):
        for sentence in re.split(r"(?<=[.!?])\s+(?=[A-Z`*\[(])", block):
            count = len(re.findall(r"\S*\w\S*", sentence))
            if count > SENTENCE:
                yield number, f"{count} words, {SENTENCE} are allowed: {sentence[:60]} ..."


def paragraphs(text: str) -> Iterator[tuple[int, str]]:
    """Paragraphs and items of lists with the lines they begin at; a code span is one word."""
    start, held = 0, ""
    for number, line in [*prose(text), (0, "")]:
        begins = re.match(r"\s*([-*+]|\d+\.|#+)\s|\s*[|<]|\s*$", line)
        if begins and held:
            yield start, re.sub(r"\]\([^)]*\)", "]", re.sub(r"`[^`]*`", "`code`", held))
            held = ""
        if not re.match(r"\s*([|<]|$)", line):
            start, held = (start if held else number), f"{held} {line.strip()}"


def prose(text: str) -> Iterator[tuple[int, str]]:
    """Numbered lines outside fenced code and without comments; a fence's own line comes empty."""
    text = re.sub(r"<!--.*?-->", lambda comment: "\n" * comment[0].count("\n"), text, flags=re.S)
    inside = False
    for number, line in enumerate(text.splitlines(), start=1):
        fence = line.lstrip().startswith(("```", "~~~"))
        inside ^= fence
        yield number, "" if inside or fence else line


def main() -> int:
    """Print the faults of all pages; returns the exit code."""
    found = [fault for page in pages() for fault in faults(page)]
    found += [fault for path in helps() for fault in help_faults(path)]
    print(*found, sep="\n", end="\n" if found else "")
    return bool(found)


if __name__ == "__main__":
    sys.exit(main())
