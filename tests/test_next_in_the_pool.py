"""Three swims that `identify next` chose against three chosen by chance, in the virtual pool. Slow:
about half an hour."""

from collections.abc import Sequence

import numpy as np
import pytest

from tailbeat.fish.description import Fish
from tailbeat.fish.store import digest, load_fish
from tailbeat.fish.water import whole
from tailbeat.identify import posterior as store
from tailbeat.identify.check_swims import check_swims
from tailbeat.identify.job import FluidConfig, Identified, identify_fluid
from tailbeat.identify.manoeuvres import manoeuvres
from tailbeat.identify.next_swim import advise
from tailbeat.identify.predict import LONG
from tailbeat.identify.protocol import fluid_runs, limits
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


def recorded(commands: Sequence[Recording], seed: int) -> list[Run]:
    swims = record_fluid(POOL, seed, commands=tuple(commands))
    return [run for one in swims for run in as_runs(one, TWIN)]


def fitted(runs: Sequence[Run], scratch) -> Identified:
    config = FluidConfig(seeds=1, effort=Effort(generations=8), draws=60)
    return identify_fluid(TWIN, runs, [], config, scratch)


def turning_error(fish: Fish, judged: Sequence[Run]) -> float:
    """Mean absolute error of the heading [deg] after the first seconds of swims not fitted."""
    errors = []
    for run, done in zip(judged, repeat([fish], judged, LONG)[0], strict=True):
        speed = twin_gait(fish, run, done, LONG).speed
        told = measure(camera_track(fish, run, done), run, speed)
        errors.append(abs(told[2] - measure(run.track, run, run.gait.speed)[2]))
    return float(np.nanmean(errors))


@pytest.mark.slow
def test_three_chosen_swims_beat_three_by_chance(tmp_path):
    """The goal is turning. Every fit has six steady swims; the judges are turns and swims of other
    seeds."""
    base = recorded(list(STEADY.values())[::2], 0)
    turns = [command for name, command in OTHERS.items() if name.endswith("turn")]
    unlike = [run for one in record_check(POOL, 31) for run in as_runs(one, TWIN)]
    judged = [*recorded(turns, 30), *unlike]
    first = fitted(base, tmp_path / "base")
    known = store.drawn_for(first.fish, first.space, first.draws, base, ())
    assert known.fish_digest == digest(first.fish)
    names = [one.swim for one in advise(first.fish, known, "turning", ADDED)]
    print("before:", round(turning_error(first.fish, judged), 2))
    rng, results = np.random.default_rng(0), {}
    tried = {"chosen": names}
    for i in range(TRIPLES):
        tried[str(i)] = rng.choice(sorted(OTHERS), ADDED, replace=False).tolist()
    for label, chosen in tried.items():
        commands = [{**STEADY, **OTHERS}[name] for name in chosen]
        one = fitted([*base, *recorded(commands, 50)], tmp_path / label)
        results[label] = turning_error(one.fish, judged)
        print(f"{label}: {', '.join(chosen)}: {results[label]:.2f} deg", flush=True)
    chance = [value for label, value in results.items() if label != "chosen"]
    assert results["chosen"] <= np.median(chance)
