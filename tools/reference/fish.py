"""The page of the fish file: every field of its models."""

import typing
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

from pydantic import BaseModel, BeforeValidator
from pydantic.fields import FieldInfo

from reference.fields import described, summary
from reference.markdown import code, page, table
from tailbeat.fish.description import Fish
from tailbeat.fish.units import UNITS

HEAD = """A fish is a TOML file. `tailbeat new-fish my-fish.toml` writes a commented one.
The frame of every position is the fish frame at the straight pose: x towards the nose, y left,
z up, with one origin of your choice.

A quantity is written in one of three ways:

```toml
mass = "20 g"                                                        # a number and a unit
size = "220 70 110 mm"                                               # several numbers and a unit
k_eff = { value = 0.98, unit = "N m/rad", source = "tail bench" }    # with its source
```

A bare number is in the SI unit. An identified fish has `interval` beside `value`."""
COLUMNS = ["field", "value", "unit", "default", "allowed", "meaning"]
LIMITS = {"gt": ">", "ge": ">=", "lt": "<", "le": "<=", "min_length": ""}
WORDS = {str: "text", float: "number", int: "whole number", bool: "true or false"}


@dataclass(frozen=True)
class Table:
    """A table of the TOML file: its heading there, and the model that reads it."""

    heading: str
    model: type[BaseModel]


def fish_page() -> str:
    """The page: a section for each table of the file, then the units."""
    units = table(
        ["quantity", "units"],
        [[name, ", ".join(map(code, units))] for name, units in UNITS.items()],
    )
    return page("Fish file", HEAD, *map(_section, tables(Fish)), "## Units", units)


def tables(model: type[BaseModel], path: str = "") -> Iterator[Table]:
    """The model's own table, then those below it. A table that two bodies share comes once."""
    seen: set[type[BaseModel]] = set()
    waiting = [Table(path, model)]
    while waiting:
        one = waiting.pop(0)
        if one.model in seen:
            continue
        seen.add(one.model)
        yield one
        waiting[:0] = [_below(one, name, info) for name, info in _nested(one.model)]


def _nested(model: type[BaseModel]) -> list[tuple[str, FieldInfo]]:
    return [(name, info) for name, info in model.model_fields.items() if model_of(info)]


def _below(table_: Table, name: str, info: FieldInfo) -> Table:
    inner, shape = model_of(info), typing.get_origin(info.annotation) or object
    assert inner is not None
    bare = table_.heading.strip("[]")
    path = f"{bare}.{name}" if bare else name
    many: dict[Any, str] = {dict: f"[{path}.NAME]", tuple: f"[[{path}]]"}
    return Table(many.get(shape, f"[{path}]"), inner)


def model_of(info: FieldInfo) -> type[BaseModel] | None:
    """The model inside a field's type, if there is one."""
    return next((a for a in _leaves(info.annotation) if _is_model(a)), None)


def _is_model(one: Any) -> bool:
    return isinstance(one, type) and issubclass(one, BaseModel)


def _leaves(annotation: Any) -> Iterator[Any]:
    """A type and all types inside it; the metadata of `Annotated` come as they are."""
    yield annotation
    for inner in typing.get_args(annotation):
        yield from _leaves(inner)


def _section(one: Table) -> str:
    texts = described(one.model)
    rows = [_row(name, info, texts[name]) for name, info in one.model.model_fields.items()]
    heading = f"## `{one.heading}`" if one.heading else "## Top of the file"
    return "\n\n".join([heading, summary(one.model), table(COLUMNS, rows)])


def _row(name: str, info: FieldInfo, text: str) -> list[str]:
    return [code(name), kind(info), unit(info), _default(info), allowed(info), text]


def _default(info: FieldInfo) -> str:
    if info.is_required():
        return "required"
    if info.default is None or isinstance(info.default, BaseModel) or info.default == ():
        return "its defaults" if isinstance(info.default, BaseModel) else "none"
    if info.default == "":
        return "empty"
    return code(str(info.default).lower() if isinstance(info.default, bool) else info.default)


def dimension(info: FieldInfo) -> str:
    """The dimension of a quantity, such as `length`; empty for anything else."""
    for mark in (*info.metadata, *_leaves(info.annotation)):
        if isinstance(mark, BeforeValidator) and isinstance(mark.func, partial):
            return str(mark.func.keywords["dimension"])
    return ""


def unit(info: FieldInfo) -> str:
    """The SI unit of a quantity."""
    given = dimension(info)
    return code(next(iter(UNITS[given]))) if given else ""


def kind(info: FieldInfo) -> str:
    """What a value is, in words."""
    if model_of(info):
        several = typing.get_origin(info.annotation) in (tuple, dict)
        return "tables" if several else "table"
    leaves = list(_leaves(info.annotation))
    if any(typing.get_origin(one) is tuple for one in leaves):
        return "numbers"
    found = [WORDS[one] for one in leaves if one in WORDS]
    texts = ["text"] if any(typing.get_origin(one) is typing.Literal for one in leaves) else []
    return " or ".join(dict.fromkeys([*texts, *found]))


def allowed(info: FieldInfo) -> str:
    """Bounds in SI, names to choose from, and how many."""
    given = [(n, getattr(m, n)) for m in info.metadata for n in LIMITS if hasattr(m, n)]
    bounds = [f"{LIMITS[n]} {v:g}" for n, v in given if n != "min_length"]
    few = [f"{v} or more" for n, v in given if n == "min_length"]
    literal = [a for a in _leaves(info.annotation) if typing.get_origin(a) is typing.Literal]
    names = [code(name) for one in literal for name in typing.get_args(one)]
    return ", ".join([*bounds, *few, *names])
