"""Read any CSV, JSON or Parquet table as a recording; the user names its columns and units.

A JSON file is a list of objects, an object of lists, or an object with a header: one field holds
the list of objects, the others are the header.
"""

import csv
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

from tailbeat.files import BadInput, refuse_existing
from tailbeat.recording import TEXTS as TEXT_COLUMNS
from tailbeat.recording import Recording, changes, write_recording

Array = NDArray[np.float64]
Labels = Mapping[str, NDArray[np.str_]]
UNITS: dict[str, tuple[str, float]] = {  # unit -> quantity and its size in SI
    "rad": ("angle", 1.0),
    "deg": ("angle", np.pi / 180),
    "turns": ("angle", 2 * np.pi),
    "counts": ("angle", np.nan),  # needs the counts per turn
    "s": ("time", 1.0),
    "ms": ("time", 1e-3),
    "us": ("time", 1e-6),
    "m": ("length", 1.0),
    "cm": ("length", 1e-2),
    "mm": ("length", 1e-3),
    "Nm": ("torque", 1.0),
    "mNm": ("torque", 1e-3),
}
COLUMNS: dict[str, tuple[str, str]] = {  # what --map names -> column and quantity
    "time": ("time_s", "time"),
    "command": ("command_rad", "angle"),
    "angle": ("angle_rad", "angle"),
    "motor_angle": ("motor_angle_rad", "angle"),
    "yaw": ("yaw_rad", "angle"),
    "torque": ("torque_nm", "torque"),
    "x": ("x_m", "length"),
    "y": ("y_m", "length"),
    "enabled": ("enabled_ratio", ""),
    "condition": ("condition", ""),
    "gain": ("gain", ""),
    "load": ("load", ""),
    "load_mass": ("load_mass_kg", ""),
    "load_arm": ("load_arm_m", ""),
}
MARKER = re.compile(r"marker\d+_[xy]")
WORDS = {"true": 1.0, "false": 0.0}
TEXTS = ("load", "motor", "trajectory")  # metadata that may be words


@dataclass(frozen=True)
class TableConfig:
    """How to read the file: `columns` maps a name in `COLUMNS`, or `marker0_x` and so on, to a
    column of the file. `units` are the file's (SI where none is given), and `counts_per_turn` the
    encoder's. `meta` maps a key to a header field, a number, or a word. `rows` is the JSON field
    with the entries (None: the only list). `source`: who recorded it, in the user's words."""

    columns: Mapping[str, str]
    units: Sequence[str] = ()
    meta: Mapping[str, str] = field(default_factory=dict)
    rows: str | None = None
    source: str = ""
    counts_per_turn: float | None = None


@dataclass(frozen=True)
class Table:
    """A file's columns, unconverted, and its header fields."""

    file: Path
    columns: Mapping[str, Sequence[Any]]
    header: Mapping[str, Any]


def parse_pairs(option: str, text: str) -> dict[str, str]:
    """`a=b,c=d` as a mapping. Raises BadInput naming the option."""
    pairs = [part.partition("=") for part in text.split(",") if part.strip()]
    if not all(name.strip() and equals and value.strip() for name, equals, value in pairs):
        raise BadInput(f"{option} {text!r}: give pairs like time=timestamp,angle=position.")
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
    table, scales = read_table(Path(path), config.rows), _scales(config)
    if "time" not in config.columns:
        raise BadInput("--map has no time; name the column of times, as time=NAME.")
    columns: dict[str, Array] = {}
    labels: dict[str, NDArray[np.str_]] = {}
    for name, source in config.columns.items():
        column, quantity = _target(name)
        values = _column(table, name, source)
        if column in TEXT_COLUMNS:
            labels[column] = np.array([str(value) for value in values])
        else:
            gaps = MARKER.fullmatch(name) is not None
            columns[column] = _numbers(table, source, values, gaps) * scales.get(quantity, 1.0)
    time = columns.pop("time_s")
    _check_rises(table, config.columns["time"], time, labels)
    return Recording(table.file.stem, time, columns, _meta(table, config), labels)


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
    if min(map(len, table.columns.values()), default=0) < 2:
        raise BadInput(f"{file}: give a table with a header and at least two rows.")
    return table


def _read_parquet(file: Path) -> Table:
    try:
        frame = pl.read_parquet(file)
    except pl.exceptions.PolarsError:
        raise BadInput(f"{file}: not a Parquet file; give another.") from None
    return Table(file, {name: frame[name].to_list() for name in frame.columns}, {})


