"""Replayed swims of any motion, with and without a recorded heading, predicted by the twin."""

import json
from dataclasses import replace

import numpy as np
import pytest

from synthetic import clock_of, filmed, record
from tailbeat.cli import predict as verb
from tailbeat.files import BadInput
from tailbeat.fish.store import load_fish, value_at, with_values
from tailbeat.identify import kinematic
from tailbeat.identify.fluid import apply, fluid_space, residual_function
from tailbeat.identify.gait import Track, ground_distance, steady_beat, way
from tailbeat.identify.predict import as_json, predict, row
from tailbeat.identify.runs import Run, as_run
from tailbeat.recording import Recording, crop, write_recording
from tailbeat.report import identified
from tailbeat.report.figures import measured_against_twin, speeds

FISH = with_values(load_fish("pulley-fish"), {"added_inertia": 1.0})
OTHER = with_values(FISH, {f"zones.{zone}.kutta": 0.5 for zone in FISH.zones})


def wandering(seconds: float = 6.0) -> Recording:
    """A motor that is led about without a beat, as a policy may lead it."""
    clock = clock_of(FISH, seconds)
    rng = np.random.default_rng(3)
    rates = rng.uniform(0.2, 3.0, 12)
    sines = np.sin(2 * np.pi * np.outer(rates, clock) + rng.uniform(0, 6, 12)[:, None])
    angle = np.minimum(clock, 1.0) * (0.35 / np.sqrt(6) * sines.sum(axis=0))
    return filmed(FISH, "wandering", np.clip(angle, -1.2, 1.2), seconds=seconds)


def without_yaw(recording: Recording, turn: float = 0.0, mirror: bool = False) -> Recording:
    """The recording in a turned (or mirrored) world frame, its heading dropped."""
    x, y = recording.columns["x_m"], recording.columns["y_m"] * (-1 if mirror else 1)
    place = {
        "x_m": 0.7 + np.cos(turn) * x - np.sin(turn) * y,
        "y_m": -0.2 + np.sin(turn) * x + np.cos(turn) * y,
    }
    motor = {"motor_angle_rad": recording.columns["motor_angle_rad"]}
    return replace(recording, columns={**motor, **place})


def predicted(recording: Recording, fish=FISH) -> dict:
    return as_json(predict(fish, [as_run(recording, fish)]))["runs"][0]


# ---- any frequency ------------------------------------------------------------------------------


def test_a_beat_below_the_band_is_replayed_with_its_gait():
    found = predicted(record(FISH, "slow", 0.5, 0.8, seconds=8.0))
    assert found["beat_frequency"] == pytest.approx(0.58, abs=0.03)  # swept from 0.5 to 0.65 Hz
    assert found["position_error_share"] < 0.01
    assert found["measured_stride"] == pytest.approx(found["predicted_stride"], rel=0.05)


def test_a_motion_without_a_beat_is_judged_by_its_path():
    found = predicted(wandering())
    gait = ("beat_frequency", "beats", "measured_stride", "predicted_stride", "measured_strouhal")
    assert all(found[name] is None for name in gait)
    assert found["position_error_share"] < 0.02 and abs(found["heading_error_deg"]) < 1
    assert found["measured_speed"] == pytest.approx(found["predicted_speed"], abs=1e-3)
    assert predicted(wandering(), OTHER)["position_error_share"] > 0.1


def test_less_than_two_beats_and_a_motor_at_rest_are_replayed():
    swum = record(FISH, "a", 1.5, 0.5)
    found = predicted(crop(swum, 0.0, 0.9))
    assert found["beat_frequency"] is None and np.isfinite(found["marker_error"])
    with pytest.raises(BadInput, match=r"lasts 0\.05 s; a swim lasts 0\.5 s or more"):
        predicted(crop(swum, 1.0, 1.06))
    still = filmed(FISH, "still", np.zeros(clock_of(FISH, 3.0).size), seconds=3.0)
    found = predicted(still)
    assert found["beat_frequency"] is None and found["marker_error"] < 1e-6
    assert found["measured_speed"] == pytest.approx(0, abs=1e-6)


def test_a_beat_is_steady_only_where_one_sine_explains_it():
    time = np.arange(0, 10, 0.02)
    beat = np.sin(2 * np.pi * 1.3 * time)
    assert steady_beat(time, beat, (1.0, 4.0)) == pytest.approx(1.3, rel=1e-3)
    assert steady_beat(time, np.sin(2 * np.pi * 0.35 * time), (1.0, 4.0)) == pytest.approx(
        0.35, rel=1e-3
    )
    turn = np.clip((time - 4) / 2, 0, 1)  # outweighs the beat, but not the beat's rate
    assert steady_beat(time, turn + 0.2 * beat, (1.0, 4.0)) == pytest.approx(1.3, rel=1e-2)
    assert np.isnan(steady_beat(time, np.zeros_like(time), (1.0, 4.0)))
    assert np.isnan(steady_beat(time, np.random.default_rng(0).normal(size=500), (1.0, 4.0)))
    assert np.isnan(steady_beat(time[:50], beat[:50], (1.0, 4.0)))  # 1.3 beats


def test_a_run_without_a_beat_is_fitted_drawn_and_written(tmp_path):
    run = as_run(wandering(), FISH)
    space = fluid_space(FISH, 1)
    assert np.isfinite(residual_function(FISH, [run], space)(np.zeros((1, len(space))))).all()
    done = predict(FISH, [run, as_run(without_yaw(wandering()), FISH)])
    measured_against_twin([("held out", one) for one in done], tmp_path / "a.png")
    speeds(done[:1], done[1:], tmp_path / "b.png")
    assert identified._swim(row(done[1]), "fit")[2::4] == ["-", "-"]


