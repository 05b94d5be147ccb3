"""Produce the numbers of docs/results: `make results ARGS="[--again] [--busy] [NAMES]"`.

What each result needs and how it is made stands in docs/results/commands.toml. A result whose data
lie in docs/results/data is kept, unless a fish or policy that it was measured with changed since.
A result that was interrupted goes on with its next step.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from datetime import date
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

import result_files
import result_pages
from tailbeat.benchmarks.step import machine
from tailbeat.evaluate.provenance import provenance
from tailbeat.files import BadInput, write_json

ROOT = Path(__file__).parents[1]
RESULTS = Path("build/results")  # below the repository; git ignores it
QUIET = 0.5  # processes that want a core, above which times are not trusted
DIGITS = 6  # of each number that is kept: more than any page shows
# What a step calls is this package, whatever the shell's path says.
SHELL = 'set -eu; tailbeat() {{ "{python}" -m tailbeat "$@"; }}; {step}'


class Entry(BaseModel):
    """One result of commands.toml, whose head says what each field means."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    about: str
    steps: tuple[str, ...]
    minutes: float
    after: tuple[str, ...] = ()
    uses: tuple[str, ...] = ()
    drop: tuple[str, ...] = ()
    data: bool = False
    quiet: bool = False
    given: Mapping[str, Any] = {}
    pictures: Mapping[str, str] = {}


def read_entries(path: Path) -> dict[str, Entry]:
    """Every result by its name. Raises BadInput for a field that is missing, wrong or unknown."""
    try:
        held = tomllib.loads(path.read_text("utf-8"))
        entries = {name: Entry.model_validate(row) for name, row in held.items()}
    except tomllib.TOMLDecodeError as error:
        raise BadInput(f"{path}: {error}.") from None
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise BadInput(
            f"{path}: field {where}: {first['msg']}; see the head of the file."
        ) from None
    return {name: _with_uses(entries, name) for name in entries}


def _with_uses(entries: Mapping[str, Entry], name: str) -> Entry:
    """A result that also uses what the results before it use."""
    entry = entries[name]
    before = [used for one in entry.after for used in files(_with_uses(entries, one))]
    return entry.model_copy(update={"uses": tuple(dict.fromkeys([*entry.uses, *before]))})


def files(entry: Entry) -> set[str]:
    """The shipped fish and policies that a result is measured with."""
    return {*result_files.named(entry.steps), *entry.uses}


def chosen(entries: Mapping[str, Entry], names: Sequence[str], again: bool) -> list[str]:
    """Names to run: those named or all, without those whose data are there and of today's fish and
    policies, unless `again`. What they read comes first, where its folder is missing."""
    unknown = sorted(set(names) - set(entries))
    if unknown:
        raise BadInput(f"{', '.join(unknown)}: no such result; allowed are {', '.join(entries)}.")
    wanted = [name for name in names or entries if (again and names) or missing(name)]
    before = [one for name in wanted for one in entries[name].after if not done(entries, one)]
    return list(dict.fromkeys([*before, *wanted]))


def done(entries: Mapping[str, Entry], name: str) -> bool:
    """Whether every step of a result was taken on this machine, with today's fish and policies."""
    entry = entries[name]
    return fresh(name, entry) and len(taken(folder(name))) == len(entry.steps)


def fresh(name: str, entry: Entry) -> bool:
    """Whether the folder of a result was begun with today's fish and policies."""
    path = folder(name) / "files.json"
    return path.is_file() and json.loads(path.read_text("utf-8")) == used(entry)


def used(entry: Entry) -> dict[str, str | None]:
    """Today's digests of the fish and policies that a result is measured with."""
    return result_files.digests(files(entry))


def missing(name: str) -> bool:
    """Whether a result has no data, or data of fish and policies that changed since."""
    path = result_pages.data_path(ROOT, name)
    if not path.is_file():
        return True
    return bool(result_files.changed(json.loads(path.read_text("utf-8"))["origin"]))


def folder(name: str) -> Path:
    """Where a result's steps write."""
    return ROOT / RESULTS / name


def taken(out: Path) -> list[float]:
    """Seconds of each step that was finished."""
    path = out / "steps.json"
    return list(json.loads(path.read_text("utf-8"))) if path.is_file() else []


def run(name: str, entry: Entry) -> None:
    """Take the steps that are left. Raises BadInput where one fails."""
    out = folder(name)
    (out / "json").mkdir(parents=True, exist_ok=True)
    for number in range(len(taken(out)), len(entry.steps)):
        began = time.monotonic()
        _take(name, entry.steps[number])
        seconds = [*taken(out), round(time.monotonic() - began, 1)]
        write_json(out / "steps.json", seconds, overwrite=True)


def _take(name: str, step: str) -> None:
    """One step. Exit code 1 of a step that wrote a result says that the result misses something."""
    places = {"OUT": str(RESULTS / name), "RESULTS": str(RESULTS)}
    words = ["bash", "-c", SHELL.format(python=sys.executable, step=step)]
    print(f"  {step}", flush=True)
    with (folder(name) / "log.txt").open("a", encoding="utf-8") as log:
        ended = subprocess.run(words, cwd=ROOT, env={**os.environ, **places}, stdout=log)
    code = ended.returncode
    if code not in (0, 1) or (code == 1 and "--json" not in step):
        raise BadInput(f"{name}: exit code {code} from: {step}")


