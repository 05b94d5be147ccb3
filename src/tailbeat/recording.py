"""One time series type for everything measured or simulated, and its readers and writers.

On disk a recording is a CSV or Parquet table whose column names end in a unit. A CSV file has its
metadata in comment lines `# key: value`. The sampling period may vary.
"""

import csv
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray

from tailbeat.files import BadInput, new_file

Array = NDArray[np.float64]
SUFFIXES = (
    "_s _rad _deg _m _nm _n _m_s _m_s2 _rad_s _rad_s2 _v _a _k _hz _ms _px _counts _ratio".split()
)
# Columns of text. The last four are settings, which one file may change: as metadata they hold for
# all of it.
TEXTS = ("condition", "gain", "load", "load_mass_kg", "load_arm_m")
COMMENT = re.compile(r"# *(.+?):(?: (.*))?")  # `# key: value`; a value may be empty or hold colons


@dataclass(frozen=True, eq=False)
class Recording:
    """A named time series: `time` (n,) [s], rising; `columns` name -> (n,), in the suffix's unit.

    NaN is allowed only in marker columns, for a frame in which the marker was not seen. `labels`
    holds the text columns (`TEXTS`). `meta` is text by key. Time may start again where a text
    changes; otherwise it rises. Only reader and writer check this.
    """

    name: str
    time: Array
    columns: Mapping[str, Array]
    meta: Mapping[str, str] = field(default_factory=dict)
    labels: Mapping[str, NDArray[np.str_]] = field(default_factory=dict)


# ---- reading ------------------------------------------------------------------------------------


def read_recordings(paths: Sequence[str | Path]) -> list[Recording]:
    """Read recordings, and give those that share a file's name their folder's too: the same
    protocol may have been played on several days. Raises BadInput, also for a file given twice."""
    files = [Path(path) for path in paths]
    stems = [file.stem for file in files]
    refuse_shared({"the command": files})
    found = [read_recording(file) for file in files]
    return [
        replace(one, name=f"{file.absolute().parent.name}/{one.name}")
        if stems.count(file.stem) > 1
        else one
        for one, file in zip(found, files, strict=True)
    ]


def refuse_shared(groups: Mapping[str, Sequence[Path]]) -> None:
    """Raises BadInput for a file that an option names twice, or two options: what is fitted cannot
    be a test too."""
    owner: dict[Path, str] = {}
    for option, path in ((name, path) for name, paths in groups.items() for path in paths):
        before = owner.get(path.absolute())
        if before == option:
            raise BadInput(f"{path}: given twice; give each recording once.")
        if before is not None:
            raise BadInput(f"{path}: given to {before} and to {option}; give it to one of them.")
        owner[path.absolute()] = option


def read_recording(path: str | Path) -> Recording:
    """Read a recording: `.parquet` as Parquet, any other suffix as CSV. Empty cells of marker
    columns become NaN. Raises BadInput that names file, column, row and value."""
    file = Path(path)
    if not file.is_file():
        raise BadInput(f"{file}: no such file; give a recording as CSV or Parquet.")
    frame, meta = read_parquet(file) if file.suffix == ".parquet" else _read_csv(file)
    return _checked(file, frame, meta)


def _checked(file: Path, frame: pl.DataFrame, meta: Mapping[str, str]) -> Recording:
    """The table as a recording. The writer calls this too, so that every file can be read back."""
    if "time_s" not in frame.columns:
        names = ", ".join(frame.columns)
        if mark := next((mark for mark in ";\t" if mark in names), None):
            said = "semicolons" if mark == ";" else "tabs"
            raise BadInput(
                f"{file}: its cells are separated by {said}; a recording has commas. Read it with"
                f" `tailbeat import table`."
            )
        raise BadInput(f"{file}: column time_s is missing; there are {names}. Add the times [s].")
    if frame.height < 2:
        raise BadInput(f"{file}: {frame.height} rows; a recording needs at least 2.")
    numbers = {name: _numbers(file, frame, name) for name in frame.columns if name not in TEXTS}
    labels = {name: _words(file, frame[name]) for name in frame.columns if name in TEXTS}
    time = numbers.pop("time_s")
    _check_time(file, time, labels)
    return Recording(file.stem, time, numbers, meta, labels)


def read_parquet(file: Path) -> tuple[pl.DataFrame, dict[str, str]]:
    """A file's columns, and its metadata but for Arrow's. Raises BadInput if it is not Parquet, or
    damaged."""
    try:
        frame, meta = pl.read_parquet(file), pl.read_parquet_metadata(file)
    # some damage panics in polars, which is no Exception
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
        raise BadInput(
            f"{file}: not a Parquet file ({_first_line(error)}); give another."
        ) from None
    return frame, {key: text for key, text in meta.items() if key != "ARROW:schema"}


