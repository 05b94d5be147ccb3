"""Bands of the shipped fish hold in its water, and after check swims in eight others: for swims of
the protocol, for other check swims, and for those of a policy. Slow."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from tailbeat.control.policy import decide, load_policy
from tailbeat.env.world import seeds_from
from tailbeat.evaluate.evaluation import EvaluationConfig, conditions_of, pool_of
from tailbeat.evaluate.runs import as_recordings
from tailbeat.evaluate.trial import swim
from tailbeat.fish.store import load_fish
from tailbeat.identify import posterior as store
from tailbeat.identify.bands import Band, Drawn, bands, count, discrepancy, swim_all
from tailbeat.identify.manoeuvres import manoeuvres
from tailbeat.identify.protocol import fluid_runs, limits
from tailbeat.identify.runs import as_runs
from tailbeat.pool.protocols import record_check, record_fluid
from tailbeat.pool.water import Water, ensemble

TWIN, POOL = load_fish("pulley-fish-pool"), load_fish("pulley-fish")
WATERS = ensemble(9, seed=4)[1:]
# Half width of a band over the error, median of the four quantities. Asked are 4; the twin errs
# less on a policy's swims than check swims tell, so its bands are wider than that.
WIDEST, FEW = 5.5, 6.0
NARROW = 4.6  # of speed and distance after check swims; 5.3 before draws had factors of their own


@pytest.fixture(scope="module")
def drawn():
    known = store.of("pulley-fish-pool")
    assert known is not None
    return known, store.fishes(TWIN, known, 32)


def swum(fishes, recordings) -> list[Drawn]:
    runs = [run for one in recordings for run in as_runs(one, TWIN)]
    return swim_all(fishes, runs)


def protocol(seed: int, water: Water, first: int):
    """Every third swim of the protocol."""
    limit = limits(POOL)
    commands = list({**fluid_runs(POOL, limit), **manoeuvres(POOL, limit)}.values())
    return record_fluid(POOL, seed, water=water, commands=commands[first::3])


def of_policy(seed: int, water: Water, count: int):
    """Swims of the default policy to targets all around it."""
    policy = load_policy("pulley-fish-pool-reach")
    pool = pool_of(policy, EvaluationConfig(pool="full", episodes=count, seed=seed))
    found = conditions_of(replace(pool, waters=(water,)), ["reach"])
    (open_water,) = (one for one in found if one.name == "reach open")
    runs = swim(partial(decide, policy), open_water, seeds_from(seed, count))
    return as_recordings(runs, f"policy {seed}")


def judge(name: str, found: list[Band], least: float, widest: float = WIDEST) -> None:
    """Print and check how many hold, and that bands are no wider than they need be."""
    for row in count(found):
        wide = row.half_width / row.error
        print(f"{name}: {row.quantity} {row.inside} of {row.swims}, {wide:.1f} times the error")
        assert row.inside >= least * row.swims, row
    assert np.median([row.half_width / row.error for row in count(found)]) <= widest


@pytest.mark.slow
def test_bands_hold_fresh_swims_in_the_fish_s_own_water(drawn):
    known, fishes = drawn
    for name, recordings in (
        ("protocol", protocol(7, Water(), 2)),
        ("check", record_check(POOL, 11)),
        ("policy", of_policy(12, Water(), 30)),
    ):
        found = [b for one in swum(fishes, recordings) for b in bands(one, known.discrepancy)]
        judge(name, found, 0.75, FEW)
    assert known.discrepancy is not None and known.discrepancy.swims == 15


@pytest.mark.slow
def test_in_other_waters_check_swims_make_the_bands_hold_again(drawn):
    """Without them the bands of a fish from another water hold less often than they say. The naive
    predictor is the fish itself: with the factor of its check swims it errs half as much."""
    known, fishes = drawn
    stale: list[Band] = []
    found: dict[str, list[Band]] = {"check": [], "protocol": [], "policy": []}
    naive: dict[str, list[float]] = {}
    for number, water in enumerate(WATERS):
        seen = discrepancy(swum(fishes, record_check(POOL, 40 + number, water=water)))
        fresh = {
            "check": swum(fishes, record_check(POOL, 60 + number, water=water)),
            "protocol": swum(fishes, protocol(80 + number, water, number % 3)),
            "policy": swum(fishes, of_policy(100 + number, water, 16)),
        }
        stale += [band for one in fresh["check"] for band in bands(one, known.discrepancy)]
        for name, swims in fresh.items():
            found[name] += [band for one in swims for band in bands(one, seen)]
            naive.setdefault(name, []).extend(abs(d.measured[0] - d.centre[0]) for d in swims)
    held = np.mean([band.inside for band in stale])
    print(f"without check swims {100 * held:.0f} % hold")
    assert held < 0.8
    for name, own in found.items():
        judge(name, own, least=0.88)
        speed, distance, *_ = count(own)
        assert max(row.half_width / row.error for row in (speed, distance)) < NARROW
        alone = np.median(naive[name])
        print(f"{name}: speed off by {speed.error:.4f} m/s, by the fish alone {alone:.4f} m/s")
        assert speed.error < 0.5 * alone
