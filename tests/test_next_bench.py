"""What test benches could still tell: where the numbers of tail or servo are in doubt."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

from support import tailbeat
from tailbeat.fish.description import Fish
from tailbeat.fish.store import fish_path, intervals, load_fish, value_at
from tailbeat.identify import next_recording, next_swim
from tailbeat.identify.bands import swim_all
from tailbeat.identify.next_bench import COMMON, Intervals, bench_recordings, doubted, left
from tailbeat.identify.next_recording import GOALS, Advice, advise
from tailbeat.identify.next_swim import as_played
from tailbeat.identify.posterior import needed
from tailbeat.pool.protocols import record_fluid
from tailbeat.recording import Recording

NAME = "pulley-fish-pool"
FISH, KNOWN = load_fish(NAME), intervals(NAME)
TAIL = ("tail.k_eff", "tail.damping_time", "tail.friction")
SERVO = tuple(path for path in KNOWN if path.startswith(f"servos.{FISH.servo}."))


def about(paths: tuple[str, ...], share: float) -> dict[str, tuple[float, float]]:
    """Intervals of numbers that are not 0, each this share of the value to both sides."""
    found = {path: value_at(FISH, path) for path in paths}
    return {path: ((1 - share) * x, (1 + share) * x) for path, x in found.items() if x > 1e-3}


def test_intervals_are_read_from_the_file_in_si(tmp_path):
    assert KNOWN["tail.k_eff"] == pytest.approx((0.96996, 0.98745))
    assert "tail.links.0.stiffness" in KNOWN and "zones.fin.kutta" in KNOWN
    path = tmp_path / "mine.toml"
    told = fish_path(NAME).read_text()
    mine = told.replace(
        '{value = 0.978706, unit = "N m/rad", interval = [0.96996, 0.98745]',
        '{value = 978.706, unit = "N mm/rad", interval = [969.96, 987.45]',
    )
    assert mine != told
    path.write_text(mine)
    assert intervals(path)["tail.k_eff"] == pytest.approx((0.96996, 0.98745))
    assert intervals("pulley-fish") == {}


def test_a_recording_leaves_what_the_formula_says():
    """Of a doubt 1 that one recording tells with an error of 1/3, 1 / (1 + 9) of the square is
    left; the doubt that no recording tells stays."""
    goals = np.array([[2.0], [1.0]])
    assert left(goals, []) == pytest.approx(5.0)
    assert left(goals, [np.diag([9.0, 0.0])]) == pytest.approx(4 / 10 + 1)
    assert left(np.zeros((0, 1)), []) == 0.0


def test_without_a_bench_nothing_of_it_is_in_doubt():
    assert doubted(FISH, {}) == {}
    assert doubted(FISH, {"zones.fin.kutta": (1.0, 2.0)}) == {}
    bare = FISH.model_copy(update={"tail": FISH.tail.model_copy(update={"k_eff": None})})
    assert doubted(bare, KNOWN) == {}


def test_one_number_is_moved_at_a_time_and_the_torques_of_a_servo_also_together():
    moved = doubted(FISH, about((*TAIL, *SERVO), 0.1))
    sigma = 0.1 / 1.96
    (stiffer,) = moved["tail.k_eff"]
    for path in ("tail.k_eff", "tail.links.0.stiffness", "tail.links.4.stiffness"):
        assert value_at(stiffer, path) == pytest.approx((1 + sigma) * value_at(FISH, path))
    assert stiffer.servos == FISH.servos
    both = moved[COMMON][0].servos[FISH.servo]
    own, was = moved[f"servos.{FISH.servo}.kp"][0].servos[FISH.servo], FISH.servos[FISH.servo]
    shared = both.kp / was.kp - 1
    assert shared == pytest.approx(both.armature / was.armature - 1) and both.delay == was.delay
    assert np.hypot(own.kp / was.kp - 1, shared) == pytest.approx(sigma)  # both make the interval
    assert own.armature == was.armature


def test_a_fast_condition_tells_damping_and_a_small_stroke_friction():
    moved = doubted(FISH, {path: KNOWN[path] for path in TAIL})
    found = bench_recordings(FISH, moved)
    names = [name for name in found if name.startswith("tail")]
    stiffness, damping, friction = np.array([np.diag(found[name].told) for name in names]).T
    frequency = [float(name.split()[2]) for name in names]
    assert frequency[int(np.argmax(damping))] == max(frequency)
    assert friction[-4] > 2 * friction[-1]  # the smallest and the largest stroke at 4 Hz
    assert stiffness.min() > 0


def test_what_is_foretold_of_the_pools_protocol_agrees_with_its_intervals():
    """The file's intervals came of sixteen tail conditions and three servo commands: so these must
    be foretold to leave about one of their deviations. Armature and delay are foretold too wide,
    since fast residuals are correlated over less than a block."""
    moved = doubted(FISH, KNOWN)
    found = bench_recordings(FISH, moved)
    tail = deviations(moved, TAIL, [one.told for one in found.values() if one.kind[0] == "t"])
    assert (tail > 0.5).all() and (tail < 1.6).all(), tail
    paths = tuple(
        f"servos.{FISH.servo}.{n}" for n in "kp damping force_limit armature delay".split()
    )
    told = [found[f"servo-{name}"].told for name in ("chirp", "steps", "triangle")]
    servo = deviations(moved, paths, told)
    assert (servo > 0.5).all() and (servo[:3] < 1.6).all() and (servo < 5).all(), servo


def deviations(moved: Mapping, paths: tuple[str, ...], told: list[np.ndarray]) -> np.ndarray:
    """Deviations that recordings leave of some numbers, the others known, over the file's."""
    own = [list(moved).index(path) for path in paths]
    return np.sqrt(np.diag(np.linalg.inv(np.sum(told, axis=0)[np.ix_(own, own)])))


