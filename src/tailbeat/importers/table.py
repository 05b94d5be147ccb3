"""Read any CSV, JSON or Parquet table as a recording; the user names its columns and units.

A JSON file is a list of objects, an object of lists, or an object with a header: one field holds
the list of objects or the object of lists, the others are the header.
"""

import csv
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.files import BadInput, refuse_existing
from tailbeat.importers.cells import Array, Cells, number, numbers, target, texts, unit_scales
from tailbeat.importers.settings import (
    NUMBERS,
    TEXTS,
    allowed,
    checked,
    fits,
    of_comments,
    same,
)
from tailbeat.recording import TEXTS as TEXT_COLUMNS
from tailbeat.recording import Recording, changes, read_parquet, write_recording

Labels = Mapping[str, NDArray[np.str_]]


@dataclass(frozen=True)
class TableConfig:
    """How to read the file: `columns` maps a name in `cells.COLUMNS`, or `marker0_x` and so on,
    to a column of the file. `units` are the columns' (SI where none is given), `counts_per_turn`
    the encoder's. `meta` maps a key to a header field, a number, or a word, in the key's own unit.
    `rows` is the JSON field with the entries or their lists (None: the only list). `source`: who
    recorded it, in the user's words."""

    columns: Mapping[str, str]
    units: Sequence[str] = ()
    meta: Mapping[str, str] = field(default_factory=dict)
    rows: str | None = None
    source: str = ""
    counts_per_turn: float | None = None


@dataclass(frozen=True)
class Table:
    """A file's columns, unconverted, its header fields if it is JSON, and the metadata that a CSV
    or a Parquet file states itself."""

    file: Path
    columns: Mapping[str, Sequence[Any]]
    header: Mapping[str, Any] = field(default_factory=dict)
    stated: Mapping[str, str] = field(default_factory=dict)


def parse_pairs(option: str, text: str) -> dict[str, str]:
    """`a=b,c=d` as a mapping. Raises BadInput that names the option, also for a repeated name."""
    pairs = [part.partition("=") for part in text.split(",") if part.strip()]
    if not all(name.strip() and equals and value.strip() for name, equals, value in pairs):
        raise BadInput(f"{option} {text!r}: give pairs like time=timestamp,angle=position.")
    names = [name.strip() for name, _, _ in pairs]
    if twice := [name for name in names if names.count(name) > 1]:
        raise BadInput(f"{option} {text!r}: {twice[0]} is given twice; give it once.")
    return {name.strip(): value.strip() for name, _, value in pairs}


def convert(path: Path, out: Path, config: TableConfig) -> Recording:
    """`import_table`, written to `out`, .csv or .parquet. Raises BadInput, also if it exists."""
    refuse_existing(out)
    recording = import_table(path, config)
    write_recording(recording, out)
    return recording


def import_table(path: str | Path, config: TableConfig) -> Recording:
    """The mapped columns of a table in SI units. An empty cell of a marker column becomes NaN.
    Raises BadInput that names file, column and row, or the option that is wrong."""
    table = read_table(Path(path), config.rows)
    scales = unit_scales(config.units, config.counts_per_turn)
    if "time" not in config.columns:
        raise BadInput("--map has no time; name the column of times, as time=NAME.")
    if len(config.columns) == 1:
        raise BadInput(
            "--map names the time alone; name the signals too, as time=t,angle=position."
        )
    found = [_column(table, name, source) for name, source in config.columns.items()]
    _check_lengths(table.file, found)
    columns: dict[str, Array] = {}
    labels: dict[str, NDArray[np.str_]] = {}
    for cells in found:
        column, quantity = target(cells.name)
        scale = scales.get(quantity, 1.0)
        if column in TEXT_COLUMNS:
            labels[column] = texts(cells, scale)
        else:
            columns[column] = numbers(cells, scale)
    time = columns.pop("time_s")
    _check_rises(table, config.columns["time"], time, labels)
    return Recording(table.file.stem, time, columns, _meta(table, config, labels), labels)


# ---- reading ------------------------------------------------------------------------------------


