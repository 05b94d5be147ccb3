"""The reference's pages name all that the code has, with units, defaults and bounds."""

import ast
import re
from dataclasses import fields
from functools import cache
from pathlib import Path

import pytest

import reference
from reference.fields import described
from reference.recording import COLUMNS, METADATA
from reference.verbs import escaped
from tailbeat.cli.group import load
from tailbeat.cli.verbs import PANELS
from tailbeat.control.policy import Contract
from tailbeat.fish.description import Fish, Servo
from tailbeat.fish.store import load_fish
from tailbeat.recording import SUFFIXES
from tailbeat.robot import log

SOURCE = Path(__file__).parents[1] / "src" / "tailbeat"
VERBS = [verb for verbs in PANELS.values() for verb in verbs]
READERS = ["identify/*.py", "importers/*.py", "pool/*.py", "robot/log_export.py"]
NOT_COLUMNS = {"rmse_deg", "mae_deg", "idealised_rmse_deg", "damping_ratio", "validate_mae_deg"}
NOT_COLUMNS |= {"heading_error_deg"}


@cache
def pages() -> dict[str, str]:
    return reference.pages()


def section(page: str, heading: str) -> str:
    """The text below a heading, up to the next one."""
    return pages()[page].split(f"\n## {heading}\n")[1].split("\n## ")[0]


def row(text: str, name: str) -> list[str]:
    """The cells of a table's row, without the first."""
    (found,) = re.findall(rf"^\| `{re.escape(name)}`.*", text, re.M)
    return [cell.strip() for cell in re.split(r"(?<!\\)\|", found)[2:-1]]


@pytest.mark.parametrize("verb", VERBS, ids=lambda verb: verb.name)
def test_a_verb_has_its_text_example_and_options(verb):
    (text,) = [
        page.split(f"\n## tailbeat {verb.name}\n")[1].split("\n## ")[0]
        for page in pages().values()
        if f"\n## tailbeat {verb.name}\n" in page
    ]
    command = load(verb)
    assert escaped(command.help) in text and f"tailbeat {verb.name} {verb.example}" in text
    for param in command.params:
        name = param.name.upper() if param.param_type_name == "argument" else param.opts[0]
        _, default, meaning = row(text, name)
        assert (default == "required") == param.required
        assert meaning == escaped(" ".join((param.help or "").split())) != ""
    assert f"`tailbeat {verb.name}`" in pages()["verbs/index.md"]


def test_options_have_units_and_defaults():
    text = section("verbs/learn.md", "tailbeat train")
    assert row(text, "--hours")[:2] == ["number", "`12.0`"] and "\\[h\\]" in row(text, "--hours")[2]
    assert row(text, "--resume")[:2] == ["yes/no", "no"]
    assert "path ..." in row(section("verbs/identify-it.md", "tailbeat identify fluid"), "--fit")


def test_each_field_of_a_fish_has_unit_default_and_bounds():
    assert row(section("fish.md", "`[servos.NAME]`"), "kp")[:4] == [
        "number", "`N m/rad`", "required", "> 0",
    ]  # fmt: skip
    assert row(section("fish.md", "`[simulation]`"), "step")[1:4] == [
        "`s`", "`0.002`", "> 0, <= 0.02",
    ]  # fmt: skip
    assert row(section("fish.md", "`[[tail.links]]`"), "strip_height")[1:4] == [
        "`m`",
        "none",
        "> 0",
    ]
    assert "`crank`" in row(section("fish.md", "`[motor]`"), "kind")[3]
    assert row(section("fish.md", "Top of the file"), "band")[1] == "`Hz`"


def test_every_field_of_a_shipped_fish_is_on_the_page():
    written = load_fish("pulley-fish").model_dump()
    names = {name for name in keys(written) if name not in {*written["zones"], *written["servos"]}}
    shown = set(re.findall(r"^\| `(\w+)`", pages()["fish.md"], re.M))
    assert len(names) > 40 and names <= shown, names - shown


def keys(value: object) -> list[str]:
    """Every key at any depth."""
    if isinstance(value, dict):
        return [*value, *(name for inner in value.values() for name in keys(inner))]
    if isinstance(value, list | tuple):
        return [name for inner in value for name in keys(inner)]
    return []


def test_a_field_without_a_description_is_refused():
    class Bare(Servo):
        extra: float = 0.0

    with pytest.raises(KeyError, match=r"Bare\.extra has no description"):
        described(Bare)
    assert set(described(Fish)) == set(Fish.model_fields)


def test_the_contract_s_fields_are_on_the_page():
    text = section("contract.md", "Contract")
    for field in fields(Contract):
        assert row(text, field.name)[2] == " ".join(described(Contract)[field.name].split())
    assert row(section("contract.md", "Generator"), "tau")[1] == "`0.1`"
    assert "| 0 | cos motor angle |" in pages()["contract.md"]


def test_the_log_s_fields_are_on_the_page():
    text = pages()["log.md"]
    for name, kind in log.schema()["properties"].items():
        assert row(text, name) == [kind["type"], kind["description"]]
    assert f"`{log.TOPIC}`" in text


def columns_of(path: Path) -> set[str]:
    """Names with a unit that stand as a key, an index or an argument in a source file."""
    found: list[ast.expr | None] = []
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        match node:
            case ast.Dict(keys=given):
                found += given
            case ast.Subscript(slice=index):
                found.append(index)
            case ast.Call(args=given):
                found += given
                found += [e for a in given if isinstance(a, ast.List | ast.Tuple) for e in a.elts]
    texts = {one.value for one in found if isinstance(one, ast.Constant)}
    return {t for t in texts if isinstance(t, str) and t.endswith(tuple(SUFFIXES))} - NOT_COLUMNS


def test_every_column_that_the_code_reads_or_writes_is_on_the_page():
    files = [path for pattern in READERS for path in sorted(SOURCE.glob(pattern))]
    used = set().union(*map(columns_of, files), log.COLUMNS)
    assert {"motor_angle_rad", "torque_nm"} <= used <= {*COLUMNS, *METADATA}, used - {*COLUMNS}
    assert all(row(pages()["recording.md"], name)[1] for name in {*COLUMNS, *METADATA})


def test_every_key_of_the_metadata_is_in_the_code():
    texts = [path.read_text("utf-8") for pattern in READERS for path in SOURCE.glob(pattern)]
    unknown = {key for key in METADATA if not any(f'"{key}"' in text for text in texts)}
    assert not unknown