def _read_csv(file: Path) -> tuple[pl.DataFrame, dict[str, str]]:
    try:
        text = file.read_text(encoding="utf-8-sig")  # spreadsheets write a byte order mark
    except UnicodeDecodeError:
        raise BadInput(f"{file}: not text; give a CSV in UTF-8 or a .parquet file.") from None
    lines = text.split("\n")  # not splitlines: a text may contain other line separators
    found = [COMMENT.fullmatch(line.rstrip()) for line in lines if line.startswith("#")]
    meta = {match[1]: (match[2] or "").strip() for match in found if match}
    body = [line for line in lines if line.strip() and not line.startswith("#")]
    return _parse(file, body), meta


def _check_cells(file: Path, body: Sequence[str]) -> None:
    """Refuse repeated names and rows of another length: a missing cell is not an unseen marker."""
    cells = csv.reader(body)
    header = [name.strip() for name in next(cells, [])]
    for name in header:
        if header.count(name) > 1:
            raise BadInput(f"{file}: column {name!r} appears twice; rename or remove one.")
    for row, line in enumerate(cells, start=1):
        if len(line) != len(header):
            raise BadInput(
                f"{file}: not a table: row {row} has {len(line)} cells and the header"
                f" {len(header)}; correct or remove the row."
            )


def _parse(file: Path, body: Sequence[str]) -> pl.DataFrame:
    try:
        _check_cells(file, body)
        frame = pl.read_csv(io.StringIO("\n".join(body)), infer_schema=False)
    except (csv.Error, pl.exceptions.PolarsError) as error:
        raise BadInput(f"{file}: not a table ({_first_line(error)}); correct the CSV.") from None
    return frame.select(pl.all().str.strip_chars().replace("", None).name.map(str.strip))


def _first_line(error: BaseException) -> str:
    return str(error).splitlines()[0] if str(error) else type(error).__name__


def _numbers(file: Path, frame: pl.DataFrame, name: str) -> Array:
    """A column as floats. Raises BadInput at the first row that is not a finite number."""
    if not name.endswith(tuple(SUFFIXES)):
        raise BadInput(
            f"{file}: column {name!r} does not end in a unit; allowed are {' '.join(SUFFIXES)}."
        )
    text = frame[name]
    if not (text.dtype.is_numeric() or text.dtype in (pl.String, pl.Null)):
        raise BadInput(f"{file}: column {name} holds {text.dtype}; give numbers.")
    numbers = text.cast(pl.Float64, strict=False)
    unreadable = numbers.is_null() & text.is_not_null() | numbers.is_infinite() | numbers.is_nan()
    _refuse(file, text, unreadable.fill_null(False), "is not a finite number")
    if not is_marker(name):
        _refuse(file, text, numbers.is_null(), "is empty, which only marker columns may be")
    return numbers.fill_null(float("nan")).to_numpy().astype(float)


def _words(file: Path, column: pl.Series) -> NDArray[np.str_]:
    text = column.cast(pl.String)
    _refuse(file, text, text.is_null() | (text == ""), "is empty, which only marker columns may be")
    _refuse(file, text, text.str.contains(r"[\r\n]"), "is more than one line")
    return text.to_numpy().astype(str)


def _refuse(file: Path, text: pl.Series, bad: pl.Series, complaint: str) -> None:
    if bad.any():
        row = int(bad.arg_true()[0])
        value = "the cell" if text[row] in (None, "") else repr(text[row])
        raise BadInput(
            f"{file}: column {text.name}, row {row + 1}: {value} {complaint};"
            f" correct or remove the row."
        )


def is_marker(name: str) -> bool:
    """Whether a column is a marker's coordinate."""
    return re.match(r"marker\d+_", name) is not None


def changes(labels: Mapping[str, NDArray[np.str_]], rows: int) -> NDArray[np.bool_]:
    """Whether any text changes from a row to the next (rows - 1,)."""
    changed = np.zeros(rows - 1, dtype=bool)
    for column in labels.values():
        changed |= column[1:] != column[:-1]
    return changed


def _check_time(file: Path, time: Array, labels: Mapping[str, NDArray[np.str_]]) -> None:
    """Refuse time that does not rise, but for rows at which a text changes."""
    back = (np.diff(time) <= 0) & ~changes(labels, time.size)
    if back.any():
        row = int(np.argmax(back)) + 1
        words = [f"{name} {str(column[row])!r}" for name, column in labels.items()]
        within = f" within {', '.join(words)}" if words else ""
        raise BadInput(
            f"{file}: column time_s, row {row + 1}: {time[row]} does not come after"
            f" {time[row - 1]}{within}; time must rise. Sort the rows or remove the repeated one."
        )


# ---- writing ------------------------------------------------------------------------------------


