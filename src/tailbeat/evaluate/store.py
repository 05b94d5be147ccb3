"""A folder of runs on disk: its description, and the swims of every condition.

A condition is swum in chunks. Each is a file, written beside and renamed, so a trial that was cut
short can be read up to its end.
"""

import json
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import TypeAdapter, ValidationError

from tailbeat.control.measure import Measure
from tailbeat.evaluate.runs import Runs
from tailbeat.files import BadInput, leaves, new_file, plain, write_json
from tailbeat.fish.description import Fish
from tailbeat.fish.store import fish_of

DESCRIPTION, TWIN = "run.json", "trained-on.json"
REPEAT = "repeat the command that wrote it, into a new folder."
# Names in folders of earlier versions.
DESCRIPTION_BEFORE = "plan.json"
RENAMED, RENAMED_FILE = ("beyond ", "out of distribution: "), ("beyond-", "out-of-distribution-")
T = TypeVar("T")


@dataclass(frozen=True)
class RunDescription:
    """Description of a folder's runs.

    Digest of the `policy`, kind of its `actions`, its `band` [Hz] and `training` from its contract;
    the `twin` that it was trained in; `fish` and `water` of the pool with their digests; the seed,
    swims per condition (`episodes`), walls (length, width) [m], the number of swims of each of the
    `conditions`, the fish's `measure`, the fingerprint of the `mess`, and its level in the `lab` of
    every swim of the task track.
    """

    policy: str
    actions: str
    band: tuple[float, float]
    training: Mapping[str, object]
    twin: str
    fish: str
    fish_digest: str
    water: str
    waters: int
    seed: int
    episodes: int
    walls: tuple[float, float]
    conditions: Mapping[str, int]
    measure: Measure = field(default_factory=Measure)
    mess: str = ""
    lab: str = "clean"


def begin(out: Path, wanted: RunDescription) -> None:
    """Write the description. Raises BadInput if the folder has other runs."""
    if not has_runs(out):
        if out.exists() and any(out.iterdir()):
            raise BadInput(f"{out}: contains other files; choose a new folder.")
        write_json(out / DESCRIPTION, wanted)
        return
    held, asked = (leaves("", plain(one)) for one in (read_description(out), wanted))
    # a later version knows more conditions: what is there is gone on with
    new = {name for name in set(asked) - set(held) if name.startswith("conditions")}
    new |= set() if held["mess"] else {"mess"}
    names = sorted(
        (set(held) | set(asked)) - new, key=lambda name: (name.startswith("conditions"), name)
    )
    wrong = [name for name in names if held.get(name) != asked.get(name)]
    if wrong:
        said = [f"{name} was {held.get(name)}, now {asked.get(name)}" for name in wrong[:3]]
        more = f" and {len(wrong) - 3} more" if len(wrong) > 3 else ""
        raise BadInput(
            f"{out}: contains other runs: {'; '.join(said)}{more}. Use the same options, or a new"
            f" folder."
        )
    if new:
        write_json(out / DESCRIPTION, wanted, overwrite=True)


def keep_fish(out: Path, twin: Fish) -> None:
    """Keep the fish that a folder's policy was trained on, for the page."""
    write_json(out / TWIN, twin.model_dump(mode="json"), overwrite=True)


def kept_fish(out: Path) -> Fish | None:
    """The fish that a folder's policy was trained on; None in folders of releases up to
    0.2.0. Raises BadInput."""
    path = out / TWIN
    return fish_of(read_json(path)) if path.is_file() else None


def has_runs(out: Path) -> bool:
    """Whether a folder has a description of runs."""
    return any((out / name).is_file() for name in (DESCRIPTION, DESCRIPTION_BEFORE))


def read_description(out: Path) -> RunDescription:
    """Read the description of a folder's runs. Raises BadInput."""
    path, before = out / DESCRIPTION, out / DESCRIPTION_BEFORE
    if path.is_file():
        return read_record(RunDescription, path)
    if not before.is_file():
        raise BadInput(
            f"{out}: no runs in it ({DESCRIPTION} is missing); run `tailbeat evaluate` first."
        )
    held = read_json(before)
    held["conditions"] = {k.replace(*RENAMED): n for k, n in held.pop("arms", {}).items()}
    return as_record(RunDescription, held, before)


def read_json(path: Path) -> Any:
    """Read a JSON file of ours. Raises BadInput."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except ValueError:
        raise BadInput(f"{path}: not readable JSON; {REPEAT}") from None


def read_record(kind: type[T], path: Path) -> T:
    """Read a JSON file of ours as a record of the given kind. Raises BadInput."""
    return as_record(kind, read_json(path), path)


def as_record(kind: type[T], held: Any, path: Path) -> T:
    """Convert the contents of a file to a record of the given kind. Raises BadInput naming the
    first error."""
    try:
        return TypeAdapter(kind).validate_python(held)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        said = f"{where}: {first['msg']}" if where else first["msg"]
        raise BadInput(f"{path}: {said}; {REPEAT}") from None


def chunk_path(out: Path, condition: str, chunk: int) -> Path:
    """Path of a chunk's file; files with the older name are found too."""
    stem = condition.replace(":", "").replace(" ", "-").replace("/", "-per-")
    paths = [
        out / "runs" / f"{name}.{chunk:03d}.npz"
        for name in (stem.replace(RENAMED_FILE[1], RENAMED_FILE[0]), stem)
    ]
    return paths[0] if paths[0].is_file() else paths[1]


def save(runs: Runs, path: Path) -> None:
    """Write one chunk."""
    with new_file(path, overwrite=True) as beside:
        np.savez_compressed(beside, **vars(runs))


def load(out: Path, condition: str, chunks: int) -> tuple[Runs, bool]:
    """Read all chunks of a condition that exist; also returns whether some are missing. Raises
    BadInput if none exists."""
    paths = [chunk_path(out, condition, chunk) for chunk in range(chunks)]
    found = [path for path in paths if path.is_file()]
    if not found:
        raise BadInput(f"{out}: no swims of {condition!r} in it; run the evaluation again.")
    return joined([read_chunk(path) for path in found]), len(found) < chunks


def read_chunk(path: Path) -> Runs:
    """Read one chunk's swims. Raises BadInput."""
    if not path.is_file():
        raise BadInput(f"{path}: no such file; give a chunk that `tailbeat evaluate` wrote.")
    try:
        with np.load(path) as held:
            ones = np.ones(len(held["steps"]), np.float32)  # older chunks are of the paper's fish
            found = {**dict.fromkeys(("size", "reach"), ones), **held}
            return Runs(**{field.name: found[field.name] for field in fields(Runs)})
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise BadInput(f"{path}: cannot be read; delete it and evaluate again.") from error


def joined(parts: Sequence[Runs]) -> Runs:
    """Join chunks; shorter ones are filled with NaN."""
    longest = max(part.motor.shape[1] for part in parts)
    values = {
        field.name: np.concatenate(
            [_filled(field.name, getattr(part, field.name), longest) for part in parts]
        )
        for field in fields(Runs)
    }
    return Runs(**values)


def _filled(name: str, values: Any, longest: int) -> Any:
    if values.ndim == 1:
        return values
    missing = longest - (name == "setpoint") - values.shape[1]
    if not missing:
        return values
    tail = np.full((len(values), missing, *values.shape[2:]), np.nan, dtype=np.float32)
    return np.concatenate([values, tail], axis=1)