def test_the_verb_writes_null_for_what_a_run_cannot_say(tmp_path):
    write_recording(without_yaw(wandering()), tmp_path / "log.csv")
    verb.predict("pulley-fish", [tmp_path / "log.csv"], json=tmp_path / "out.json")
    (found,) = json.loads((tmp_path / "out.json").read_text())["runs"]
    assert found["beat_frequency"] is None and found["heading_error_deg"] is None
    assert found["measured_speed"] > 0 and found["distance"] > 0


def test_a_swim_that_is_given_twice_is_not_counted_twice(tmp_path):
    write_recording(without_yaw(wandering()), tmp_path / "log.csv")
    with pytest.raises(BadInput, match=r"log\.csv: given twice; give each recording once"):
        verb.predict("pulley-fish", [tmp_path / "log.csv", tmp_path / "." / "log.csv"])


# ---- no heading ---------------------------------------------------------------------------------


@pytest.mark.parametrize("turn", [0.0, 2.0, -3.0])
def test_a_path_without_heading_is_judged_in_any_direction(turn):
    swum = record(FISH, "a", 1.5, 0.5, offset=0.3)
    seen, blind = predicted(swum), predicted(without_yaw(swum, turn))
    assert blind["marker_error"] < 2e-3
    assert blind["heading_error_deg"] is None
    assert blind["distance"] == pytest.approx(seen["distance"], rel=0.1)  # it drifts sideways
    assert blind["measured_speed"] == pytest.approx(seen["measured_speed"], rel=0.1)
    assert blind["predicted_speed"] == pytest.approx(blind["measured_speed"], rel=0.01)
    assert blind["beat_frequency"] == seen["beat_frequency"]


def test_the_turn_hides_no_wrong_path():
    """A turn to the right is not a turn to the left, and another fish stays another fish."""
    swum = record(FISH, "a", 1.5, 0.5, offset=0.3)
    assert predicted(without_yaw(swum, 1.0, mirror=True))["marker_error"] > 0.03
    assert predicted(without_yaw(swum, 1.0), OTHER)["position_error_share"] > 0.1


def test_a_moving_start_without_heading_begins_along_its_way():
    swum = crop(record(FISH, "a", 1.5, 0.5, seconds=7.0), 3.0, 7.0)
    run = as_run(without_yaw(swum, 2.5), FISH)
    assert not run.from_rest
    assert predicted(without_yaw(swum, 2.5))["position_error_share"] < 0.1


def test_residuals_without_heading_hold_positions_alone():
    space = fluid_space(FISH, 3)
    z = np.array([p.to_z(value_at(FISH, p.path)) for p in space])  # kept inside their ranges
    fish = apply(FISH, {p.path: p.from_z(c) for p, c in zip(space, z, strict=True)})
    runs = [as_run(without_yaw(record(fish, "a", 1.5, 0.5, offset=0.2), 2.0), fish)]
    true, wrong = residual_function(fish, runs, space)(np.stack([z, z - 0.5]))
    assert true.shape == (2 * 60,)
    assert np.abs(true).max() < 0.25 and np.abs(wrong).max() > 2


def test_way_over_ground_is_not_made_of_noise():
    time = np.arange(0, 20, 1 / 60)
    noise = np.random.default_rng(0).normal(0, 0.002, (time.size, 2))
    path = np.stack([0.1 * time, np.zeros_like(time)], axis=1) + noise
    track = Track(time, np.column_stack([path, np.full(time.size, np.nan)]))
    assert way(track) == pytest.approx(2.0, rel=0.01)
    assert np.all(np.diff(ground_distance(track)) >= 0)


def test_a_cruise_still_needs_its_heading():
    columns = {"x_m": 0.01 * np.arange(9.0), "y_m": 0.01 * np.arange(9.0)}
    with pytest.raises(BadInput, match="yaw_rad is missing"):
        as_run(Recording("a", np.arange(9.0) / 50, columns), load_fish("crank-fish"))


def test_a_run_is_of_rest_with_or_without_heading():
    swum = record(FISH, "a", 1.5, 0.5)
    runs: list[Run] = [as_run(one, FISH) for one in (swum, without_yaw(swum, 1.0))]
    assert [run.from_rest for run in runs] == [True, True]
    assert [run.track.has_heading for run in runs] == [True, False]


def test_the_naive_model_stands_beside_every_swim_that_has_a_heading():
    """Two logs of one name count twice; one without heading counts not at all."""
    swum, other = wandering(), replace(record(OTHER, "wandering", 1.5, 0.5), name="wandering")
    runs = [as_run(one, FISH) for one in (swum, without_yaw(swum, 1.0), other)]
    found = kinematic.beside(predict(FISH, runs), runs[:1])
    assert len(found.naive) == 2
    errors = [predicted(one)["position_error_share"] for one in (swum, other)]
    assert found.median_position_error_share == pytest.approx(np.mean(errors))
    assert found.twin_better_share in (0.5, 1.0)  # the twin is the first one's truth
    with pytest.raises(BadInput, match="motor_angle_rad and yaw_rad"):
        kinematic.beside(predict(FISH, runs[1:2]), runs[:1])