def read_table(file: Path, rows: str | None = None) -> Table:
    """Columns and header of a .json, .parquet or CSV file. Raises BadInput if it is no table of two
    rows or more."""
    if not file.is_file():
        raise BadInput(f"{file}: no such file; give a table as .csv, .json or .parquet.")
    if file.suffix != ".json" and rows is not None:
        raise BadInput(f"--rows {rows}: {file} is not a JSON file; leave --rows out.")
    if file.suffix == ".json":
        table = _read_json(file, rows)
    else:
        table = _read_parquet(file) if file.suffix == ".parquet" else _read_csv(file)
    if max(map(len, table.columns.values()), default=0) < 2:
        raise BadInput(f"{file}: give a table with a header and at least two rows.")
    return table


def _read_parquet(file: Path) -> Table:
    frame, stated = read_parquet(file)
    columns = {name: frame[name].to_list() for name in frame.columns}
    return Table(file, columns, stated=checked(file, stated))


def _read_csv(file: Path) -> Table:
    """Cells as text; separated by comma, semicolon or tab, whichever the header has most of."""
    try:
        text = file.read_text(encoding="utf-8-sig").splitlines()
        lines = [line for line in text if line.strip() and not line.startswith("#")]
        mark = max(",;\t", key=(lines[0] if lines else "").count)
        cells = [[cell.strip() for cell in row] for row in csv.reader(lines, delimiter=mark)]
    except (UnicodeDecodeError, csv.Error):
        raise BadInput(f"{file}: not text; give a CSV in UTF-8, JSON or Parquet.") from None
    header, *filled = cells or [[]]
    if twice := [name for name in header if header.count(name) > 1]:
        if np.isfinite(number(twice[0])):
            raise _headless(file, twice[0])
        raise BadInput(f"{file}: column {twice[0]!r} appears twice; rename or remove one.")
    for row, line in enumerate(filled, start=1):
        if len(line) != len(header):
            said = f"row {row} has {len(line)} cells and the header {len(header)}"
            raise BadInput(f"{file}: {said}; correct or remove the row.")
    columns = {name: [line[i] for line in filled] for i, name in enumerate(header)}
    return Table(file, columns, stated=of_comments(file, text))


def _read_json(file: Path, rows: str | None) -> Table:
    try:
        data = json.loads(file.read_text(encoding="utf-8"))
    except ValueError as error:  # also of a number with thousands of digits
        raise BadInput(f"{file}: not JSON ({error}); give another file.") from None
    header: dict[str, Any] = {}
    if isinstance(data, dict):
        header = _fields(data)
        if rows is not None and isinstance(data.get(rows), dict):
            data, rows = data[rows], None
            header |= _fields(data)
        data = _entries(file, data, rows)
    if isinstance(data, dict):
        return Table(file, data, header)
    return Table(file, _from_objects(file, data), header)


def _fields(data: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in data.items() if not isinstance(value, list | dict)}


def _entries(file: Path, data: dict[str, Any], rows: str | None) -> Any:
    """The list of objects of an object with a header, or its lists."""
    lists = {name: value for name, value in data.items() if isinstance(value, list)}
    inside = [
        name
        for name, value in data.items()
        if isinstance(value, dict) and any(isinstance(one, list) for one in value.values())
    ]
    if rows is not None and rows not in lists:
        said = f"--rows {rows!r} is not a list, nor an object that has lists"
        raise BadInput(f"{file}: {said}; {_there([*lists, *inside])}.")
    if rows is not None:
        return lists[rows]
    nested = [name for name, value in lists.items() if value and isinstance(value[0], dict)]
    if len(nested) > 1:
        raise BadInput(f"{file}: several lists of entries ({', '.join(nested)}); name one: --rows.")
    if not lists and inside:
        said = f"has no list of entries outside of {', '.join(inside)}"
        raise BadInput(f"{file}: {said}; name the object that has the lists: --rows.")
    if not lists:
        raise BadInput(f"{file}: has no list of entries; give a JSON file that has one.")
    return lists[nested[0]] if nested else lists


def _from_objects(file: Path, data: Any) -> dict[str, Sequence[Any]]:
    objects = isinstance(data, list) and all(isinstance(entry, dict) for entry in data)
    if not objects or len(data) < 2:
        raise BadInput(f"{file}: has no list of two or more objects; give one, or lists.")
    names = {name: None for entry in data for name in entry}  # a dict keeps their order
    return {name: [entry.get(name) for entry in data] for name in names}


