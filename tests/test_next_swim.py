"""What to record next: what tells most about what is asked."""

import json
from dataclasses import replace

import numpy as np
import pytest

from support import tailbeat
from tailbeat.files import BadInput
from tailbeat.fish.store import load_fish
from tailbeat.identify import next_swim
from tailbeat.identify import posterior as store
from tailbeat.identify.bands import Drawn, swim_all
from tailbeat.identify.manoeuvres import manoeuvres
from tailbeat.identify.next_recording import Advice, Doubts, advise
from tailbeat.identify.next_recording import choose as choose_from
from tailbeat.identify.next_swim import as_played, recording_of, spread_after
from tailbeat.identify.protocol import RATE, limits
from tailbeat.recording import Recording
from test_posterior import FISH, my_fish, posterior


def made(name: str, seconds: float, predicted: np.ndarray) -> Drawn:
    time = np.arange(0, seconds, 0.02)
    run = as_played({name: Recording(name, time, {"command_rad": np.sin(time)})}, FISH)[name]
    return Drawn(run, predicted[0], predicted)


def case(seed: int = 0) -> tuple[np.ndarray, dict[str, Drawn]]:
    """Draws of two unknown numbers; the goal is the sum of both. Each of three swims shows one
    number or none, beside three columns that never change."""
    rng = np.random.default_rng(seed)
    first, second = rng.normal(size=(2, 400))
    still = np.zeros((400, 3))
    swims = {
        "first": made("first", 10, np.column_stack([3 * first, still])),
        "second": made("second", 10, np.column_stack([0.2 * second, still])),
        "nothing": made("nothing", 10, np.column_stack([0 * first, still])),
    }
    return (2 * first + second)[:, None], swims


def shown(swims: dict[str, Drawn], other: tuple[str, ...] = ()) -> dict:
    """Candidates with what they would show; the `other` ones are of another kind than the goal."""
    return {name: recording_of(one, None, name not in other) for name, one in swims.items()}


def choose(goals: np.ndarray, offers: dict, count: int) -> list[Advice]:
    """The best swims; test benches leave no doubt."""
    return choose_from(Doubts(goals, np.zeros((0, goals.shape[1]))), offers, count)


def test_what_tells_most_comes_first_and_what_it_told_counts_no_more():
    goals, swims = case()
    swims["first again"] = made("first again", 10, swims["first"].predicted)
    found = choose(goals, shown(swims), 4)
    assert found[0].record.startswith("first")
    assert found[1].record == "second"
    assert found[2].gain < 0.01 and found[3].gain < 0.01


def test_a_long_swim_must_tell_more():
    goals, swims = case()
    swims = {"long": made("long", 60, swims["first"].predicted), "short": swims["first"]}
    assert choose(goals, shown(swims), 1)[0].record == "short"


def test_a_swim_of_another_kind_tells_less():
    """The law of the water errs in its own way there: 10 % of a speed."""
    goals, swims = case()
    fast = swims["first"].predicted + 1000.0 * (np.arange(4) == 0)
    swims = {"like": swims["second"], "unlike": made("unlike", 10, fast)}
    assert choose(goals, shown(swims), 1)[0].record == "unlike"
    assert choose(goals, shown(swims, ("unlike",)), 1)[0].record == "like"


def test_the_spread_left_is_that_of_the_linear_estimate():
    """Seeing x + noise of deviation 1 of a normal x of deviation 3 leaves sqrt(9 / 10) of it."""
    x = 3 * np.random.default_rng(1).normal(size=(20000, 1))
    assert spread_after(x, []) == pytest.approx(3.0, rel=0.02)
    assert spread_after(x, [x]) == pytest.approx(np.sqrt(9 / 10), rel=0.02)


def test_a_draw_that_diverged_is_left_out():
    goals, swims = case()
    broken = swims["first"].predicted.copy()
    broken[3] = np.inf
    left = spread_after(goals, [broken])
    assert left == pytest.approx(spread_after(goals, [swims["first"].predicted]), rel=0.02)


def test_a_command_is_swum_as_the_servo_follows_it():
    """A dash jumps by 1.4 rad between two rows, which no shaft does."""
    commands = dict(list(manoeuvres(FISH, limits(FISH)).items())[::9])
    assert any(name.endswith("dash") for name in commands)
    for name, run in as_played(commands, FISH).items():
        assert run.motor is not None and np.abs(np.diff(run.motor)).max() < 6.0 / RATE
        (swum,) = swim_all([FISH], [run])
        assert np.isfinite(swum.predicted).all(), name
        assert run.from_rest == ("launch" not in name)


@pytest.fixture
def few(monkeypatch):
    """The protocol's turns and two of its other swims: the choice is the same, only shorter."""
    whole = next_swim.commands(FISH)
    chosen = {n: r for n, r in whole.items() if n.endswith("turn") or n in ("fluid-01", "fluid-06")}
    monkeypatch.setattr(next_swim, "commands", lambda fish: chosen)


@pytest.mark.thorough
def test_a_turn_tells_most_about_turning(few):
    """The unknown number is the drag across the fin, which a fast turn shows."""
    known = posterior(fitted=("fluid-01",))
    found = advise(FISH, known, "turning", 2, draws=5)
    assert "turn" in found[0].record and found[0].gain > 0
    assert "fluid-01" not in [one.record for one in found]
    with pytest.raises(BadInput, match="allowed are speed, turning, reach"):
        advise(FISH, known, "glory")


def test_without_a_posterior_the_command_says_how_to_write_it(tmp_path):
    fish = my_fish(tmp_path)
    done = tailbeat("identify", "next", "--fish", fish)
    assert done.returncode == 2 and "tailbeat identify posterior" in done.stderr
    done = tailbeat("identify", "next", "--fish", fish, "--count", 0)
    assert done.returncode == 2 and "--count 0: give 1 or more" in done.stderr


@pytest.mark.thorough
def test_the_command_prints_and_writes_its_advice(tmp_path, few):
    fish, out = my_fish(tmp_path), tmp_path / "next.json"
    own = load_fish(fish)
    known = posterior(own)
    store.write(store.beside(fish), replace(known, draws=known.draws[:3]))
    done = tailbeat("identify", "next", "--fish", fish, "--count", 1, "--json", out)
    assert done.returncode == 0, done.stderr
    assert "band shrinks by [%]" in done.stdout
    assert len(json.loads(out.read_text())["recordings"]) == 1
