"""Bad input and safe output: the lowest floor."""

import json
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np


class BadInput(ValueError):
    """Something the user gave cannot be used.

    The message is one sentence: which file or field, which value, what is allowed, what to do. The
    command line prints it and exits with 2.
    """


def refuse_existing(path: Path) -> None:
    """Raise BadInput if an output path is taken, before any work is spent on it."""
    if path.exists():
        raise BadInput(f"{path}: exists already; choose another name or move it away.")


@contextmanager
def new_file(path: str | Path, overwrite: bool = False) -> Iterator[Path]:
    """A path beside `path` to write to; renamed onto it on success, removed on any failure.

    Makes the parent folder. Raises BadInput if `path` exists and `overwrite` is false.
    """
    target = Path(path)
    if not overwrite:
        refuse_existing(target)
    target.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=".", suffix=target.suffix, dir=target.parent)
    os.close(handle)
    os.chmod(name, 0o644)  # mkstemp's own mode hides the file from others
    try:
        yield Path(name)
        os.replace(name, target)
    finally:
        Path(name).unlink(missing_ok=True)


def write_json(path: str | Path, data: Any, overwrite: bool = False) -> None:
    """Write `data` as JSON; numpy values become lists and numbers, non-finite numbers null."""
    with new_file(path, overwrite) as beside:
        beside.write_text(json.dumps(_plain(data), indent=2) + "\n", encoding="utf-8")


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value
