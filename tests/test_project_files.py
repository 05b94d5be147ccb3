"""Files that other machines read say what pyproject.toml and constraints.txt say."""

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

yaml = pytest.importorskip("yaml", reason="the docs extra is not installed")

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
PINS = dict(re.findall(r"^([\w.-]+)==(\S+)", (ROOT / "constraints.txt").read_text("utf-8"), re.M))


def read(path: str) -> Any:
    return yaml.safe_load((ROOT / path).read_text("utf-8"))


def test_the_citation_is_of_this_version_and_names_the_paper():
    citation = read("CITATION.cff")
    assert citation["version"] == PROJECT["version"]
    assert f"version = {{{PROJECT['version']}}}" in (ROOT / "docs/cite.md").read_text("utf-8")
    assert "All You Need Is Low Fidelity" in citation["references"][0]["title"]


def test_the_workflows_test_each_python_that_is_promised_and_both_architectures():
    matrix = read(".github/workflows/ci.yml")["jobs"]["test"]["strategy"]["matrix"]
    promised = [c.split(" :: ")[-1] for c in PROJECT["classifiers"] if ":: 3." in c]
    assert matrix["python"] == promised and matrix["os"][1].endswith("-arm")


@pytest.mark.parametrize("name", ["ci", "docs"])
def test_the_workflows_make_targets_that_there_are(name):
    jobs = read(f".github/workflows/{name}.yml")["jobs"].values()
    made = {
        w for j in jobs for s in j["steps"] for w in re.findall(r"make (\S+)", s.get("run", ""))
    }
    rules = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text("utf-8"), re.M))
    assert made and made <= {*rules, ".venv/.installed"}


def test_a_commit_is_checked_by_the_versions_of_the_constraints():
    hooks = {Path(r["repo"]).name: r.get("rev") for r in read(".pre-commit-config.yaml")["repos"]}
    assert hooks["ruff-pre-commit"] == f"v{PINS['ruff']}"
    assert hooks["codespell"] == f"v{PINS['codespell']}"


@pytest.mark.parametrize("form", ["bug", "fish"])
def test_a_form_asks_for_something(form):
    asked = read(f".github/ISSUE_TEMPLATE/{form}.yml")["body"]
    assert len(asked) > 2 and all(one["attributes"]["label"] for one in asked)
