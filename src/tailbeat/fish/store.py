"""Find, read, change and write descriptions of fish. Every error is one sentence."""

import hashlib
import json
import tomllib
from collections.abc import Mapping
from difflib import get_close_matches
from importlib import resources
from pathlib import Path
from typing import Any, NotRequired, TypedDict

import tomlkit
from pydantic import ValidationError

from tailbeat.files import BadInput, leaves, new_file, refuse_existing
from tailbeat.fish.description import Fish, Hardware
from tailbeat.fish.lab import Lab

PAPER = "pulley-fish"  # the paper's fish
ENDS = (".interval.0", ".interval.1")


class Entry(TypedDict):
    """An identified number as a description holds it: in `unit`, with its 95 % interval."""

    value: float
    unit: str
    interval: NotRequired[list[float]]
    source: str


Entries = Mapping[str, Entry | str]  # by a field's dotted path


def shipped() -> list[str]:
    """Names of the fish that come with the package."""
    folder = resources.files("tailbeat.fish") / "models"
    return sorted(Path(str(f)).stem for f in folder.iterdir() if str(f).endswith(".toml"))


def fish_path(name_or_path: str | Path) -> Path:
    """Path of a shipped fish by its name, else of a file. Raises BadInput if there is neither."""
    if str(name_or_path) in shipped():
        return Path(str(resources.files("tailbeat.fish") / "models" / f"{name_or_path}.toml"))
    path = Path(name_or_path)
    if not path.is_file():
        names = ", ".join(shipped())
        raise BadInput(f"{name_or_path}: no such fish; give a TOML file or one of {names}.")
    return path


def load_fish(name_or_path: str | Path) -> Fish:
    """Read a fish by a shipped name or from a file. Raises BadInput that names file and field."""
    path = fish_path(name_or_path)
    try:
        return Fish.model_validate(_toml(path))
    except ValidationError as error:
        raise BadInput(f"{path}: {_sentence(error)}") from None


def lab_in(path: Path) -> Lab:
    """The table `[lab]` of a TOML file, a fish's or one of its own. Raises BadInput that names file
    and field."""
    if not path.is_file():
        raise BadInput(f"{path}: no such file; give a TOML file with a table [lab].")
    table = _toml(path).get("lab")
    if not isinstance(table, dict) or not table:
        raise BadInput(f'{path}: no table [lab] in it; add one with lines such as slack = "4 deg".')
    try:
        return Lab.model_validate(table)
    except ValidationError as error:
        raise BadInput(f"{path}: lab: {_of_lab(error)}") from None


def _of_lab(error: ValidationError) -> str:
    """The first error of a table `[lab]`; for an unknown field also the known ones like it."""
    first, known = error.errors()[0], list(Lab.model_fields)
    if first["type"] != "extra_forbidden":
        return _sentence(error)
    field = str(first["loc"][0])
    near = get_close_matches(field.replace(" ", "_"), known, n=2) or known
    return f"unknown field {field}; remove it, or use {' or '.join(near)}."


