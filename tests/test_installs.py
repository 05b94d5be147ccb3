"""What each machine installs, and the sentence where a package is missing."""

import ast
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from tailbeat.files import EXTRA_OF

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
# What the extras call differently from what is imported.
INSTALLED_AS = {"cv2": "opencv-python-headless", "serial": "pyserial"}
INSTALLED_AS |= {"stable_baselines3": "stable-baselines3"}
LABORATORY = {"mujoco", "numba", "scipy", "matplotlib", "polars", "cma"}
# The verbs of the robot, and what they import when they run.
ROBOT = ["tailbeat.cli.app", "tailbeat.robot.session", "tailbeat.robot.doctor"]
ROBOT += ["tailbeat.robot.systemd", "tailbeat.robot.watchdog", "tailbeat.link.datagrams"]


def named(requirements: list[str]) -> set[str]:
    """The packages of a list of requirements, without versions."""
    return {one.split("[")[0].split(">")[0].split("<")[0].strip() for one in requirements}


def imported_without(missing: str, code: str) -> subprocess.CompletedProcess:
    """Python that finds no package `missing`."""
    hidden = f"import sys\nsys.modules[{missing!r}] = None\n"
    words = [sys.executable, "-c", hidden + code]
    return subprocess.run(words, capture_output=True, text=True, check=False)


def test_every_package_is_in_the_extra_that_the_sentence_names():
    for module, extra in EXTRA_OF.items():
        package = INSTALLED_AS.get(module, module)
        assert package in named(PROJECT["optional-dependencies"][extra]), module


def test_every_import_is_of_the_core_or_of_an_extra():
    core = named(PROJECT["dependencies"])
    found = set()
    for path in (ROOT / "src").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                found |= {alias.name.split(".")[0] for alias in node.names}
            if isinstance(node, ast.ImportFrom) and not node.level:
                found.add(str(node.module).split(".")[0])
    found -= {"tailbeat", *sys.stdlib_module_names}
    assert found <= core | set(EXTRA_OF), sorted(found - core - set(EXTRA_OF))


def test_every_requirement_is_pinned_once():
    extras = PROJECT["optional-dependencies"]
    wanted = named(PROJECT["dependencies"]).union(*map(named, extras.values())) - {"tailbeat"}
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pinned = [line.split("==")[0] for line in lines if "==" in line]
    assert sorted(pinned) == sorted(wanted)


def test_what_the_robot_runs_imports_nothing_of_the_laboratory():
    code = f"import sys, {', '.join(ROBOT)}\nprint(*{{n.split('.')[0] for n in sys.modules}})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert not LABORATORY & set(done.stdout.split())


@pytest.mark.parametrize(
    ("package", "extra", "words"),
    [
        ("mujoco", "sim", ["show", "pulley-fish"]),
        ("polars", "sim", ["predict", "--fish", "pulley-fish", "none.csv"]),
        ("torch", "train", ["train", "--fish", "pulley-fish-pool", "--out", "{folder}"]),
        ("serial", "robot", ["torque-off", "--servo", "/dev/none"]),
        ("cv2", "station", ["tags", "--out", "{folder}/tags.pdf"]),
    ],
)
def test_a_verb_without_its_extra_says_which_to_install(package, extra, words, tmp_path):
    words = ["tailbeat", *(word.format(folder=tmp_path / "new") for word in words)]
    code = f"sys.argv[:] = {words!r}\nfrom tailbeat.cli.app import main\nmain()"
    done = imported_without(package, code)
    assert done.returncode == 2, done.stderr
    assert f"the package {package}: pip install 'tailbeat[{extra}]'" in done.stderr
    assert "Traceback" not in done.stderr
    assert not list(tmp_path.iterdir())
