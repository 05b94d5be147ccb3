"""Swims that `identify next` chose against swims by chance, in the pool. Slow: half an hour.

Every fit has six steady swims and three others. Judged are fresh swims of the goal's kind, with
commands that nobody could choose.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from tailbeat.fish.description import Fish
from tailbeat.fish.store import digest, load_fish
from tailbeat.fish.water import whole
from tailbeat.identify import posterior as store
from tailbeat.identify.check_swims import check_swims
from tailbeat.identify.job import FluidConfig, Identified, identify_fluid
from tailbeat.identify.manoeuvres import SECONDS, Beat, manoeuvres, played
from tailbeat.identify.next_recording import advise
from tailbeat.identify.posterior import Posterior
from tailbeat.identify.predict import LONG
from tailbeat.identify.protocol import RATE, fluid_runs, limits
from tailbeat.identify.quantities import measure
from tailbeat.identify.runs import Run, as_runs, camera_track, repeat, twin_gait
from tailbeat.identify.search import Effort
from tailbeat.pool.protocols import record_check, record_fluid
from tailbeat.recording import Recording

POOL, TWIN = load_fish("pulley-fish"), whole(load_fish("pulley-fish-pool"))
LIMIT = limits(POOL)
STEADY = fluid_runs(POOL, LIMIT)
OTHERS = {**manoeuvres(POOL, LIMIT), **check_swims(POOL, LIMIT)}
ADDED, TRIPLES = 3, 4
# Hz, fraction of the stroke, rad: none is one of the protocol's turns
TURNS = (
    (2.0, 0.5, 0.7), (2.2, 0.7, -0.7), (1.5, 0.6, 0.75), (2.8, 0.4, -0.65), (1.2, 0.7, -0.8),
    (1.8, 0.4, 0.6),
)  # fmt: skip


@dataclass(frozen=True)
class Tried:
    """What is known from the first six swims, and the fish fitted to these and three by chance."""

    base: list[Run]
    first: Identified
    known: Posterior
    chance: list[Fish]
    scratch: Path


def recorded(commands: Sequence[Recording], seed: int) -> list[Run]:
    return runs_of(record_fluid(POOL, seed, commands=tuple(commands)))


def runs_of(swims: Iterable[Recording]) -> list[Run]:
    return [run for one in swims for run in as_runs(one, TWIN)]


def fitted(runs: Sequence[Run], scratch: Path) -> Identified:
    config = FluidConfig(seeds=1, effort=Effort(generations=8), draws=60)
    return identify_fluid(TWIN, runs, [], config, scratch)


def added(base: Sequence[Run], names: Sequence[str], scratch: Path) -> Fish:
    """The fish fitted to the first swims and those of these names."""
    commands = [{**STEADY, **OTHERS}[name] for name in names]
    return fitted([*base, *recorded(commands, 50)], scratch).fish


@pytest.fixture(scope="module")
def tried(tmp_path_factory) -> Tried:
    scratch = tmp_path_factory.mktemp("fits")
    base = recorded(list(STEADY.values())[::2], 0)
    first = fitted(base, scratch / "base")
    known = store.drawn_for(first.fish, first.space, first.draws, base, ())
    assert known.fish_digest == digest(first.fish)
    rng = np.random.default_rng(0)
    chance = [rng.choice(sorted(OTHERS), ADDED, replace=False).tolist() for _ in range(TRIPLES)]
    fishes = [added(base, names, scratch / str(i)) for i, names in enumerate(chance)]
    return Tried(base, first, known, fishes, scratch)


def turns() -> list[Run]:
    rows = [played(LIMIT, [Beat(SECONDS, *one)])[0] for one in TURNS]
    time = np.arange(rows[0].size) / RATE
    meta = {"rate_hz": f"{RATE:g}", "begin": "middle"}
    return recorded(
        [Recording(f"{i}", time, {"command_rad": r}, meta) for i, r in enumerate(rows)], 33
    )


def wandering() -> list[Run]:
    return runs_of(one for one in record_check(POOL, 31) if one.name.endswith("wander"))


def heading_error(fish: Fish, judged: Sequence[Run]) -> float:
    """Mean absolute error of the heading [deg] after the first seconds of swims not fitted."""
    errors = []
    for run, done in zip(judged, repeat([fish], judged, LONG)[0], strict=True):
        speed = twin_gait(fish, run, done, LONG).speed
        told = measure(camera_track(fish, run, done), run, speed)
        errors.append(abs(told[2] - measure(run.track, run, run.gait.speed)[2]))
    return float(np.nanmean(errors))


def compared(tried: Tried, goal: str, judged: Sequence[Run]) -> tuple[float, list[float]]:
    """Heading errors [deg] with three chosen swims, and with three by chance each time."""
    names = [one.record for one in advise(tried.first.fish, tried.known, goal, ADDED)]
    found = heading_error(added(tried.base, names, tried.scratch / goal), judged)
    chance = [heading_error(fish, judged) for fish in tried.chance]
    before = heading_error(tried.first.fish, judged)
    print(f"\n{goal}: before {before:.1f} deg; {', '.join(names)}: {found:.1f}; by chance", chance)
    return found, chance


@pytest.mark.slow
def test_three_swims_chosen_for_turning_beat_three_by_chance(tried):
    found, chance = compared(tried, "turning", turns())
    assert found < 0.5 * min(chance)


@pytest.mark.slow
def test_three_swims_chosen_for_reach_are_no_worse_than_three_by_chance(tried):
    """They are no better either. Ranked without regard to their kind they were 2.8 times as bad."""
    found, chance = compared(tried, "reach", wandering())
    assert found < 1.5 * np.median(chance)