def _toml(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except ValueError as error:  # also of a number with thousands of digits
        raise BadInput(f"{path}: not valid TOML ({error}); correct that line.") from None


def fish_of(content: Mapping[str, Any]) -> Fish:
    """A fish from its `model_dump`, in SI. Raises BadInput for one that this version cannot
    read."""
    try:
        return Fish.model_validate(content)
    except ValidationError as error:
        told = isinstance(content, Mapping)
        named = content.get("name", "without a name") if told else "that is no table"
        raise BadInput(f"fish {named}: {_sentence(error)}") from None


def _sentence(error: ValidationError) -> str:
    """The first error of pydantic as: field, value, what is allowed."""
    first = error.errors()[0]
    field = ".".join(map(str, first["loc"])) or "the fish"
    message = first["msg"].removeprefix("Value error, ").rstrip(".")
    if first["type"] == "extra_forbidden":
        return f"unknown field {field}; remove it or see `tailbeat new-fish` for the known ones."
    if first["type"] == "missing":
        return f"field {field} is missing; add it (see `tailbeat new-fish`)."
    value = "" if isinstance(first["input"], dict | Fish) else f" = {first['input']!r}"
    return f"{field}{value}: {message}; correct it in the file."


def hardware_of(fish: Fish) -> Hardware:
    """Maker's numbers of a fish's servo: its own, else those of the paper's XW430-T200."""
    found = fish.hardware or load_fish(PAPER).hardware
    assert found is not None
    return found


def with_servo(fish: Fish, servo: str | None) -> Fish:
    """The fish with another of its servos; None leaves it as described. Raises BadInput if it has
    no servo of this name."""
    if servo is not None and servo not in fish.servos:
        raise BadInput(
            f"--servo {servo!r}: not a servo of {fish.name}; give one of {', '.join(fish.servos)}."
        )
    return fish.model_copy(update={"servo": servo or fish.servo})


def with_values(fish: Fish, values: dict[str, float]) -> Fish:
    """A copy of the fish with fields set by dotted path, such as `zones.fin.kutta`, in SI.

    Raises BadInput for a path that the description does not have or a value that it does not allow.
    """
    tree = fish.model_dump()
    for path, value in values.items():
        *stem, leaf = path.split(".")
        node: Any = tree
        for key in stem:
            node = node[int(key)] if isinstance(node, tuple | list) else node.get(key, {})
        if leaf not in node:
            raise BadInput(f"{fish.name}: no field {path}; see `tailbeat show` for the fields.")
        node[leaf] = value
    try:
        return Fish.model_validate(tree)
    except ValidationError as error:
        raise BadInput(f"{fish.name}: {_sentence(error)}") from None


def value_at(fish: Fish, path: str) -> float:
    """The number at a dotted path, in SI. The path is not checked: a wrong one raises KeyError,
    IndexError or TypeError."""
    node: Any = fish.model_dump()
    for key in path.split("."):
        node = node[int(key)] if isinstance(node, tuple | list) else node[key]
    return float(node)


def new_fish(path: Path) -> None:
    """Write the commented template. Raises BadInput if `path` exists or does not end in .toml."""
    check_fish_name(path)
    text = (resources.files("tailbeat.fish") / "models" / "template.txt").read_text("utf-8")
    with new_file(path) as beside:
        beside.write_text(text.replace("my-fish", path.stem), encoding="utf-8")


def check_new_fish(path: Path) -> None:
    """Raises BadInput for a path that exists or does not end in .toml."""
    check_fish_name(path)
    refuse_existing(path)


def check_fish_name(path: Path) -> None:
    """Raises BadInput for a path that does not end in .toml."""
    if path.suffix != ".toml":
        raise BadInput(f"{path}: a fish is a TOML file; give a name that ends in .toml.")


def write_identified(
    source: str | Path,
    target: Path,
    values: Entries,
    note: str,
    overwrite: bool = False,
) -> None:
    """Copy the description at `source` to `target` with fields replaced and all comments kept.

    `values` are in SI, or text. `note` is written first, line by line, as comments. Raises BadInput
    if `target` exists and `overwrite` is false.
    """
    document = tomlkit.parse(fish_path(source).read_text(encoding="utf-8-sig"))
    for path, entry in values.items():
        *stem, leaf = path.split(".")
        node: Any = document
        for key in stem:
            node = node[int(key)] if isinstance(node, list) else _child(node, key)
        node[leaf] = entry if isinstance(entry, str) else _inline(entry)
        if stem and all(".".join([*stem, key]) in values for key in node):
            node.trivia.comment = ""  # it described the numbers that were replaced
    heading = "".join(f"# {line}\n" for line in note.splitlines())
    with new_file(target, overwrite) as beside:
        beside.write_text(heading + tomlkit.dumps(document), encoding="utf-8")


def intervals(name_or_path: str | Path) -> dict[str, tuple[float, float]]:
    """The 95 % interval (low, high) of every identified number of a fish's file, in SI, by dotted
    path. Raises BadInput as `load_fish`."""
    written, fish = leaves("", _toml(fish_path(name_or_path))), load_fish(name_or_path)
    found = {}
    for name in (one for one in written if one.endswith(ENDS[0])):
        path = name.removesuffix(ENDS[0])
        low, high, own = (written[path + end] for end in (*ENDS, ".value"))
        scale = value_at(fish, path) / own if own else 1.0  # they are written in SI
        found[path] = (scale * low, scale * high)
    return found


def _child(node: Any, key: str) -> Any:
    """A table inside a table, made if need be (`setdefault` would lose what is added later)."""
    if key not in node:
        node[key] = tomlkit.table()
    return node[key]


def _inline(entry: Entry) -> tomlkit.items.InlineTable:
    table = tomlkit.inline_table()
    table.update(entry)
    return table


def digest(fish: Fish) -> str:
    """Digest of all numbers and names of a fish that its twin depends on: without its summary, the
    maker's numbers of its servo, the lab's figures, its tag's size, and which parts are flooded. A
    policy's contract has it, to recognise the fish."""
    aside = {"summary", "hardware", "lab", "tag"}
    content = _without(fish.model_dump(mode="json", exclude=aside), "flooded")
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:16]


def _without(node: Any, name: str) -> Any:
    """Nested tables and lists without every key `name`."""
    if isinstance(node, dict):
        return {key: _without(value, name) for key, value in node.items() if key != name}
    return [_without(value, name) for value in node] if isinstance(node, list) else node
