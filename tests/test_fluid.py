"""Fluid identification: known coefficients come back where the data can tell, and are named
where they cannot."""

from dataclasses import replace

import numpy as np
import pytest

from synthetic import record
from tailbeat.files import BadInput
from tailbeat.fish.store import load_fish, value_at, with_values
from tailbeat.fish.water import whole
from tailbeat.identify import fluid
from tailbeat.identify.fluid import (
    COEFFICIENT_PRIORS,
    apply,
    fluid_space,
    insensitive,
    residual_function,
)
from tailbeat.identify.fluid_report import as_report, toml_values
from tailbeat.identify.job import FluidConfig, check, identify_fluid
from tailbeat.identify.predict import as_json, predict
from tailbeat.identify.runs import as_run
from tailbeat.identify.search import Effort

# With its added mass on: without it the fish swims backwards on middle-of-the-road coefficients and
# its heading is so unstable that two runs of one fish part.
PULLEY = with_values(load_fish("pulley-fish"), {"added_inertia": 1.0})
SIX = ((1.5, 0.5, 0.1), (2.2, 0.4, -0.25), (1.2, 0.6, 0.0), (1.8, 0.45, 0.15), (2.4, 0.35, 0.3),
       (1.5, 0.3, 0.4))  # fmt: skip
ASSUMED = {"added_inertia", "added_along", "simulation.integrator"}


def truth() -> dict[str, float]:
    """A draw from half the prior's spread, one number per zone and coefficient."""
    rng = np.random.default_rng(5)
    return {
        f"zones.{zone}.{name}": float(centre * np.exp(0.5 * spread * rng.normal()))
        for zone in PULLEY.zones
        for name, (centre, spread, _, _) in COEFFICIENT_PRIORS.items()
    }


def synthetic_runs(noise: float = 0.0):
    known = with_values(PULLEY, truth())
    return [
        as_run(record(known, "a", 1.5, 0.5, offset=0.1, noise=noise), PULLEY),
        as_run(record(known, "b", 2.2, 0.4, offset=-0.25, noise=noise, seed=1), PULLEY),
    ]


@pytest.mark.thorough
@pytest.mark.long
def test_known_coefficients_of_one_zone_come_back(tmp_path):
    """One set of five numbers for all zones; the slow test after this one has fifteen."""
    known = {path.replace(".fin.", ".*."): v for path, v in truth().items() if ".fin." in path}
    fish = apply(PULLEY, known)
    runs = [
        as_run(record(fish, "a", 1.5, 0.5, offset=0.1, noise=1e-3, seconds=3.0), PULLEY),
        as_run(record(fish, "b", 2.2, 0.4, offset=-0.25, noise=1e-3, seed=1, seconds=3.0), PULLEY),
    ]
    config = FluidConfig(
        zones=1, seeds=1, effort=Effort(generations=1, population=8, polish=6), draws=4
    )
    found = identify_fluid(PULLEY, runs, [], config, tmp_path)
    rows = found.estimates()
    decided = {path: row for path, row in rows.items() if row.decided}
    assert set(rows) == set(known) and len(decided) >= 1
    for path, row in decided.items():
        assert row.value == pytest.approx(known[path], rel=0.10), path
    inside = [row.interval[0] <= known[path] <= row.interval[1] for path, row in rows.items()]
    assert sum(inside) >= 4
    undecided = as_report(found, config)["undecided"]
    assert undecided and set(undecided) | set(decided) == set(rows)


@pytest.mark.slow  # some minutes of processor time
def test_known_coefficients_come_back_or_are_named(tmp_path):
    """Intervals are by swims: two swims decide one number of fifteen at most, these six two."""
    fish, config = with_values(PULLEY, truth()), FluidConfig(seeds=1, effort=Effort(generations=6))
    runs = [as_run(record(fish, str(i), *swim[:2], offset=swim[2], noise=1e-3, seed=i), PULLEY)
            for i, swim in enumerate(SIX)]  # fmt: skip
    found = identify_fluid(PULLEY, runs, [], config, tmp_path)
    rows, known = found.estimates(), truth()
    decided = {path: row for path, row in rows.items() if row.decided}
    assert len(decided) >= 2
    for path, row in decided.items():
        assert row.value == pytest.approx(known[path], rel=0.10), path
    inside = [row.interval[0] <= known[path] <= row.interval[1] for path, row in rows.items()]
    assert np.mean(inside) >= 0.9
    undecided = as_report(found, config)["undecided"]
    assert set(undecided) | set(decided) == set(rows) and undecided
    assert set(toml_values(found, ["a"])) == set(rows) | ASSUMED


def test_the_truth_has_no_residual():
    runs = synthetic_runs()
    space = fluid_space(PULLEY, 3)
    known = truth()
    z = np.array([[p.to_z(known[p.path]) for p in space]])
    assert np.abs(residual_function(PULLEY, runs, space)(z)).max() < 0.25


