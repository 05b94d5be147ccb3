"""What a sweep trains: a TOML file, and the trials that follow from it."""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal, get_type_hints

from pydantic import BaseModel, ConfigDict, Field, NonNegativeInt, TypeAdapter, ValidationError

from tailbeat.files import BadInput
from tailbeat.train.recipes import RECIPES, TASKS, Recipe

CHANGEABLE = {
    name: kind
    for name, kind in get_type_hints(Recipe).items()
    if name not in ("name", "quick", "rates", "stages", "task")
}  # fields of a recipe that a sweep may vary


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class Varied(_Part):
    """What trials differ in: every combination is one trial. An empty list takes the default of
    `tailbeat train`."""

    fish: tuple[str, ...] = Field(min_length=1)
    recipe: tuple[str, ...] = ("quick",)
    task: tuple[str, ...] = ("reach",)
    actions: tuple[str, ...] = ()
    servo: tuple[str, ...] = ()
    binds: tuple[Literal["fundamental", "signal"], ...] = ()
    floor: tuple[float, ...] = ()
    centre: tuple[float, ...] = ()
    physics: tuple[Literal["ranges", "posterior"], ...] = ()
    imu: tuple[Literal["bno055", "none"], ...] = ()
    mess: tuple[Literal["clean", "everyday", "rough", "wrecked"], ...] = ()
    build: tuple[Literal["clean", "everyday", "rough", "wrecked"], ...] = ()
    hard: tuple[Literal["clean", "everyday", "rough", "wrecked"], ...] = ()
    velocities: tuple[bool, ...] = ()
    averages: tuple[bool, ...] = ()
    seed: tuple[NonNegativeInt, ...] = Field(default=(0,), min_length=1)


class Tried(_Part):
    """Swims in the twin after a training: `targets` up to `arc` [deg] to either side."""

    targets: int = Field(default=200, ge=1)
    arc: float = Field(default=180.0, gt=0, le=180)


class Evaluated(_Part):
    """Swims in the virtual pool after a training: the pool's fish, its waters, and `episodes`, each
    in open water and inside walls; with `messy` also in labs of every level of `pool.mess`."""

    fish: str = "pulley-fish"
    pool: str = "full"
    episodes: int = Field(default=50, ge=2)
    messy: bool = False


class Sweep(_Part):
    """A sweep's file. `hours` is the longest training of a trial, `checkpoint_minutes` the time
    between two checkpoints; `cores` are a trial's own; with `gpus`, the part of a GPU that it
    takes, updates run there. A trial that fails is begun again up to `retries` times.
    `scheduler` ends hopeless trials early."""

    vary: Varied
    recipe: dict[str, Annotated[list[Any], Field(min_length=1)]] = Field(default_factory=dict)
    trial: Tried = Field(default_factory=Tried)
    evaluate: Evaluated | None = None
    hours: float = Field(default=12.0, gt=0)
    checkpoint_minutes: float = Field(default=5.0, gt=0)
    cores: int = Field(default=1, ge=1)
    gpus: float = Field(default=0.0, ge=0, le=1)
    retries: int = Field(default=2, ge=0)
    scheduler: Literal["none", "asha", "median"] = "none"


@dataclass(frozen=True)
class Trial:
    """One training: a value for each field of `Varied` (None: the default), and the recipe's fields
    that are `changed`. `name` is that of its folder; `group` is the name without the seed."""

    name: str
    group: str
    fish: str
    recipe: str
    task: str
    actions: str | None
    servo: str | None
    binds: str | None
    floor: float | None
    centre: float | None
    physics: str | None
    imu: str | None
    mess: str | None
    build: str | None
    hard: str | None
    velocities: bool | None
    averages: bool | None
    seed: int
    changed: Mapping[str, float | str | bool]


def read(path: Path) -> Sweep:
    """Read a sweep's file. Raises BadInput for a field that is missing, wrong or unknown."""
    try:
        held = tomllib.loads(path.read_text("utf-8"))
    except OSError as error:
        raise BadInput(f"{path}: {error.strerror}; give a sweep's .toml file.") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise BadInput(f"{path}: not TOML: {error}.") from None
    try:
        found = Sweep.model_validate(_as_tuples(held))
    except ValidationError as error:
        raise BadInput(f"{path}: {_said(error)}") from None
    _check(path, found)
    return found


