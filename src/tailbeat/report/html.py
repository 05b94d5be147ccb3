"""A page of sections in one file: tables, figures and films are inside it."""

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
    """A block of a section: `rows` of a table, the `text` of a heading, warning or command, or the
    base64 `data` of a picture (SVG) or film (MP4)."""

    kind: Literal["table", "heading", "warning", "command", "picture", "film"]
    text: str = ""
    rows: tuple[Mapping[str, Any], ...] = ()
    data: str = ""


@dataclass(frozen=True)
class Section:
    """Blocks below a heading."""

    heading: str
    blocks: tuple[Block, ...]


def write(out: Path, sections: Sequence[Section], data: Any, title: str) -> Path:
    """Write `report.html` with the sections and `report.json` with the data into a folder; returns
    the page's path."""
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
    """Rows as a table with the columns of the first row; empty for no rows."""
    return Block("table", rows=tuple(rows))


def values(of: Mapping[str, Any]) -> Block:
    """A table of names and values, one row each."""
    return table([{"": name, "value": value} for name, value in of.items()])


def figure(drawn: Figure, out: Path, name: str) -> Block:
    """Save a figure in `figures/`, as a block."""
    return picture(swim_figures.save(drawn, out / "figures" / name)[0])


def picture(path: Path) -> Block:
    """A block with an SVG."""
    return Block("picture", text=path.stem, data=base64.b64encode(path.read_bytes()).decode())


def film(path: Path) -> Block:
    """A block with an MP4 film."""
    return Block("film", data=base64.b64encode(path.read_bytes()).decode())