def test_mass_along_the_parts_is_free_where_it_is_below_that_across():
    """And known swims show it: at the prior they do not fit."""
    fish = with_values(whole(PULLEY), {**truth(), "added_along": 0.4})
    space = fluid_space(fish, 3)
    paths = [p.path for p in space]
    assert paths.count("added_along") == 1 and len(paths) == 18
    assert "added_along" not in [p.path for p in fluid_space(PULLEY, 3)]
    run = as_run(record(fish, "a", 1.5, 0.5, offset=0.1), fish)
    known = np.array([p.to_z(value_at(fish, p.path)) for p in space])
    other = np.where(np.array(paths) == "added_along", 0.0, known)
    here, there = np.abs(residual_function(fish, [run], space)(np.stack([known, other]))).max(1)
    assert here < 0.25 and there > 2


def test_start_counts_four_times_as_much_from_rest(monkeypatch):
    monkeypatch.setattr(fluid, "FIRST_POSITION", 1e-9)  # nothing is taken out for the first frame
    monkeypatch.setattr(fluid, "FIRST_YAW", 1e-9)
    runs = synthetic_runs(noise=1e-3)
    assert all(run.from_rest for run in runs)
    space = fluid_space(PULLEY, 1)
    z = np.zeros((1, len(space)))
    weighed, plain, asked = (
        residual_function(PULLEY, runs, space, choice)(z)[0] for choice in (None, False, True)
    )
    ratio = np.square(weighed / plain).reshape(2, fluid.SAMPLES, 3)
    assert ratio[:, 0] / ratio[:, -1] == pytest.approx(4.0, rel=1e-3)
    assert np.array_equal(weighed, asked)


@pytest.mark.thorough
def test_numbers_without_effect_are_named():
    """A motionless fin's coefficients cannot matter: a fin in a zone no part has."""
    zones = {**PULLEY.zones, "spare": PULLEY.zones["fin"]}
    fish = PULLEY.model_copy(update={"zones": zones})
    space = fluid_space(fish, 3)
    idle = insensitive(residual_function(fish, synthetic_runs()[:1], space), space)
    assert {f"zones.spare.{name}" for name in COEFFICIENT_PRIORS} <= set(idle)
    assert not any(path in idle for path in ("zones.fin.kutta", "zones.fin.blunt"))


def test_one_zone_sets_all_zones():
    fish = apply(PULLEY, {"zones.*.kutta": 2.0})
    assert {zone.kutta for zone in fish.zones.values()} == {2.0}
    assert len(fluid_space(PULLEY, 1)) == 5 and len(fluid_space(PULLEY, 3)) == 15


def test_predicting_its_own_swim_is_exact_and_forgets_the_recorded_speed():
    known = with_values(PULLEY, truth())
    runs = [as_run(record(known, "a", 1.5, 0.5), PULLEY)]
    result = as_json(predict(known, runs))
    assert result["speed_mae"] < 1e-3
    assert result["runs"][0]["marker_error"] < 2e-3
    assert {"recording", "measured_speed", "predicted_speed"} <= set(result["runs"][0])


def test_cruise_prediction_does_not_depend_on_the_recorded_speed(data):
    from tailbeat.importers.fishsim import import_fishsim

    fish = load_fish("crank-fish")
    run = as_run(import_fishsim(data / "fishsim" / "markers_f1_50.csv"), fish)
    faster = replace(run, gait=replace(run.gait, speed=2 * run.gait.speed))
    once, twice = (predict(fish, [r])[0].gait.speed for r in (run, faster))
    assert once == pytest.approx(twice, rel=0.01)


def test_recordings_that_do_not_fit_the_fish_are_refused():
    recording = record(PULLEY, "a", 1.5, 0.3)
    without = {k: v for k, v in recording.columns.items() if k != "motor_angle_rad"}
    with pytest.raises(BadInput, match="motor_angle_rad is missing"):
        as_run(replace(recording, columns=without), PULLEY)
    with pytest.raises(BadInput, match=r"yaw_rad is missing"):
        cruise = {"x_m": recording.time, "y_m": recording.time}
        as_run(replace(recording, columns=cruise), load_fish("crank-fish"))
    degrees = {**recording.columns, "motor_angle_rad": 57.3 * recording.columns["motor_angle_rad"]}
    with pytest.raises(BadInput, match=r"outside motor\.range -1\.396 to 1\.396"):
        as_run(replace(recording, columns=degrees), PULLEY)
    with pytest.raises(BadInput, match=r"marker8_x_m \(the fin tip\) is missing"):
        as_run(replace(recording, columns=without), load_fish("crank-fish"))


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"draws": 0}, "--draws 0: give 1 or more"),
        ({"seeds": 0}, "--seeds 0"),
        ({"zones": 2}, "--zones 2"),
    ],
)
def test_a_config_that_is_not_allowed_is_refused(wrong, said):
    with pytest.raises(BadInput, match=said):
        check(FluidConfig(**wrong))
