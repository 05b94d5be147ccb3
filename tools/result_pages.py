"""Write the numbers of docs/results/data into the pages that show them.

A page holds blocks `<!--= TEMPLATE -->TEXT<!--/-->`. The template is Jinja's: `sig(x)` calls a
function of `result_cells.py`, and a result is read by its name, as `bench.tail.k_eff.value`. (No
filters: a `|` would end the cell of a table.) The text is never typed: `make results` writes it,
and a test compares it with the template. A number outside blocks fails a test.
"""

import json
import re
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Any

from jinja2 import Environment, StrictUndefined, TemplateError, meta

import result_cells
from tailbeat.files import BadInput, new_file

BLOCK = re.compile(r"<!--=(.*?)-->(.*?)<!--/-->", re.S)
PAGES = ("README.md", "docs/results/*.md")


def data_path(root: Path, name: str) -> Path:
    """Where the data of a result lie."""
    return root / "docs" / "results" / "data" / f"{name}.json"


def pages(root: Path) -> list[Path]:
    """Every page that may hold blocks."""
    found = [path for pattern in PAGES for path in sorted(root.glob(pattern))]
    return [path for path in found if not path.name.startswith("TODO-")]


class Part:
    """A mapping or a list inside a result's file, which names file and field where it lacks one."""

    def __init__(self, value: Any, path: Path, field: str = "") -> None:
        self._value, self._path, self._field = value, path, field

    def __getitem__(self, key: Any) -> Any:
        field = f"{self._field}.{key}".lstrip(".")
        try:
            found = self._value[key]
        except (KeyError, IndexError, TypeError):
            raise BadInput(
                f"{self._path}: field {field} is missing; a page shows it. Make the result again:"
                f' make results ARGS="--again {self._path.stem}".'
            ) from None
        return Part(found, self._path, field) if isinstance(found, dict | list) else found

    def __getattr__(self, key: str) -> Any:
        if key.startswith("__"):  # what Python and Jinja ask of any object
            raise AttributeError(key)
        return self[key]

    def __iter__(self) -> Iterator[Any]:
        keys = self._value if isinstance(self._value, dict) else range(len(self._value))
        return (key if isinstance(self._value, dict) else self[key] for key in keys)

    def __len__(self) -> int:
        return len(self._value)

    def items(self) -> Iterator[tuple[str, Any]]:
        """Name and value of each field."""
        return ((key, self[key]) for key in self._value)


class NotMade(BadInput):
    """A result whose file is not there yet; the message says how to make it."""


def read(root: Path, name: str) -> Part:
    """A result by its name. Raises NotMade where its file is missing, BadInput if it is broken."""
    path = data_path(root, name)
    said = path.relative_to(root)
    try:
        return Part(json.loads(path.read_text("utf-8")), said)
    except FileNotFoundError:
        raise NotMade(f"*Not measured yet: `make results ARGS={name}`.*") from None
    except json.JSONDecodeError as error:
        raise BadInput(f"{said}: not JSON: {error}; make the result again.") from None


class Renderer:
    """Gives the text of a template; each result is read once."""

    def __init__(self, root: Path) -> None:
        self._root, self._read = root, dict[str, Part]()

    @cached_property
    def _environment(self) -> Environment:
        made = Environment(undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
        made.globals |= result_cells.FUNCTIONS
        return made

    def names(self, template: str) -> list[str]:
        """The results that a template reads."""
        used = meta.find_undeclared_variables(self._environment.parse(template))
        return sorted(used - set(self._environment.globals))

    def _said(self, template: str) -> str:
        """The files that a template reads, as far as it can be read itself."""
        try:
            return ", ".join(f"docs/results/data/{name}.json" for name in self.names(template))
        except TemplateError:
            return "a template"

    def text(self, template: str) -> str:
        """What stands in the block: a paragraph of its own where the template has lines."""
        try:
            held = {name: self._of(name) for name in self.names(template)}
            text = self._environment.from_string(template).render(held).strip()
        except NotMade as error:
            text = str(error)
        except TemplateError as error:
            raise BadInput(
                f"{self._said(template)}: {error}; in: {template.strip()[:60]}"
            ) from None
        return f"\n\n{text}\n\n" if template.startswith("\n") else text

    def _of(self, name: str) -> Part:
        if name not in self._read:
            self._read[name] = read(self._root, name)
        return self._read[name]

    def names_in(self, page: str) -> set[str]:
        """The results that a page shows."""
        return {name for block in BLOCK.finditer(page) for name in self.names(block[1])}

    def page(self, text: str) -> str:
        """A page with every block's text written anew."""
        return BLOCK.sub(lambda b: f"<!--={b[1]}-->{self.text(b[1])}<!--/-->", text)


def write(root: Path) -> list[Path]:
    """Bring the pages up to date; those that changed. Nothing is written where one cannot be."""
    renderer = Renderer(root)
    texts = {path: path.read_text("utf-8") for path in pages(root)}
    made = {path: renderer.page(text) for path, text in texts.items()}
    changed = [path for path in texts if made[path] != texts[path]]
    for path in changed:
        with new_file(path, overwrite=True) as beside:
            beside.write_text(made[path], encoding="utf-8")
    return changed
