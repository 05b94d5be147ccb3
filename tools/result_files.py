"""Which shipped fish and policies a result was measured with, and which of them changed since."""

import hashlib
import json
import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from fnmatch import fnmatch
from functools import cache
from pathlib import Path
from typing import Any

import onnxruntime

from tailbeat.control.policy import KEY

ROOT = Path(__file__).parents[1]
FOLDERS = (
    "src/tailbeat/fish/models",
    "src/tailbeat/control/policies",
    "examples/policies",
    "examples/policies-messy",
)
# Fields of a fish that no result depends on.
WORDS = ("summary", "source", "hardware", "flooded")


def shipped(root: Path = ROOT) -> dict[str, Path]:
    """Every shipped fish and policy by its name."""
    found = [path for folder in FOLDERS for path in sorted((root / folder).glob("*.*"))]
    return {path.stem: path for path in found if path.suffix in (".toml", ".onnx")}


def named(steps: Sequence[str], root: Path = ROOT) -> list[str]:
    """The shipped fish and policies that steps name: by name, or by a path that may hold a `*`."""
    words = {word for step in steps for word in re.findall(r"[\w./*-]+", _unrolled(step))}
    return [
        name
        for name, path in shipped(root).items()
        if name in words or any(fnmatch(str(path.relative_to(root)), word) for word in words)
    ]


def _unrolled(step: str) -> str:
    """A step with every `for NAME in VALUES; ...` written once for each value."""
    loop = re.search(r"for (\w+) in ([^;]*);", step)
    if loop is None:
        return step
    return " ".join(step.replace(f"${loop[1]}", value) for value in loop[2].split())


def digests(names: Iterable[str], root: Path = ROOT) -> dict[str, str | None]:
    """A short digest of the content of each fish or policy; None where it is not shipped."""
    paths = shipped(root)
    return {name: digest(paths[name]) if name in paths else None for name in sorted(names)}


@cache
def digest(path: Path) -> str:
    """Digest of what a result depends on: a fish's numbers, without words and comments; a policy's
    contract, whose golden actions change with its weights."""
    content = _numbers(path) if path.suffix == ".toml" else _contract(path)
    return hashlib.sha256(content.encode()).hexdigest()[:8]


def _numbers(path: Path) -> str:
    return json.dumps(_without(tomllib.loads(path.read_text("utf-8")), WORDS), sort_keys=True)


def _without(node: Any, names: Sequence[str]) -> Any:
    """Nested tables and lists without the keys `names`."""
    if isinstance(node, list):
        return [_without(item, names) for item in node]
    if not isinstance(node, dict):
        return node
    return {key: _without(item, names) for key, item in node.items() if key not in names}


def _contract(path: Path) -> str:
    """The contract as the file carries it; `load_policy` would check the policy too."""
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    return str(session.get_modelmeta().custom_metadata_map[KEY])


def changed(origin: Mapping[str, Any], root: Path = ROOT) -> list[str]:
    """The fish and policies that a result would be measured with today, and was not."""
    held = dict(origin["files"].items())
    today = digests({*held, *named(list(origin["steps"]), root)}, root)
    return [name for name, found in today.items() if found is None or held.get(name) != found]
