"""Whatever is typed or lies on the disk: a verb ends with 0, 1, or one sentence and 2."""

import shutil
from functools import reduce
from pathlib import Path

import pytest
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from fuzz import (
    BAD_PATHS,
    ODD_NUMBERS,
    ODD_TEXTS,
    Parameter,
    cleared,
    furnish,
    survives,
    verbs,
)  # fmt: skip
from fuzz_files import KINDS, ODD_CONTENTS, WAYS, Damage, damaged

VERBS = verbs()
SECONDS = ("posterior", "picture", "survey")  # what takes seconds to read
# Of these, the ones that any run reads or writes first.
FIRST = {"json", "out", "log", "key", "camera", "socket", "pictures", "replay"}


def runs(few: int, many: int):
    """Number of examples: few always, many with `-m slow`."""
    return pytest.mark.parametrize(
        "count", [few, pytest.param(many, marks=pytest.mark.slow)], ids=["few", "many"]
    )


def fuzzed(count: int):
    """The settings of a fuzz test: the same examples every time, and no files of hypothesis."""
    checks = [HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.filter_too_much]
    chosen = settings(
        max_examples=count, deadline=None, database=None, suppress_health_check=checks,
        phases=[Phase.generate],  # a run that takes long would be repeated to make it shorter
    )  # fmt: skip
    return lambda test: seed(0)(chosen(test))


def value_of(parameter: Parameter) -> st.SearchStrategy[str]:
    if parameter.of_path:  # a folder of results may be there already: the work is continued
        fits = [one for one in BAD_PATHS if one != "a folder" or parameter.name != "out"]
        return st.sampled_from(fits)
    if parameter.kind in ("int", "float"):
        return st.sampled_from(ODD_NUMBERS)
    return st.sampled_from(ODD_TEXTS)


def broken(parameters: tuple[Parameter, ...]) -> list[Parameter]:
    """Those of which one must be bad, so that no run begins to work."""
    paths = [one for one in parameters if one.of_path]
    return [one for one in paths if one.required] or [one for one in paths if one.name in FIRST]


@st.composite
def calls(draw, verb: str) -> list[str]:
    """A call of a verb with one path that is bad for sure, and other odd values."""
    parameters = VERBS[verb]
    bad = draw(st.sampled_from(broken(parameters)))
    words: list[str] = verb.split()
    for one in parameters:
        if one.kind == "bool":
            words += [one.option] if draw(st.integers(0, 9)) == 0 else []
        elif one is bad or one.required or draw(st.integers(0, 3)) == 0:
            words += one.words(draw(value_of(one)))
    return words


@pytest.mark.parametrize("verb", VERBS)
@runs(2, 500)
def test_odd_words(tmp_path: Path, verb: str, count: int):
    @fuzzed(count)
    @given(calls(verb))
    def held(words):
        folder = cleared(tmp_path / "here")
        furnish(folder)
        survives(words, folder)

    held()


# ---- files --------------------------------------------------------------------------------------

damages = st.builds(
    Damage,
    st.sampled_from(sorted(WAYS)),
    st.floats(0, 1, exclude_max=True),
    st.sampled_from(ODD_CONTENTS),
)


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.thorough) if n in SECONDS else n for n in KINDS]
)
@runs(4, 3000)
def test_damaged_files(tmp_path: Path, name: str, count: int):
    kind, whole = KINDS[name], tmp_path / "whole"
    kind.write(cleared(whole))

    @fuzzed(count)
    @given(st.sampled_from(kind.verbs), st.lists(damages, min_size=1, max_size=3))
    def held(verb, changes):
        folder = tmp_path / "here"
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(whole, folder)
        path = folder / kind.path
        path.write_bytes(reduce(damaged, changes, path.read_bytes()))
        kind.after(folder)
        survives(verb.split(), folder)

    held()