def _read_csv(file: Path) -> Table:
    """Cells as text; separated by comma, semicolon or tab, whichever the header has most of."""
    try:
        text = file.read_text(encoding="utf-8-sig")
        lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
        mark = max(",;\t", key=(lines[0] if lines else "").count)
        cells = [[cell.strip() for cell in row] for row in csv.reader(lines, delimiter=mark)]
    except (UnicodeDecodeError, csv.Error):
        raise BadInput(f"{file}: not text; give a CSV in UTF-8, JSON or Parquet.") from None
    header, *filled = cells or [[]]
    if twice := [name for name in header if header.count(name) > 1]:
        raise BadInput(f"{file}: column {twice[0]!r} appears twice; rename or remove one.")
    for row, line in enumerate(filled, start=1):
        if len(line) != len(header):
            said = f"row {row} has {len(line)} cells and the header {len(header)}"
            raise BadInput(f"{file}: {said}; correct or remove the row.")
    return Table(file, {name: [line[i] for line in filled] for i, name in enumerate(header)}, {})


def _read_json(file: Path, rows: str | None) -> Table:
    try:
        data = json.loads(file.read_text(encoding="utf-8"))
    except ValueError as error:  # also of a number with thousands of digits
        raise BadInput(f"{file}: not JSON ({error}); give another file.") from None
    header: dict[str, Any] = {}
    if isinstance(data, dict):
        header = {k: v for k, v in data.items() if not isinstance(v, list | dict)}
        data = _entries(file, data, rows)
    if isinstance(data, dict):
        lengths = {name: len(values) for name, values in data.items()}
        if len(set(lengths.values())) > 1:
            raise BadInput(f"{file}: lists of unequal length ({lengths}); make them equal.")
        return Table(file, data, header)
    return Table(file, _from_objects(file, data), header)


def _entries(file: Path, data: dict[str, Any], rows: str | None) -> Any:
    """The list of objects of a file with a header, or its lists."""
    lists = {name: value for name, value in data.items() if isinstance(value, list)}
    if rows is not None and rows not in lists:
        raise BadInput(f"{file}: --rows {rows!r} is not a list; {_there(lists)}.")
    if rows is not None:
        return lists[rows]
    nested = [name for name, value in lists.items() if value and isinstance(value[0], dict)]
    if len(nested) > 1:
        raise BadInput(f"{file}: several lists of entries ({', '.join(nested)}); name one: --rows.")
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


def _there(names: Mapping[str, Any] | Sequence[str]) -> str:
    return f"there are {', '.join(names)}" if names else "there is none"


def _scales(config: TableConfig) -> dict[str, float]:
    """Quantity -> size of the file's unit in SI."""
    scales = {}
    for unit in config.units:
        if unit not in UNITS:
            raise BadInput(f"--unit {unit}: unknown unit; allowed are {', '.join(UNITS)}.")
        quantity, scale = UNITS[unit]
        if quantity in scales:
            raise BadInput(f"--unit: {unit} is the second unit of {quantity}; give one of each.")
        scales[quantity] = _per_count(config) if unit == "counts" else scale
    return scales


def _per_count(config: TableConfig) -> float:
    if config.counts_per_turn is None or not config.counts_per_turn > 0:
        raise BadInput("--unit counts needs --counts-per-turn, a number above 0.")
    return 2 * np.pi / config.counts_per_turn


def _target(name: str) -> tuple[str, str]:
    """Column and quantity of a name in --map."""
    if MARKER.fullmatch(name):
        return f"{name}_m", "length"
    if name not in COLUMNS:
        raise BadInput(f"--map {name}: allowed are {', '.join(COLUMNS)}, marker0_x and so on.")
    return COLUMNS[name]


def _column(table: Table, name: str, source: str) -> Sequence[Any]:
    if source not in table.columns:
        missing = f"column {source!r} (--map {name}) is missing"
        raise BadInput(f"{table.file}: {missing}; {_there(table.columns)}.")
    return table.columns[source]


def _numbers(table: Table, name: str, values: Sequence[Any], gaps: bool) -> Array:
    """Finite numbers (n,); NaN for an empty cell where `gaps` are allowed."""
    found = np.array([_number(value) for value in values])
    empty = np.array([value is None or value == "" for value in values])
    bad = np.flatnonzero(~np.isfinite(found) & ~(empty & gaps))
    if bad.size:
        where = f"{table.file}: column {name}, row {bad[0] + 1}"
        said = f"{values[bad[0]]!r} is not a finite number"
        raise BadInput(f"{where}: {said}; correct or remove the row.")
    return found


def _number(value: Any) -> float:
    if isinstance(value, str) and value.lower() in WORDS:
        return WORDS[value.lower()]
    try:
        return float(value)
    except (TypeError, ValueError):
        return float("nan")


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


def _meta(table: Table, config: TableConfig) -> dict[str, str]:
    """The user's own words for the source, and the chosen metadata."""
    source = config.source or f"not stated; imported from {table.file.name}"
    return {"source": source} | {
        key: _meta_value(table, key, value) for key, value in config.meta.items()
    }


def _meta_value(table: Table, key: str, value: str) -> str:
    if value in table.header:
        return str(table.header[value])
    if key not in TEXTS and not np.isfinite(_number(value)):
        raise BadInput(
            f"{table.file}: --meta {key}={value}: not a number and not a header field;"
            f" {_there(table.header)}."
        )
    return value
