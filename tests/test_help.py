"""What `tailbeat --help` shows, and what it does not import."""

import inspect
import os
import re
import subprocess
import sys
from importlib import import_module

import pytest

from support import command
from tailbeat.cli.app import run, spread_lists
from tailbeat.cli.group import load, tree
from tailbeat.cli.verbs import PANELS, Verb
from tailbeat.files import BadInput

VERBS = [verb for verbs in PANELS.values() for verb in verbs]
HEAVY = {"cma", "cv2", "matplotlib", "mujoco", "numba", "numpy", "onnxruntime", "polars"}
HEAVY |= {"scipy", "torch"}
UNITS = re.compile(r"\[(m|s|deg|Hz|rad/s|ms|days)\]")


def loaded_by(words: str) -> set[str]:
    code = (
        "import sys; from tailbeat.cli.app import run\n"
        f"code = run({words.split()!r}); print(code, *sys.modules, file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr.split()[0] == "0", done.stdout
    return set(done.stderr.split())


def help_of(verb: Verb, capsys) -> str:
    assert run([*verb.name.split(), "--help"]) == 0
    return capsys.readouterr().out


def test_the_version_is_said_without_the_parser():
    assert not {"typer", "rich", *HEAVY} & loaded_by("--version")


def test_the_list_of_verbs_imports_no_verb_and_no_terminal_library():
    loaded = loaded_by("--help")
    assert not {"rich", *HEAVY} & loaded
    assert not {f"tailbeat.cli.{verb.place.split(':')[0]}" for verb in VERBS} & loaded


@pytest.mark.thorough
@pytest.mark.parametrize("module", sorted({verb.place.split(":")[0] for verb in VERBS}))
def test_the_help_of_a_verb_loads_no_engine(module):
    name = next(verb.name for verb in VERBS if verb.place.startswith(module))
    assert not {"rich", *HEAVY} & loaded_by(f"{name} --help")


@pytest.mark.parametrize("verb", VERBS, ids=lambda verb: verb.name)
def test_help_shows_units_an_example_and_cuts_nothing(verb, capsys):
    module, function = verb.place.split(":")
    source = getattr(import_module(f"tailbeat.cli.{module}"), function)
    assert " ".join((inspect.getdoc(source) or "").split()).startswith(verb.sentence)
    text = " ".join(help_of(verb, capsys).split())
    assert f"Example: tailbeat {verb.name}" in text and "…" not in text
    for param in load(verb).params:
        for unit in UNITS.findall(getattr(param, "help", None) or ""):
            assert f"[{unit}]" in text, (param.name, unit)


@pytest.mark.parametrize("verb", VERBS, ids=lambda verb: verb.name)
def test_the_example_of_a_verb_is_understood(verb):
    import shlex

    words = spread_lists([*verb.name.split(), *shlex.split(verb.example)])
    load(verb).make_context(verb.name, words[len(verb.name.split()) :])


def test_verbs_are_listed_in_the_order_of_the_journey(capsys):
    assert run(["--help"]) == 0
    text = capsys.readouterr().out
    places = [text.index(f"\n{panel}:\n") for panel in PANELS]
    assert places == sorted(places)
    names = list(tree().commands)
    assert len(names) == len({verb.name.split()[0] for verb in VERBS})
    assert all(f"\n  {name} " in text for name in names)


@pytest.mark.parametrize(
    ("words", "answer"),
    [
        ("drivee", "no such command 'drivee'. Did you mean 'drive'"),
        ("drive --foo", "no such option: --foo"),
        ("identify", "missing command; see tailbeat identify --help"),
        ("swim --targets many", "see tailbeat swim --help"),
    ],
)
def test_what_is_not_understood_is_one_sentence(words, answer):
    with pytest.raises(BadInput) as refusal:
        run(words.split())
    assert answer in str(refusal.value) and "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("dr", "drive"),
        ("identify ", "tail\nservo\nfluid\nlogs\nposterior\nnext\nall"),
        ("drive --em", "--emulated"),
    ],
)
def test_the_shell_completes_verbs_and_options(typed, offered):
    asked = {"_TAILBEAT_COMPLETE": "complete_bash", "COMP_WORDS": f"tailbeat {typed}"}
    asked["COMP_CWORD"] = str(len(f"tailbeat {typed}|".split()) - 1)
    done = subprocess.run(command(), env={**os.environ, **asked}, capture_output=True, text=True)
    assert done.stdout.strip() == offered, done.stderr
