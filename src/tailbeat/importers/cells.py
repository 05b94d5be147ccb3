"""Convert the columns of an imported table to SI units, or say which cell is wrong."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.files import BadInput
from tailbeat.importers.settings import NUMBERS, allowed, fits, positive

Array = NDArray[np.float64]
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
    "kg": ("mass", 1.0),
    "g": ("mass", 1e-3),
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
    "load_mass": ("load_mass_kg", "mass"),
    "load_arm": ("load_arm_m", "length"),
}
MARKER = re.compile(r"marker\d+_[xy]")
WORDS = {"true": 1.0, "false": 0.0}
LINE_END = re.compile(r"[\r\n]")
DECIMAL_COMMA = re.compile(r"[-+]?[\d.]*,\d+([eE][-+]?\d+)?")
DIGITS = 12  # of a setting: no lab knows more, and 7 cm is written as 0.07 m


@dataclass(frozen=True)
class Cells:
    """One column of a file, unconverted: `name` in --map, `header` and `values` in the file."""

    file: Path
    name: str
    header: str
    values: Sequence[Any]


def unit_scales(units: Sequence[str], counts_per_turn: float | None) -> dict[str, float]:
    """Quantity -> size of the file's unit in SI. Raises BadInput that names the option."""
    scales: dict[str, float] = {}
    for unit in units:
        if unit not in UNITS:
            raise BadInput(f"--unit {unit}: unknown unit; allowed are {', '.join(UNITS)}.")
        quantity, scale = UNITS[unit]
        if quantity in scales:
            raise BadInput(f"--unit: {unit} is the second unit of {quantity}; give one of each.")
        scales[quantity] = _per_count(counts_per_turn) if unit == "counts" else scale
    return scales


def _per_count(counts_per_turn: float | None) -> float:
    if counts_per_turn is None or not 0 < counts_per_turn < np.inf:
        raise BadInput("--unit counts needs --counts-per-turn, a finite number above 0.")
    return 2 * np.pi / counts_per_turn


def target(name: str) -> tuple[str, str]:
    """Column and quantity of a name in --map. Raises BadInput for an unknown name."""
    if MARKER.fullmatch(name):
        return f"{name}_m", "length"
    if name not in COLUMNS:
        raise BadInput(f"--map {name}: allowed are {', '.join(COLUMNS)}, marker0_x and so on.")
    return COLUMNS[name]


def numbers(cells: Cells, scale: float) -> Array:
    """Finite numbers (n,) times `scale`; NaN for an empty cell of a marker column. Raises BadInput
    that names file, column, row and value."""
    found = np.array([number(value) for value in cells.values])
    empty = np.array([_is_empty(value) for value in cells.values])
    gaps = MARKER.fullmatch(cells.name) is not None
    bad = np.flatnonzero(~np.isfinite(found) & ~(empty & gaps))
    if bad.size:
        _refuse(cells, int(bad[0]), "is not a finite number")
    return found * scale


def texts(cells: Cells, scale: float) -> NDArray[np.str_]:
    """Words (n,); numbers above 0, times `scale`, for a setting that is a number. Raises BadInput
    that names file, column, row and value."""
    key, _ = target(cells.name)
    for row, value in enumerate(cells.values):
        if _is_empty(value):
            _refuse(cells, row, "is empty, which only marker columns may be")
        if not fits(key, str(value)):
            _refuse(cells, row, f"is not {allowed(key)}")
        if LINE_END.search(str(value)):
            _refuse(cells, row, "is more than one line")
    if key in NUMBERS:
        return np.array([f"{scale * positive(value):.{DIGITS}g}" for value in cells.values])
    return np.array([str(value) for value in cells.values])


def number(value: object) -> float:
    """A cell as a number, also true and false; NaN for anything else."""
    if isinstance(value, str) and value.lower() in WORDS:
        return WORDS[value.lower()]
    try:
        return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):  # the last of a number with hundreds of digits
        return float("nan")


def _is_empty(value: object) -> bool:
    """Whether a cell holds nothing: pandas writes NaN for it, in Parquet and in JSON."""
    return value is None or value == "" or (isinstance(value, float) and np.isnan(value))


def _refuse(cells: Cells, row: int, complaint: str) -> None:
    where, value = f"{cells.file}: column {cells.header}, row {row + 1}", cells.values[row]
    if isinstance(value, str) and DECIMAL_COMMA.fullmatch(value):
        said = f"{value!r} has a decimal comma, which is not read"
        raise BadInput(f"{where}: {said}; write decimal points in the whole file.")
    said = "the cell" if complaint.startswith("is empty") else repr(value)
    raise BadInput(f"{where}: {said} {complaint}; correct or remove the row.")
