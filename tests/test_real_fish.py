"""The crank fish, fitted on two real swims, predicts the others."""

from collections.abc import Sequence
from pathlib import Path

import pytest

from tailbeat.fish.store import load_fish
from tailbeat.identify.job import FluidConfig, identify_fluid
from tailbeat.identify.predict import Prediction, predict, speed_mae
from tailbeat.identify.runs import Run, as_run
from tailbeat.identify.search import Effort
from tailbeat.importers.fishsim import import_fishsim

HELD_OUT = ("f0_50", "f0_75", "f1_50", "f2_25")


def swims(data: Path, *names: str) -> list[Run]:
    fish = load_fish("crank-fish")
    return [as_run(import_fishsim(data / "fishsim" / f"markers_{n}.csv"), fish) for n in names]


def amplitudes_agree(predictions: Sequence[Prediction]) -> bool:
    found = [one.gait.tail_amplitude for one in predictions]
    return found == pytest.approx([one.run.gait.tail_amplitude for one in predictions], rel=0.2)


@pytest.mark.thorough
def test_starting_values_already_swim_as_the_beats_rank(data):
    """Nothing is fitted: the middle of the search swims up to 60 mm/s too fast, but in order."""
    found = predict(load_fish("crank-fish"), swims(data, *HELD_OUT))
    assert all(prediction.settled for prediction in found)
    speeds = [prediction.gait.speed for prediction in found]
    assert speeds == sorted(speeds)
    assert 0.012 < speed_mae(found) < 0.06  # so the fit below has something to find
    assert amplitudes_agree(found)


@pytest.mark.slow  # half a minute and three minutes of processor time
@pytest.mark.parametrize(
    ("zones", "effort"),
    [(1, Effort(generations=1, population=8, polish=1)), (3, Effort(generations=10))],
    ids=["one", "three"],
)
def test_fitted_on_two_swims_the_others_are_within_12_mm_per_second(data, tmp_path, zones, effort):
    """The authors' own code and coefficients score 20 mm/s over their eight runs."""
    config = FluidConfig(zones=zones, seeds=1, effort=effort, draws=4)
    fit, held = swims(data, "f1_00", "f1_75"), swims(data, *HELD_OUT)
    found = identify_fluid(load_fish("crank-fish"), fit, held, config, tmp_path)
    assert speed_mae(found.fitted) < 0.004
    assert speed_mae(found.validated) < 0.012
    assert all(prediction.settled for prediction in (*found.fitted, *found.validated))
    assert amplitudes_agree(found.validated)
