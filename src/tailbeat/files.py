"""Bad input and safe output: the lowest floor."""

import json
import math
import os
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import is_dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

# The extra that brings a package, by the name under which it is imported.
EXTRA_OF = {
    **dict.fromkeys(
        ("PIL", "imageio", "jinja2", "matplotlib", "mujoco", "numba", "polars", "scipy"), "sim"
    ),
    "cma": "identify",
    **dict.fromkeys(("gymnasium", "onnx", "psutil", "stable_baselines3"), "train"),
    **dict.fromkeys(("tensorboard", "torch"), "train"),
    **dict.fromkeys(("mcap", "serial"), "robot"),
    **dict.fromkeys(("cv2", "pyapriltags", "fastapi", "starlette", "uvicorn"), "station"),
    "websockets": "station",
}


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

    Makes the parent folder. Raises BadInput if `path` is a folder, lies where nothing can be
    written, or exists and `overwrite` is false.
    """
    target = Path(path)
    if not overwrite:
        refuse_existing(target)
    if target.is_dir():
        raise BadInput(f"{target}: is a folder; give the name of a file.")
    beside = _beside(target)
    try:
        yield beside
        os.replace(beside, target)
    finally:
        beside.unlink(missing_ok=True)


def _beside(target: Path) -> Path:
    """An empty hidden file in the target's folder, so that the rename is atomic."""
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=".", suffix=target.suffix, dir=target.parent)
    except OSError as error:
        raise BadInput(f"{target}: {error.strerror}; choose a place to write to.") from None
    os.close(handle)
    os.chmod(name, 0o644)  # mkstemp's own mode hides the file from others
    return Path(name)


def write_json(path: str | Path, data: Any, overwrite: bool = False) -> None:
    """Write `data` as JSON; records become mappings, numpy values lists and
    numbers, non-finite numbers null."""
    with new_file(path, overwrite) as beside:
        beside.write_text(json.dumps(plain(data), indent=2) + "\n", encoding="utf-8")


def plain(value: Any) -> Any:
    """What JSON can hold: mappings for records, lists for arrays and tuples, None for numbers that
    are not finite."""
    if is_dataclass(value):
        value = vars(value)
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if hasattr(value, "tolist"):  # an array or a number of numpy, which need not be loaded for it
        return plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def leaves(name: str, value: Any) -> dict[str, Any]:
    """Every leaf of nested lists and mappings by its dotted name."""
    if isinstance(value, dict | list | tuple):
        pairs = value.items() if isinstance(value, dict) else enumerate(value)
        parts = [leaves(f"{name}.{key}".lstrip("."), part) for key, part in pairs]
        return {key: leaf for part in parts for key, leaf in part.items()}
    return {name: value}


def need(what: str, *modules: str) -> None:
    """Raises BadInput where one of the packages that `what` takes from an extra is missing."""
    for module in modules:
        if find_spec(module) is None:
            raise BadInput(f"{what} needs {missing(module)}")


def missing(module: str) -> str:
    """How to install a package that is not there: the end of a sentence. Raises KeyError for a
    package that no extra brings."""
    return f"the package {module}: pip install 'tailbeat[{EXTRA_OF[module]}]'."
