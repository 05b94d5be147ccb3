"""Recordings that ask for two gains or two loads are said to contradict each other; honest ones are
not."""

from dataclasses import replace

import pytest

from synthetic_recordings import servo_run
from tailbeat.fish.store import load_fish, value_at, with_values
from tailbeat.identify.protocol import limits, servo_commands
from tailbeat.identify.servo import as_bench
from tailbeat.identify.servo_gains import scan
from tailbeat.identify.servo_job import ServoFit, identify_servo
from tailbeat.identify.servo_report import as_report
from tailbeat.identify.servo_search import ServoConfig
from tailbeat.identify.shaft import Bench
from tailbeat.importers.xl330 import import_xl330
from test_servo_fit import SHORT, own_runs

FISH = load_fish("pulley-fish")


def fitted(benches: list[Bench], scratch) -> ServoFit:
    config = ServoConfig(seeds=1, first_seed=1, effort=SHORT, gears=False)
    return identify_servo(FISH, benches, [], config, scratch)


@pytest.mark.thorough
def test_honest_recordings_agree(tmp_path):
    for seed in range(2):
        benches = own_runs(seed)
        found = fitted(benches, tmp_path / str(seed))
        assert found.contradictions == ()
        said = scan(found.space, found.fits[0].z, benches)
        assert [one.name for one in said] == ["gain 1", "gain 3"]
        assert [one.best for one in said] == pytest.approx([1, 1], rel=0.06)


@pytest.mark.thorough
@pytest.mark.parametrize("stated", [1.5, 2.0, 4.5, 6.0])
def test_a_wrong_gain_is_the_first_thing_said(tmp_path, stated):
    """The second recording was made at gain 3."""
    first, second = own_runs(0)
    report = as_report(fitted([first, replace(second, gain=stated)], tmp_path))
    assert not report["trusted"]
    assert report["verdict"][0].startswith("do not trust this fit: recordings at gain")
    more, less = (stated, 1.0) if stated < 3 else (1.0, stated)
    assert f"recordings at gain {more:g} ask for" in report["verdict"][0]
    assert f"those at gain {less:g} ask for" in report["verdict"][0]


@pytest.mark.thorough
@pytest.mark.parametrize(("heavier", "told"), [(1.0, False), (2.0, True), (0.5, True)])
def test_two_pendulums_that_are_said_to_be_one_are_told(tmp_path, heavier, told):
    """Three recordings at one gain state one pendulum; the second had another."""
    runs = own_runs(0, (1.0, 1.0, 1.0), (1.0, heavier, 1.0))
    said = as_report(fitted(runs, tmp_path))["verdict"]
    first = said[0] if said else ""
    assert first.startswith("do not trust this fit: ") == told
    assert ("2.0 times the load" in first and "of two tails" in first) == told


@pytest.mark.thorough
@pytest.mark.parametrize("softer", [1.0, 0.5])
def test_two_tails_that_are_said_to_be_one_are_told(tmp_path, softer):
    commands = servo_commands(FISH, limits(FISH))
    path = "tail.stiffness_scale"
    other = with_values(FISH, {path: softer * value_at(FISH, path)})
    swum = zip((FISH, FISH, other), ("chirp", "triangle", "steps"), strict=True)
    runs = [as_bench(servo_run(own, commands[f"servo-{name}"], 0), FISH) for own, name in swum]
    said = fitted(runs, tmp_path).contradictions
    assert [("times the load that servo-steps" in one) for one in said] == [True] * (softer < 1)


def test_without_stated_gains_there_is_nothing_to_contradict(tmp_path):
    found = fitted([replace(one, gain=None) for one in own_runs(1)], tmp_path)
    assert found.contradictions == ()


@pytest.mark.slow  # twelve logs, fitted twice
def test_real_logs_at_three_gains_agree_until_one_is_stated_wrongly(data, tmp_path):
    """With the effort of the command: a short fit does not end, and blames the gains for that."""
    logs = sorted((data / "xl330").glob("*.json"))
    runs = [as_bench(import_xl330(log), FISH) for log in logs]
    config = ServoConfig(seeds=1, first_seed=1, gears=True)
    assert identify_servo(FISH, runs, [], config, tmp_path / "true").contradictions == ()
    assert len({run.gain for run in runs}) == 3
    wrong = [replace(run, gain=1600.0) if run.gain == 800 else run for run in runs]
    found = identify_servo(FISH, wrong, [], config, tmp_path / "wrong").contradictions
    assert len(found) == 1 and "those at gain 1600" in found[0]
