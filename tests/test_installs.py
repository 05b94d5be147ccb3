"""What each machine installs, and the sentence where a package is missing."""

import ast
import json
import os
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from tailbeat.emulators.own_devices import own_devices
from tailbeat.files import EXTRA_OF

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
# What the extras call differently from what is imported.
INSTALLED_AS = {"cv2": "opencv-python-headless", "serial": "pyserial", "PIL": "pillow"}
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


@pytest.mark.thorough
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


@pytest.mark.thorough
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


# ---- the wheel ----------------------------------------------------------------------------------


# A source tree that this test was pointed to must not stand in for the wheel.
ALONE = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}


def run(*words: object, code: int | tuple[int, ...] = 0) -> subprocess.CompletedProcess:
    """A command that must end with this code."""
    command = [*map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=ALONE)
    assert done.returncode in (code if isinstance(code, tuple) else (code,)), (words, done)
    return done


@pytest.fixture(scope="module")
def robot(tmp_path_factory) -> Path:
    """The programs of a fresh environment with `tailbeat[robot]` from the built wheel alone."""
    folder = tmp_path_factory.mktemp("robot")
    source = folder / "source"  # pip builds in the tree, and other tests read it
    ignored = shutil.ignore_patterns(".*", "runs", "tests", "docs")
    shutil.copytree(ROOT, source, ignore=ignored)
    pip = (sys.executable, "-m", "pip")
    run(*pip, "wheel", "-q", "--no-deps", "-w", folder, source)
    (wheel,) = folder.glob("tailbeat-*.whl")
    run(sys.executable, "-m", "venv", folder / "venv")
    python = folder / "venv" / "bin" / "python"
    run(python, "-m", "pip", "install", "-q", "-c", ROOT / "constraints.txt", f"{wheel}[robot]")
    return python.parent


@pytest.mark.slow
def test_the_wheel_brings_the_robot_no_laboratory(robot):
    listed = json.loads(run(robot / "pip", "list", "--format", "json").stdout)
    names = {one["name"].lower() for one in listed}
    assert {"tailbeat", "numpy", "onnxruntime", "mcap", "pyserial"} <= names
    assert not names & {*LABORATORY, "torch", "gymnasium", "opencv-python-headless", "fastapi"}
    here = run(robot / "python", "-c", "import tailbeat; print(tailbeat.__file__)")
    inside = Path(here.stdout.strip()).parent
    assert inside.is_relative_to(robot.parent) and (inside / "py.typed").is_file()
    policies = [path.stem for path in inside.rglob("*.onnx")]
    kinds = ("follow", "follow-rule", "generator", "reach")
    assert sorted(policies) == [f"pulley-fish-pool-{one}" for one in kinds]


@pytest.mark.slow
def test_the_robot_s_other_verbs_run_in_its_environment(robot, tmp_path):
    tailbeat = robot / "tailbeat"
    run(tailbeat, "key", tmp_path / "key")
    service = ["unit", "pulley-fish-pool-generator", "--out", tmp_path / "fish.service"]
    service += ["--servo", "/dev/servo", "--imu", "/dev/imu", "--listen", "127.0.0.1:7001"]
    service += ["--station", "127.0.0.1:7002", "--key", tmp_path / "key", "--logs", tmp_path]
    run(tailbeat, *service)
    doctor = ["doctor", "--key", tmp_path / "key", "--servo", tmp_path / "none"]
    assert "does not exist" in run(tailbeat, *doctor, "--logs", tmp_path, code=1).stdout
    torque = run(tailbeat, "torque-off", "--servo", tmp_path / "none", code=2)
    assert "Traceback" not in torque.stderr
    shown = run(tailbeat, "show", "pulley-fish", code=2)
    assert "pip install 'tailbeat[sim]'" in shown.stderr


@pytest.mark.slow
def test_the_robot_s_environment_drives_a_servo_and_an_imu_that_another_serves(robot, tmp_path):
    """The devices run in this test's environment, the loop in the robot's; real time."""
    for attempt in range(4):  # a busy machine makes the loop hold before it swims
        report, log = tmp_path / f"{attempt}.json", tmp_path / f"{attempt}.mcap"
        with own_devices("pulley-fish", 0) as (ports, key):
            words = ["drive", "pulley-fish-pool-generator", "--servo", ports.servo]
            words += ["--imu", ports.imu, "--listen", "{}:{}".format(*ports.listen)]
            words += ["--station", "{}:{}".format(*ports.station), "--key", str(key)]
            words += ["--target", "1.5,0.5", "--seconds", "12", "--log", str(log)]
            run(robot / "tailbeat", *words, "--json", report, code=(0, 1))
        found = json.loads(report.read_text())
        if found["swum_s"] > 1:
            break
    assert found["swum_s"] > 1 and found["rate_hz"] > 25, found
