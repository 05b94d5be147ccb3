"""Results of a sweep: trials and kinds, the rule by which one is chosen, messy labs."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tailbeat.cli.sweep import _check_same
from tailbeat.cluster import plan, summary, trial
from tailbeat.cluster.summary import TrialRow
from tailbeat.evaluate.rates import of_kind
from tailbeat.files import BadInput, write_json
from tailbeat.report import sweep
from test_sweep import tiny


def row(name: str, passed: float, swum: float, updates: float = 100.0) -> TrialRow:
    return TrialRow(name, "g", 0, "done", "", "", passed, 10, updates, 1.0, 200, swum, 50, swum)


def in_labs(name: str, swum: float, clean: float) -> TrialRow:
    return replace(row(name, 10, clean), everyday=swum, rough=swum, wrecked=swum)


@pytest.mark.parametrize(
    ("rows", "chosen"),
    [
        ([row("a", 9, 1.0), row("b", 10, 0.5)], "b"),
        ([row("a", 10, 0.6), row("b", 10, 0.5)], "a"),
        ([row("a", 10, 0.5, 20), row("b", 10, 0.5, 10)], "b"),
        ([replace(row("a", 10, 1.0), state="failed"), row("b", 1, 0.0)], "b"),
        ([in_labs("a", 0.4, clean=1.0), in_labs("b", 0.5, clean=0.9)], "b"),
        ([], ""),
    ],
)
def test_the_chosen_trial_follows_the_rule(rows, chosen):
    assert summary._chosen(rows) == chosen


def test_an_interval_is_over_seeds_and_targets(tmp_path):
    """Three seeds that all miss the same fifth of the targets say little of other targets. Over
    their three equal rates alone, Student's t gave an interval without a width."""
    hits = np.arange(50) % 5 > 0
    rows = [replace(row(name, 10, 0.8), folder=str(tmp_path / name)) for name in "abc"]
    for name in "abc":
        write_json(tmp_path / name / "result.json", {"hits": {"twin": hits.tolist(), "open": []}})
    found = summary._group("g", rows)
    assert found.twin == 0.8 and found.twin_interval == of_kind(np.tile(hits, (3, 1))).interval
    assert np.diff(found.twin_interval)[0] > 0.2
    assert found.open == pytest.approx(0.8) and np.isnan(found.open_interval).all()
    none = summary._group("g", [replace(row("a", 0, 0.0), state="not done")])
    assert none.seeds == 0 and np.isnan([none.twin, *none.twin_interval]).all()


@pytest.mark.slow
def test_a_trial_swims_in_messy_labs_where_the_sweep_asks_for_it(tmp_path):
    """A policy of two seconds reaches little; each level is swum to the same two targets."""
    path = tiny(tmp_path, seeds=1, seconds=2.0)
    path.write_text(path.read_text() + "[evaluate]\nepisodes = 2\nmessy = true\n")
    asked = plan.read(path)
    made = plan.trials(asked)
    folder = tmp_path / "out" / "trials" / made[0].name
    write_json(folder / "trial.json", {"sweep": asked.model_dump(mode="json"), "trial": made[0]})
    trial.swim(folder)
    done = summary.collect(tmp_path / "out", made, {})
    swum = [done.trials[0].everyday, done.trials[0].rough, done.trials[0].wrecked]
    held = json.loads((folder / "result.json").read_text())
    assert swum == [np.mean(held["hits"][name]) for name in ("everyday", "rough", "wrecked")]
    assert {len(hits) for hits in held["hits"].values()} == {2, 4}
    assert done.groups[0].rough == done.trials[0].rough
    assert "wrecked [%]" in sweep.trials(done)[0] and "rough [%]" in sweep.kinds(done)[0]


def test_a_sweep_begun_before_a_field_came_goes_on_without_it(tmp_path):
    path, out = tiny(tmp_path), tmp_path / "out"
    path.write_text(path.read_text() + "[evaluate]\n")
    asked = plan.read(path)
    held = asked.model_dump(mode="json")
    del held["evaluate"]["messy"]
    write_json(out / "sweep.json", held)
    _check_same(path, asked, out)
    with pytest.raises(BadInput, match=r"evaluate.messy was False, now True"):
        asked = asked.model_copy(update={"evaluate": plan.Evaluated(messy=True)})
        _check_same(path, asked, out)
    (out / "sweep.json").write_text('{"vary": {"fish": ["f"], "tails": 2}}')
    with pytest.raises(BadInput, match="not a sweep that this release can read"):
        _check_same(path, asked, out)