def _as_tuples(held: dict[str, Any]) -> dict[str, Any]:
    """The file's lists below `vary` as tuples, and a single value as a list of one."""
    lists: dict[str, dict[str, Any]] = {
        table: {k: v if isinstance(v, list) else [v] for k, v in own.items()}
        for table in ("vary", "recipe")
        if isinstance(own := held.get(table), dict)
    }
    if "vary" in lists:
        lists["vary"] = {k: tuple(v) for k, v in lists["vary"].items()}
    return held | lists


def _said(error: ValidationError) -> str:
    first = error.errors()[0]
    where = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        return f"field {where} is unknown; docs/how-to/train-on-a-cluster.md lists the fields."
    if first["type"] == "missing":
        return f"field {where} is missing; docs/how-to/train-on-a-cluster.md lists the fields."
    return f"field {where} = {first['input']!r}: {first['msg'].lower()}."


def _check(path: Path, sweep: Sweep) -> None:
    """Raises BadInput for a recipe, task or recipe's field that is none, and equal values."""
    for field, allowed in (("recipe", tuple(RECIPES)), ("task", TASKS)):
        for one in getattr(sweep.vary, field):
            if one not in allowed:
                raise BadInput(
                    f"{path}: field vary.{field} = {one!r}: allowed are {', '.join(allowed)}."
                )
    for name, values in sweep.recipe.items():
        if name not in CHANGEABLE:
            raise BadInput(
                f"{path}: field recipe.{name} is unknown; allowed are {', '.join(CHANGEABLE)}."
            )
        for value in values:
            _check_kind(path, name, value)
    lists = {**vars(sweep.vary), **sweep.recipe}
    for name, values in lists.items():
        if len({repr(one) for one in values}) < len(values):
            raise BadInput(f"{path}: field {name}: a value stands there twice; leave one out.")


def _check_kind(path: Path, name: str, value: Any) -> None:
    try:
        TypeAdapter(CHANGEABLE[name]).validate_python(value, strict=not isinstance(value, int))
    except ValidationError as error:
        raise BadInput(
            f"{path}: field recipe.{name} = {value!r}: {error.errors()[0]['msg'].lower()}."
        ) from None


def trials(sweep: Sweep) -> list[Trial]:
    """Every combination, seeds last, so that trials of one kind stand together."""
    names = [field.name for field in fields(Trial)][2:-2]
    values = [getattr(sweep.vary, name) or (None,) for name in names]
    changes = [dict(zip(sweep.recipe, one, strict=True)) for one in product(*sweep.recipe.values())]
    found = []
    for *row, changed, seed in product(*values, changes, sweep.vary.seed):
        own = dict(zip(names, row, strict=True))
        group = _named(sweep, own, changed)
        found.append(Trial(f"{group}-seed-{seed}", group, **own, seed=seed, changed=changed))
    return found


def _named(sweep: Sweep, own: Mapping[str, Any], changed: Mapping[str, Any]) -> str:
    """A name from the fields that differ between trials; the fish's where none does."""
    parts = [
        _word(name, own[name])
        for name in own
        if name != "fish" and len(getattr(sweep.vary, name)) > 1
    ]
    parts += [_word(name, changed[name]) for name in changed if len(sweep.recipe[name]) > 1]
    if not parts or len(sweep.vary.fish) > 1:
        parts.insert(0, Path(own["fish"]).stem)
    return "-".join(parts)


def _word(name: str, value: Any) -> str:
    return value if isinstance(value, str) else f"{name}-{value}"


def check_names(path: Path, made: Sequence[Trial]) -> None:
    """Raises BadInput if two trials would have one folder."""
    names = [one.name for one in made]
    for name in names:
        if names.count(name) > 1:
            raise BadInput(f"{path}: two trials are called {name}; give their fish other names.")


def as_row(trial: Trial) -> dict[str, Any]:
    """The fields of a trial that are not defaults, for tables."""
    return {
        name: value
        for name, value in (asdict(trial) | dict(trial.changed)).items()
        if value is not None and name not in ("changed", "group")
    }
