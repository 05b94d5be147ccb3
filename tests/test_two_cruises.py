"""Two swims of the real fish cannot tell how fast it swims at other beats. Slow: ten minutes.

The proof: sets of numbers that fit both swims about equally well predict the four others within
1 mm/s, or twice as far off as the best fit. So no way of fitting these two swims can promise less.
"""

import numpy as np
import pytest
from scipy import stats

from tailbeat.fish.store import load_fish
from tailbeat.identify.fluid import SIGMA, fluid_space, owners, residual_function
from tailbeat.identify.polish import polish
from tailbeat.identify.runs import Run, as_runs
from tailbeat.identify.search import Effort, search
from tailbeat.identify.space import cost
from tailbeat.importers.fishsim import import_fishsim

FISH = load_fish("crank-fish")
FITTED, HELD_OUT = ("f1_00", "f1_75"), ("f0_50", "f0_75", "f1_50", "f2_25")
ASKED = 1e-3  # m/s: deviation with which a polish is held to the asked speeds
ALLOWED = stats.chi2.ppf(0.99, len(HELD_OUT))  # rise of the cost: four speeds are asked for


def runs(data, names: tuple[str, ...]) -> list[Run]:
    files = [data / "fishsim" / f"markers_{name}.csv" for name in names]
    return [run for file in files for run in as_runs(import_fishsim(file), FISH)]


@pytest.mark.slow
def test_two_cruises_leave_the_speed_of_the_others_open(data):
    two, others = runs(data, FITTED), runs(data, HELD_OUT)
    space = fluid_space(FISH, 3)
    alone = residual_function(FISH, two, space)
    best = search(alone, space, 0, Effort(generations=8)).z
    every, owner = residual_function(FISH, [*two, *others], space), owners(FISH, [*two, *others])
    speed = [int(np.flatnonzero(owner == 2 + i)[0]) for i in range(len(others))]
    true = np.array([run.gait.speed for run in others])

    def predicted(z: np.ndarray) -> np.ndarray:
        return true + every(z)[:, speed] * SIGMA.speed

    known = predicted(best[None])[0]
    least = float(cost(alone(best[None]), best[None])[0])
    print("best: cost", round(least, 1), "speeds", known.round(4), "measured", true.round(4))
    for name, asked in (("as measured", true), ("as far on the other side", 2 * known - true)):

        def held(z: np.ndarray, asked: np.ndarray = asked) -> np.ndarray:
            return np.concatenate([alone(z), (predicted(z) - asked) / ASKED], axis=1)

        z = polish(held, space, best, 12)
        rise = float(cost(alone(z[None]), z[None])[0]) - least
        off = np.abs(predicted(z[None])[0] - asked).mean()
        print(f"{name}: cost +{rise:.1f} (allowed {ALLOWED:.1f}), {1e3 * off:.1f} mm/s from it")
        assert off < 2 * ASKED
        assert rise < ALLOWED
    assert np.abs(known - true).mean() > 4e-3  # so the other side is far away
