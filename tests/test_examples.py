"""The scripts of examples/ run as a reader would run them, with short settings."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("stable_baselines3", reason="the train extra is not installed")

from synthetic_recordings import servo_run
from tailbeat.fish.show import shaft_stiffness
from tailbeat.fish.store import load_fish
from tailbeat.identify.protocol import limits, servo_commands
from tailbeat.recording import read_recording

EXAMPLES = Path(__file__).parents[1] / "examples"
SCRIPTS = sorted(path.name for path in EXAMPLES.glob("*.py"))


def said(script: str, *words: str) -> str:
    """What a script prints."""
    command = [sys.executable, str(EXAMPLES / script), *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("script", SCRIPTS)
def test_a_script_is_short_and_shows_what_it_prints(script):
    text = (EXAMPLES / script).read_text(encoding="utf-8")
    assert len(text.splitlines()) < 60
    assert f"python examples/{script}" in text.split('"""')[1]


@pytest.mark.thorough
def test_a_fish_swims_from_its_numbers():
    shown = (EXAMPLES / "swim.py").read_text().split('"""')[1]
    printed = said("swim.py", "--seconds", "3")
    assert printed.splitlines()[0] in shown
    speeds = [float(line.split()[1]) for line in printed.splitlines()[2:]]
    assert len(speeds) == 4 and min(speeds) > 0.01


@pytest.mark.thorough
def test_the_test_bench_is_identified():
    printed = said("identify.py", "--generations", "3")
    stiffness = re.search(r"k \[N m/rad\] +(\S+) +(\S+) +(\S+)", printed)
    assert stiffness and float(stiffness[2]) < 0.98 < float(stiffness[3])
    (held_out,) = re.findall(r"servo-mixed \(validate\): (\S+) deg", printed)
    assert float(held_out) < 0.2


def test_the_recordings_of_the_test_bench_are_those_that_today_s_servo_makes():
    """They were of a servo that acted half a step early, and the true delay was not found."""
    fish = load_fish("pulley-fish")
    commands = servo_commands(fish, limits(fish))
    seed = list(commands).index("servo-beat")
    made = servo_run(fish, commands["servo-beat"], seed)
    kept = read_recording(EXAMPLES / "bench" / "servo-beat.csv")
    assert np.array_equal(kept.time, made.time)
    assert kept.columns["angle_rad"] == pytest.approx(made.columns["angle_rad"], abs=1e-6)


@pytest.mark.thorough
def test_an_own_algorithm_runs_on_an_own_reward():
    first, second = said("own_reward.py", "--rounds", "2").splitlines()
    assert "cm nearer" in first and first.split(":")[1] != second.split(":")[1]


def test_the_readme_s_python_runs_and_prints_what_it_says(capsys):
    text = (EXAMPLES.parent / "README.md").read_text()
    (code,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    exec(code, {})
    rate, seconds = capsys.readouterr().out.split()
    assert f"# {float(rate):.1f} (all 20 targets), median {float(seconds):.1f} s" in code


@pytest.mark.thorough
def test_the_python_of_the_first_lines_runs(capsys):
    text = (EXAMPLES.parent / "docs/start/python.md").read_text()
    first, *others = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    exec(first, {})
    rate = capsys.readouterr().out.splitlines()[1].split()[0]
    assert f"`found.arrived` is {float(rate):.1f}" in text
    for code in others:
        exec(code, {})


def test_the_tutorial_s_two_fish_differ_in_tail_and_servo_alone():
    """The pool swims what the reader described, but for the numbers that he identifies."""
    guess, lab = (load_fish(EXAMPLES / "your-fish" / f"{name}.toml") for name in ("my-fish", "lab"))
    same = {"name", "summary", "tail", "servos"}
    assert guess.model_dump(exclude=same) == lab.model_dump(exclude=same)
    found = shaft_stiffness(lab) / shaft_stiffness(guess)
    assert found == pytest.approx(1.3, abs=0.03)
