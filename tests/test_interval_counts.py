"""How often intervals hold the truth, counted over many fits. Slow: a quarter of an hour."""

import numpy as np
import pytest

from synthetic import record
from tailbeat.fish.store import load_fish, with_values
from tailbeat.identify.fluid import COEFFICIENT_PRIORS, apply
from tailbeat.identify.job import FluidConfig, identify_fluid
from tailbeat.identify.runs import as_run
from tailbeat.identify.search import Effort

PULLEY = with_values(load_fish("pulley-fish"), {"added_inertia": 1.0})
SETS = 20
SWIMS = ((1.2, 0.6, 0.0), (1.8, 0.45, 0.15), (2.4, 0.35, -0.25), (1.5, 0.3, 0.4), (2.1, 0.5, 0.0))


def truth(seed: int) -> dict[str, float]:
    """One set of five numbers, from half the prior's spread."""
    rng = np.random.default_rng([seed, 1])
    return {
        f"zones.*.{name}": float(centre * np.exp(0.5 * spread * rng.normal()))
        for name, (centre, spread, _, _) in COEFFICIENT_PRIORS.items()
    }


def fitted(seed: int, scratch) -> list[tuple[str, bool, bool]]:
    """Field, whether the data decide it, and whether its interval holds the truth."""
    known = truth(seed)
    fish = apply(PULLEY, known)
    runs = [
        as_run(record(fish, str(i), *swim[:2], offset=swim[2], noise=1.5e-3, seed=9 * seed + i),
               PULLEY)
        for i, swim in enumerate(SWIMS)
    ]  # fmt: skip
    config = FluidConfig(zones=1, seeds=1, effort=Effort(generations=6), draws=1)
    rows = identify_fluid(PULLEY, runs, [], config, scratch / str(seed)).estimates()
    return [
        (path, row.decided, row.interval[0] <= known[path] <= row.interval[1])
        for path, row in rows.items()
    ]


@pytest.mark.slow
def test_decided_numbers_of_twin_made_sets_lie_in_their_intervals(tmp_path):
    found = [row for seed in range(SETS) for row in fitted(seed, tmp_path)]
    decided = [inside for _, known, inside in found if known]
    held = sum(inside for _, _, inside in found)
    print(f"decided: {sum(decided)} of {len(decided)}; all: {held} of {len(found)}")
    assert len(decided) >= 2 * SETS  # a fit that decides nothing would hold everything
    assert np.mean(decided) >= 0.90
    assert np.mean([inside for _, _, inside in found]) >= 0.90