@pytest.fixture
def few(monkeypatch):
    """Two swims: the choice between swim, servo and tail is the same, only sooner."""
    whole = next_swim.commands(FISH)
    chosen = {name: whole[name] for name in ("fluid-04", "fluid-09")}
    monkeypatch.setattr(next_swim, "commands", lambda fish: chosen)


def chosen(known: Mapping[str, tuple[float, float]]) -> Advice:
    return advise(FISH, needed(NAME), "speed", 1, draws=20, known=known)[0]


@pytest.mark.thorough
def test_whatever_is_in_doubt_is_recorded_first(few):
    found = chosen(about(TAIL, 0.5))
    assert found.kind == "tail condition" and found.gain > 0.2
    found = chosen(about(SERVO, 0.3))
    assert found.kind == "servo command" and found.gain > 0.2
    assert chosen({}).kind == "swim"
    assert chosen(about((*TAIL, *SERVO), 1e-4)).kind == "swim"


# ---- in the pool --------------------------------------------------------------------------------


def fitted(folder: Path, *names: str) -> tuple[Fish, Intervals]:
    """The fish with the servo that these recordings give, and the servo's intervals."""
    out = folder / f"{'-'.join(names)}.toml"
    logs = [folder / f"servo-{name}.csv" for name in names]
    tailbeat("identify", "servo", "--fish", NAME, "--fit", *logs, "--out", out, "--seeds", 1,
             "--generations", 60)  # fmt: skip
    return load_fish(out), {p: ends for p, ends in intervals(out).items() if p in SERVO}


def doubt(fish: Fish, known: Intervals, commands: Mapping[str, Recording]) -> np.ndarray:
    """What the servo's doubts do to these turns."""
    goals = swim_all([fish], list(as_played(commands, fish).values()))
    moved = doubted(fish, known)
    return next_recording.moved_goals(fish, moved, commands, goals, GOALS["turning"][1])


def motor_error(fish: Fish, commands: Mapping[str, Recording], real: list[Recording]) -> float:
    """Root mean square error of the shaft's angle in commanded swims [deg]."""
    played = as_played(commands, fish)
    away = [
        np.interp(played[one.name].track.time, one.time, one.columns["motor_angle_rad"])
        - np.asarray(played[one.name].motor)
        for one in real
    ]
    return float(np.degrees(np.sqrt(np.mean(np.concatenate(away) ** 2))))


@pytest.mark.slow
def test_the_advised_command_tells_most_about_a_servo_of_one_slow_recording(tmp_path):
    """A slow triangle never reaches the largest torque, on which hard turns depend. Steps reach it.
    A chirp does not, though it would if the torque were lower."""
    assert tailbeat("record", "servo", "--fish", "pulley-fish", "--out", tmp_path).returncode == 0
    whole = next_swim.commands(FISH)
    turns = {name: whole[name] for name in next_swim.of_kind(whole, FISH, "turn")}
    real = list(record_fluid(load_fish("pulley-fish"), 3, commands=tuple(turns.values())))
    first, known = fitted(tmp_path, "triangle")
    goals, offers = doubt(first, known, turns), bench_recordings(first, doubted(first, known))
    foretold, found, error = {}, {}, {}
    for name in ("steps", "chirp", "beat"):
        after, sure = fitted(tmp_path, "triangle", name)
        foretold[name] = left(goals, [offers[f"servo-{name}"].told]) ** 0.5
        found[name] = left(doubt(after, sure, turns), []) ** 0.5
        error[name] = motor_error(after, turns, real)
    assert list(foretold) == sorted(foretold, key=foretold.__getitem__)  # the order of the loop
    assert list(found) == sorted(found, key=found.__getitem__)
    assert error["steps"] < 0.3 * min(motor_error(first, turns, real), error["beat"])
    for name in foretold:
        assert 1 / 4 < foretold[name] / found[name] < 4
