"""A page of sections that needs no other file: tables, figures and films inside it."""

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from jinja2 import Environment, FileSystemLoader
from matplotlib.figure import Figure

from tailbeat.files import new_file, write_json
from tailbeat.report import swim_figures
from tailbeat.report.tables import as_cell


@dataclass(frozen=True)
class Block:
    """A piece of a section: `rows` of a table, the `text` of a heading or warning, or the base64
    `data` of a picture (SVG) or film (MP4)."""

    kind: Literal["table", "heading", "warning", "picture", "film"]
    text: str = ""
    rows: tuple[Mapping[str, Any], ...] = ()
    data: str = ""


@dataclass(frozen=True)
class Section:
    """Blocks below a heading."""

    heading: str
    blocks: tuple[Block, ...]


def write(out: Path, sections: Sequence[Section], data: Any, title: str) -> Path:
    """`report.html` of the sections and `report.json` of the data in a folder; the page's path."""
    loader = FileSystemLoader(Path(__file__).parent)
    pages = Environment(loader=loader, autoescape=True, trim_blocks=True)
    pages.filters["cell"] = lambda value: as_cell(value, 3)
    path = out / "report.html"
    with new_file(path, overwrite=True) as beside:
        text = pages.get_template("page.html").render(title=title, sections=sections)
        beside.write_text(text, encoding="utf-8")
    write_json(out / "report.json", data, overwrite=True)
    return path


def table(rows: Sequence[Mapping[str, Any]]) -> Block:
    """Rows as a table, its columns those of the first row; nothing of no rows."""
    return Block("table", rows=tuple(rows))


def values(of: Mapping[str, Any]) -> Block:
    """A table of names and values, a row each."""
    return table([{"": name, "value": value} for name, value in of.items()])


def figure(drawn: Figure, out: Path, name: str) -> Block:
    """A figure, saved in `figures/`."""
    return picture(swim_figures.save(drawn, out / "figures" / name)[0])


def picture(path: Path) -> Block:
    """A drawn SVG."""
    return Block("picture", text=path.stem, data=base64.b64encode(path.read_bytes()).decode())


def film(path: Path) -> Block:
    """A film, MP4."""
    return Block("film", data=base64.b64encode(path.read_bytes()).decode())