def collect(name: str, entry: Entry) -> dict[str, Any]:
    """The parts of a result with their origin, thinned out. Raises BadInput where none is there."""
    paths = sorted((folder(name) / "json").glob("*.json"))
    if not paths:
        raise BadInput(f"{folder(name)}: no step wrote a result; run it again with --again.")
    parts = {path.stem: json.loads(path.read_text("utf-8")) for path in paths}
    for pattern in entry.drop:
        _drop(parts, pattern.split("."))
    given = {"given": dict(entry.given)} if entry.given else {}
    return {"origin": origin(name, entry), **given, **short(parts)}


def origin(name: str, entry: Entry) -> dict[str, Any]:
    """How, when and where a result was made; `seconds` are those of each step, and of a step that
    was interrupted those of its last part."""
    made = provenance()
    return {
        "steps": list(entry.steps),
        "files": used(entry),
        "seconds": taken(folder(name)),
        "date": date.today().isoformat(),
        "tailbeat": made.tailbeat,
        "commit": made.commit,
        "python": made.python,
        "machine": machine(),
        "processor": processor(),
        "load": round(os.getloadavg()[2], 1),
    }


def processor() -> str:
    """The processor's name, where the system tells it."""
    told = Path("/proc/cpuinfo")
    lines = told.read_text("utf-8").splitlines() if told.is_file() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else "not told by the system"


def _drop(value: Any, path: Sequence[str]) -> None:
    """Remove what a dotted path names, `*` standing for every entry."""
    for key in _keys(value, path[0]):
        if len(path) == 1:
            del value[key]
        else:
            _drop(value[key], path[1:])


def _keys(value: Any, name: str) -> Iterator[Any]:
    if name != "*":
        return iter([name] if isinstance(value, dict) and name in value else [])
    return iter(range(len(value)) if isinstance(value, list) else list(value))


def short(value: Any) -> Any:
    """The same with six digits to each number, and paths as seen from the repository."""
    if isinstance(value, dict):
        return {key: short(item) for key, item in value.items()}
    if isinstance(value, list):
        return [short(item) for item in value]
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}")
    return value.replace(f"{ROOT}/", "") if isinstance(value, str) else value


def check(entry: Entry, name: str, busy: bool) -> None:
    """Raises BadInput where this machine cannot make the result now."""
    if entry.data and not Path(os.environ.get("TAILBEAT_DATA", "")).is_dir():
        raise BadInput(f"{name}: needs recordings; set TAILBEAT_DATA to the folder of its data.")
    load = os.getloadavg()[0]
    if entry.quiet and load > QUIET and not busy:
        raise BadInput(
            f"{name}: measures time, and the load is {load:.1f}; wait until it is below {QUIET:g},"
            f" or give --busy."
        )


def copy_pictures(name: str, entry: Entry) -> None:
    """Copy what the pages show. Raises BadInput where a step did not draw it."""
    for shown, drawn in entry.pictures.items():
        source = folder(name) / drawn
        if not source.is_file():
            raise BadInput(f"{source}: no step of {name} drew it; correct `pictures`.")
        target = ROOT / "docs" / "results" / "pictures" / f"{shown}{source.suffix}"
        target.parent.mkdir(exist_ok=True)
        shutil.copyfile(source, target)


def make(name: str, entry: Entry, again: bool) -> None:
    """Run what is left of a result, copy its pictures and write its data."""
    if again or not fresh(name, entry):
        shutil.rmtree(folder(name), ignore_errors=True)
        write_json(folder(name) / "files.json", used(entry))
    run(name, entry)
    copy_pictures(name, entry)
    write_json(result_pages.data_path(ROOT, name), collect(name, entry), overwrite=True)


def main(words: Sequence[str] | None = None) -> None:
    """Make the results that are asked for, then write every page that shows them."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", help="results of commands.toml; default: all")
    parser.add_argument("--again", action="store_true", help="make the named results again")
    parser.add_argument("--busy", action="store_true", help="measure times on a busy machine too")
    asked = parser.parse_args(words)
    entries = read_entries(ROOT / "docs" / "results" / "commands.toml")
    names = chosen(entries, asked.names, asked.again)
    left = [entries[name].minutes for name in names]
    for number, name in enumerate(names):
        about, rest = entries[name].about, sum(left[number:])
        print(f"{number + 1}/{len(names)} {name}: {about}; about {rest:.0f} min left", flush=True)
        check(entries[name], name, asked.busy)
        make(name, entries[name], asked.again and name in asked.names)
    for path in result_pages.write(ROOT):
        print(f"wrote {path.relative_to(ROOT)}")


def _end(text: str, code: int) -> None:
    print(f"results: {text}", file=sys.stderr)
    sys.exit(code)


if __name__ == "__main__":
    try:
        main()
    except BadInput as error:
        _end(str(error), 2)
    except KeyboardInterrupt:
        _end("interrupted; the same command goes on with the step that was interrupted.", 130)
