"""The documentation site builds without a warning, and its pages fetch nothing."""

import ast
import html
import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest

pytest.importorskip("mkdocs", reason="the docs extra is not installed")

import tailbeat as tb

ROOT = Path(__file__).parents[1]
NAMES = [name for name in tb.__all__ if not name.startswith("_")]
SECTIONS = ["Start", "Your fish", "How to", "Explain", "Reference", "Results", "Experiments"]


def build(folder: Path, root: Path = ROOT) -> subprocess.CompletedProcess[str]:
    """Build as `make docs` does. With `-q` mkdocs would count no warning, and never fail."""
    words = [sys.executable, "-m", "mkdocs", "build", "--strict", "-d", str(folder)]
    quiet = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    return subprocess.run(words, cwd=root, env=quiet, capture_output=True, text=True, timeout=300)


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    """The whole site."""
    folder = tmp_path_factory.mktemp("site")
    done = build(folder)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def test_a_wrong_link_fails_the_build(tmp_path):
    (tmp_path / "docs").mkdir()
    (tmp_path / "mkdocs.yml").write_text("site_name: bad\n")
    (tmp_path / "docs" / "index.md").write_text("[nowhere](nowhere.md)")
    done = build(tmp_path / "site", tmp_path)
    assert done.returncode == 1 and "nowhere.md" in done.stderr
    assert "mkdocs build --strict $(ARGS)" in (ROOT / "Makefile").read_text("utf-8")


class Tags(HTMLParser):
    """The tags of a page, with their attributes."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))


def fetched(text: str) -> list[str]:
    """Addresses on other hosts that a browser loads when it shows the page."""
    loads = {"script": "src", "img": "src", "iframe": "src", "link": "href", "video": "src"}
    given = [
        str(has.get(loads[tag]))
        for tag, has in Tags(text).found
        if tag in loads and has.get("rel") not in ("canonical", "edit", "next", "prev")
    ]
    # With `md-source` on a page the theme's script asks GitHub for stars.
    given += ["//api.github.com" for _, has in Tags(text).found if has.get("class") == "md-source"]
    return [one for one in given if re.match(r"(https?:)?//", one)]


@pytest.mark.thorough
def test_a_page_fetches_nothing_from_another_host(site):
    pages = sorted(site.rglob("*.html"))
    assert len(pages) > 10
    assert {page.name: found for page in pages if (found := fetched(page.read_text("utf-8")))} == {}
    bad = '<script src="https://cdn.example/x.js"></script><a href="https://x.y" class="md-source">'
    assert fetched(bad) == ["https://cdn.example/x.js", "//api.github.com"]


@pytest.mark.thorough
def test_sections_stand_in_the_order_of_a_reader(site):
    text = (site / "index.html").read_text("utf-8")
    tabs = re.findall(r'class="md-tabs__link">\s*(.*?)\s*<', text)
    assert [tab for tab in tabs if tab in SECTIONS] == [one for one in SECTIONS if one in tabs]
    assert {"How to", "Explain", "Reference"} <= set(tabs)


def docstring(name: str) -> str:
    """Of a public name, read from its source: importing them all takes many seconds."""
    module, _, attribute = tb._HOMES[name].partition(":")
    path = ROOT / "src" / "tailbeat" / f"{module.replace('.', '/')}.py"
    kinds = ast.FunctionDef | ast.ClassDef
    found = [node for node in ast.parse(path.read_text("utf-8")).body if isinstance(node, kinds)]
    return next(ast.get_docstring(node) or "" for node in found if node.name == attribute)


@pytest.mark.thorough
def test_each_public_name_has_its_own_docstring(site):
    text = (site / "reference" / "python" / "index.html").read_text("utf-8")
    entries = dict(re.findall(r'id="tailbeat\.(\w+)".*?<p>(.*?)</p>', text, re.S))
    for name in NAMES:
        first = re.split(r"[.`\n]", docstring(name))[0]
        assert first and first in html.unescape(entries.get(name, "")), (name, first)