# ---- columns ------------------------------------------------------------------------------------


def _there(names: Iterable[str]) -> str:
    found = ", ".join(names)
    return f"there are {found}" if found else "there is none"


def _column(table: Table, name: str, source: str) -> Cells:
    target(name)
    if source in table.columns:
        return Cells(table.file, name, source, table.columns[source])
    is_csv = table.file.suffix not in (".json", ".parquet")
    if is_csv and np.isfinite(number(next(iter(table.columns)))):
        raise _headless(table.file, next(iter(table.columns)))
    missing = f"column {source!r} (--map {name}) is missing"
    raise BadInput(f"{table.file}: {missing}; {_there(table.columns)}.")


def _headless(file: Path, first: str) -> BadInput:
    """What is wrong with a CSV whose first row holds a number."""
    said = f"the first row holds the number {first!r}, so the header is missing or commented out"
    return BadInput(f"{file}: {said}; write the columns' names into the first row, without a #.")


def _check_lengths(file: Path, found: Sequence[Cells]) -> None:
    """Refuse mapped columns of unequal length, or of fewer than two rows."""
    lengths = {cells.header: len(cells.values) for cells in found}
    if len(set(lengths.values())) > 1:
        raise BadInput(f"{file}: lists of unequal length ({lengths}); make them equal.")
    if min(lengths.values()) < 2:
        raise BadInput(f"{file}: give a table with a header and at least two rows.")


def _check_rises(table: Table, name: str, time: Array, labels: Labels) -> None:
    back = (np.diff(time) <= 0) & ~changes(labels, time.size)
    if back.any():
        row = int(np.argmax(back)) + 1
        raise BadInput(
            f"{table.file}: column {name}, row {row + 1}: {time[row]:.9g} s does not come after"
            f" {time[row - 1]:.9g} s; time must rise. Sort the rows, remove the repeated one, or"
            f" map condition, gain or load to a column that changes where time starts again."
        )


# ---- metadata -----------------------------------------------------------------------------------


def _meta(table: Table, config: TableConfig, labels: Labels) -> dict[str, str]:
    """What the file states and what --meta adds. The source is in the user's own words, if given.
    Raises BadInput if two of file, --meta and --map contradict each other."""
    given = {key: _meta_value(table, key, value) for key, value in config.meta.items()}
    headers = {target(name)[0]: header for name, header in config.columns.items()}
    if twice := [key for key in given if key in labels]:
        said = f"--map already takes {twice[0]} from column {headers[twice[0]]}"
        raise BadInput(f"--meta {twice[0]}={config.meta[twice[0]]}: {said}; leave one of them out.")
    for key, text in table.stated.items():
        if key in given and not same(key, text, given[key]):
            raise _contradiction(table, key, f"--meta {key}={config.meta[key]}")
        other = [i for i, word in enumerate(labels.get(key, ())) if not same(key, text, word)]
        if other:
            cell = f"row {other[0] + 1}: {str(labels[key][other[0]])!r}"
            raise _contradiction(table, key, f"column {headers[key]}, {cell}")
    source = config.source or table.stated.get("source")
    source = source or f"not stated; imported from {table.file.name}"
    return {**table.stated, "source": source, **given}


def _contradiction(table: Table, key: str, other: str) -> BadInput:
    said = f"metadata {key} = {table.stated[key]!r} contradicts {other}"
    return BadInput(f"{table.file}: {said}; correct or remove one of them.")


def _meta_value(table: Table, key: str, value: str) -> str:
    """The header field of this name, else `value` itself. Raises BadInput."""
    if value in table.header:
        found = table.header[value]
        text = "" if found is None else str(found)
        if not fits(key, text):
            said = f"header field {value} (--meta {key}) is {found!r}"
            raise BadInput(f"{table.file}: {said}; give {allowed(key)}.")
        return text
    known = key in TEXTS or np.isfinite(number(value))
    if not known or not fits(key, value):
        wanted = allowed(key) if key in (*NUMBERS, *TEXTS) else "a number"
        raise BadInput(
            f"{table.file}: --meta {key}={value}: not {wanted}, and not a header field;"
            f" {_there(table.header)}."
        )
    return value
