"""Report bad input, and write files safely."""

import errno
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
    "ray": "cluster",
}

FULL = (errno.ENOSPC, errno.EDQUOT)  # of a disk, of a user's share of it


class BadInput(ValueError):
    """Something the user gave cannot be used.

    The message is one or two sentences: which file or field, which value, what is allowed, what to
    do. The command line prints it and exits with code 2.
    """


def refuse_existing(path: Path) -> None:
    """Raises BadInput if an output path exists, also as a link to nothing, or if nothing can be
    written there. Call it before the work begins."""
    if _is_there(path):
        raise BadInput(f"{path}: exists already; choose another name or move it away.")
    check_folder(path.parent)


def check_json(path: Path | None, folder: Path = Path(), *own: str) -> None:
    """Raises BadInput if the file of --json, None for none, exists, or if it is, contains or is
    inside one of the files and folders `own` that the command itself writes into its `folder`. Call
    it before the work begins."""
    if path is None:
        return
    given = Path(os.path.realpath(path))
    for name in own:
        one = Path(os.path.realpath(folder / name))
        if given.is_relative_to(one) or one.is_relative_to(given):
            said = f"--json {path}: the command itself writes {folder / name}"
            raise BadInput(f"{said}; choose another file.")
    refuse_existing(path)


def check_folder(path: Path) -> None:
    """Raises BadInput if a path is no folder to write in, and cannot become one. Call it before the
    work begins."""
    above = next((one for one in (path, *path.parents) if _is_there(one)), Path())
    if not above.is_dir():
        raise BadInput(f"{path}: {above} is not a folder; choose a folder you can write to.")
    if not os.access(above, os.W_OK | os.X_OK):
        raise BadInput(f"{path}: Permission denied; choose a folder you can write to.")


def _is_there(path: Path) -> bool:
    """Whether a path exists. Raises BadInput if none can."""
    try:
        path.lstat()
    except (FileNotFoundError, NotADirectoryError):
        return False
    except OSError as error:
        raise BadInput(f"{path}: {error.strerror}; choose another path.") from None
    except ValueError:  # a character that no file system takes
        raise BadInput(f"{path}: has a character that no path has; choose another.") from None
    return True


@contextmanager
def new_file(path: str | Path, overwrite: bool = False) -> Iterator[Path]:
    """A temporary path beside `path` to write to: renamed to it on success, removed on any failure.

    Makes the parent folder. Raises BadInput if `path` is a folder, if nothing can be written there,
    or if it exists and `overwrite` is false.
    """
    target = Path(path)
    if not overwrite:
        refuse_existing(target)
    if target.is_dir():
        raise BadInput(f"{target}: is a folder; give a file name.")
    beside = _beside(target)
    try:
        yield beside
        os.replace(beside, target)
    except OSError as error:
        if error.errno in FULL and not error.filename:
            raise BadInput(f"{target}: {error.strerror}; free some space, then repeat.") from None
        raise
    finally:
        beside.unlink(missing_ok=True)


def _beside(target: Path) -> Path:
    """An empty hidden file in the target's folder, so that the rename is atomic."""
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=".", suffix=target.suffix, dir=target.parent)
    except OSError as error:
        raise BadInput(f"{target}: {error.strerror}; choose a folder you can write to.") from None
    os.close(handle)
    os.chmod(name, 0o644)  # mkstemp's own mode hides the file from others
    return Path(name)


def write_secret(path: Path, secret: bytes) -> None:
    """Write a short secret to a new file that only its owner may read, from its first byte on.

    No copy is made beside it, which a crash would leave. Makes the parent folder. Raises BadInput
    if the file exists, or if nothing can be written there.
    """
    refuse_existing(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except OSError as error:
        raise BadInput(f"{path}: {error.strerror}; choose a folder you can write to.") from None
    try:
        with open(handle, "wb", buffering=0) as file:
            file.write(secret)
            os.fsync(file.fileno())
    except OSError as error:
        path.unlink()
        raise BadInput(f"{path}: {error.strerror}; nothing is left there.") from None


def write_json(path: str | Path, data: Any, overwrite: bool = False) -> None:
    """Write `data` as JSON. Dataclasses become mappings, numpy values lists and numbers, numbers
    that are not finite null. Raises BadInput as `new_file` does."""
    with new_file(path, overwrite) as beside:
        beside.write_text(json.dumps(plain(data), indent=2) + "\n", encoding="utf-8")


def put_json(path: Path | None, data: Any) -> None:
    """Write the file of --json, unless it is None."""
    if path is not None:
        write_json(path, data)


def plain(value: Any) -> Any:
    """`value` as JSON can hold it: mappings for dataclasses, lists for arrays and tuples, None for
    numbers that are not finite."""
    if is_dataclass(value):
        value = vars(value)
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if hasattr(value, "tolist"):  # an array or a number of numpy, without importing numpy
        return plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def leaves(name: str, value: Any) -> dict[str, Any]:
    """Every value in nested lists and mappings, by its dotted name below `name`."""
    if isinstance(value, dict | list | tuple):
        pairs = value.items() if isinstance(value, dict) else enumerate(value)
        parts = [leaves(f"{name}.{key}".lstrip("."), part) for key, part in pairs]
        return {key: leaf for part in parts for key, leaf in part.items()}
    return {name: value}


def need(what: str, *modules: str) -> None:
    """Raises BadInput if one of the packages `modules`, which `what` needs, is not installed."""
    for module in modules:
        if find_spec(module) is None:
            raise BadInput(f"{what} needs {missing(module)}")


def missing(module: str) -> str:
    """How to install a missing package, as the end of a sentence. Raises KeyError for a package
    that no extra brings."""
    return f"the package {module}: pip install 'tailbeat[{EXTRA_OF[module]}]'."
