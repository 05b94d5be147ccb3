"""The line that a training prints into a pipe."""

import math

import pytest

from tailbeat.cli import progress
from tailbeat.train.progress import TrainingRow


@pytest.mark.parametrize(
    ("third", "named"),
    [(5.0, "bonus 5"), (math.nan, "bonus nan"), (-5.0, "nearness and velocity -5")],
)
def test_the_reward_s_third_term_is_named(capsys, third, named):
    """NaN: no episode has ended yet."""
    row = TrainingRow(60.0, 1, "exact", 0.5, 9, 900, 90, 9.0, 0.9, -1.0, -1.0, third, 5.0, 0)
    with progress.training() as report:
        report(row)
    out = capsys.readouterr()
    assert f"effort -1 {named}, control steps" in out.out + out.err