def write_recording(recording: Recording, path: str | Path, overwrite: bool = False) -> None:
    """Write CSV or Parquet by suffix. Reading the file gives bit-identical numbers.

    Raises BadInput for another suffix, if the file exists, or if the recording could not be read
    back: NaN outside marker columns, a name without a unit, metadata of several lines.
    """
    if Path(path).suffix not in (".csv", ".parquet"):
        raise BadInput(f"{path}: a recording is written as .csv or .parquet; rename it.")
    series = {"time_s": recording.time, **recording.columns, **recording.labels}
    frame = pl.DataFrame(series).with_columns(pl.selectors.float().fill_nan(None))
    _checked(Path(path), frame, recording.meta)
    _check_meta(Path(path), recording.meta)
    with new_file(path, overwrite) as beside:
        if beside.suffix == ".parquet":
            frame.write_parquet(beside, metadata=dict(recording.meta))
            return
        heading = "".join(f"# {key}: {text}\n" for key, text in recording.meta.items())
        beside.write_text(heading + frame.write_csv(), encoding="utf-8")


def _check_meta(file: Path, meta: Mapping[str, str]) -> None:
    """Refuse metadata that a comment line cannot hold, in Parquet too: both formats are equal."""
    for key, text in meta.items():
        match = COMMENT.fullmatch(f"# {key}: {text}")  # a dot does not match a line's end
        if match is None or match[1] != key or "\r" in text:
            raise BadInput(
                f"{file}: metadata {key!r}: {text!r} does not fit `# key: value`; use one line, and"
                f" no colon before a space in the key."
            )


# ---- using --------------------------------------------------------------------------------------


def require(recording: Recording, names: Sequence[str]) -> tuple[Array, ...]:
    """The named columns, each (n,). Raises BadInput if one is missing or time starts again."""
    missing = [name for name in names if name not in recording.columns]
    if missing:
        raise BadInput(
            f"{recording.name}: column {', '.join(missing)} is missing; the recording"
            f" has {', '.join(['time_s', *recording.columns])}."
        )
    check_continuous(recording)
    return tuple(recording.columns[name] for name in names)


def check_continuous(recording: Recording) -> None:
    """Raises BadInput if time starts again within the recording."""
    back = np.flatnonzero(np.diff(recording.time) <= 0)
    if back.size:
        row = int(back[0]) + 1
        raise BadInput(
            f"{recording.name}: column time_s, row {row + 1}: time starts again, which is allowed"
            f" only in tail sweeps; give one file per condition."
        )


def rows(recording: Recording, which: slice | NDArray[np.bool_]) -> Recording:
    """The samples that `which`, a slice or a mask (n,), chooses."""
    columns = {name: column[which] for name, column in recording.columns.items()}
    labels = {name: column[which] for name, column in recording.labels.items()}
    return replace(recording, time=recording.time[which], columns=columns, labels=labels)


def markers(recording: Recording) -> tuple[Array, list[int]]:
    """Marker tracks (n, m, 2) [m], NaN where unseen, and the m markers' numbers in rising order.
    Raises BadInput if a marker has x and no y."""
    ends = [name[6:-4] for name in recording.columns if is_marker(name) and name.endswith("_x_m")]
    indices = sorted(int(end) for end in ends if end.isdigit())
    pairs = [
        np.stack(require(recording, [f"marker{k}_x_m", f"marker{k}_y_m"]), axis=1) for k in indices
    ]
    if not pairs:
        return np.empty((recording.time.size, 0, 2)), []
    return np.stack(pairs, axis=1), indices


def crop(recording: Recording, start: float, end: float) -> Recording:
    """The samples with start <= time <= end [s]. Raises BadInput if fewer than 2 are left."""
    check_continuous(recording)
    kept = (recording.time >= start) & (recording.time <= end)
    if kept.sum() < 2:
        raise BadInput(
            f"{recording.name}: {start:g}-{end:g} s has {kept.sum()} samples; choose a range with"
            f" at least 2 samples within {recording.time[0]:g}-{recording.time[-1]:g} s."
        )
    return rows(recording, kept)


def resample(recording: Recording, time: Array) -> Recording:
    """Linear interpolation at rising times `time` (k,) [s] (not checked). Columns in rad are
    unwrapped first; text columns are dropped. Raises BadInput outside the recording."""
    check_continuous(recording)
    if not np.all((time >= recording.time[0]) & (time <= recording.time[-1])):
        raise BadInput(
            f"{recording.name}: {time.min():g}-{time.max():g} s is not within the recording;"
            f" choose times within {recording.time[0]:g}-{recording.time[-1]:g} s."
        )
    columns = {
        name: np.interp(time, recording.time, np.unwrap(c) if name.endswith("_rad") else c)
        for name, c in recording.columns.items()
    }
    return replace(recording, time=time, columns=columns, labels={})


def uniform(recording: Recording, period: float) -> Recording:
    """Resample every `period` [s] from the first sample. Raises BadInput if it is not above 0."""
    if not period > 0:
        raise BadInput(f"{recording.name}: period {period:g} s; give one above 0.")
    first, last = recording.time[0], recording.time[-1]
    count = int((last - first) / period + 1e-9) + 1
    # Rounding may put the last sample past the end; `minimum` moves it back to the end.
    return resample(recording, np.minimum(first + period * np.arange(count), last))
