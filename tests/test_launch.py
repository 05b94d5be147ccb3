"""Swims that begin with a velocity, what policies do as commands, and the naive rival."""

from dataclasses import replace

import numpy as np
import pytest

from even_lift import kutta_led
from near_guides import sketched
from tailbeat.evaluate.fresh_recordings import EVERY
from tailbeat.files import BadInput
from tailbeat.fish.description import ends_of, length_of
from tailbeat.fish.first_draft import described
from tailbeat.fish.proportions import Given, sketch
from tailbeat.fish.store import load_fish, shipped
from tailbeat.fish.water import whole
from tailbeat.identify.gait import Track
from tailbeat.identify.kinematic import STEP, Kinematic, fit_kinematic, path, predict_kinematic
from tailbeat.identify.launch import check_launches, gaits, launch_of, stuck
from tailbeat.identify.manoeuvres import manoeuvres
from tailbeat.identify.predict import path_errors, predict
from tailbeat.identify.protocol import fluid_runs, limits
from tailbeat.identify.runs import Run, as_run
from tailbeat.link.places import LENGTH as POOL_LENGTH
from tailbeat.pool import protocols
from tailbeat.pool.protocols import record_fluid
from tailbeat.recording import Recording

FISH = load_fish("pulley-fish")
POOL = load_fish("pulley-fish-pool")
SMALL, LARGE = Given(0.15, 0.1, 2, "xl330"), Given(1.15, 14.0, 5, "xm540")
MADE = manoeuvres(FISH, limits(FISH))


def command(**meta: str) -> Recording:
    time = np.arange(0, 4, 0.02)
    sine = 0.6 * np.sin(2 * np.pi * 1.5 * time)
    return Recording("fluid-x", time, {"command_rad": sine}, meta)


def test_a_launched_swim_begins_with_its_velocity() -> None:
    (swim,) = record_fluid(FISH, commands=[command(launch="-0.2 0.05 0.5")])
    first = swim.time < 0.15
    fit = [np.polyfit(swim.time[first], swim.columns[c][first], 1)[0] for c in ("x_m", "y_m")]
    yaw = np.polyfit(swim.time[first], swim.columns["yaw_rad"][first], 1)[0]
    assert fit[0] == pytest.approx(-0.2, abs=0.04)
    assert fit[1] > 0.02 and yaw > 0.2
    assert launch_of(swim, FISH) == pytest.approx([-0.2, 0.05, 0.5])
    run = as_run(swim, FISH)
    twin = predict(POOL, [run])[0].track
    began = twin.pose[2] - twin.pose[0]
    assert began[0] / twin.time[2] == pytest.approx(-0.2, abs=0.05)


@pytest.mark.parametrize(
    ("launch", "said"),
    [
        ("-2 0 0", r"launch = -2 0 0 is faster than the fish could move; allowed are .* m/s"),
        ("0 0 30", r"faster than the fish could move"),
        ("fast", r"launch = 'fast'; give surge and sway"),
        ("1 2", r"give surge and sway"),
        ("nan 0 0", r"give surge and sway"),
    ],
)
def test_a_launch_that_cannot_be_is_refused(launch: str, said: str) -> None:
    with pytest.raises(BadInput, match=said):
        list(record_fluid(FISH, commands=[command(launch=launch)]))
    assert 0.4 < length_of(FISH) < 0.7


def test_a_small_fish_is_launched_as_fast_for_its_length_and_a_large_one_no_faster() -> None:
    for given, ratio in ((SMALL, 0.15 / 0.54), (LARGE, 1.0)):
        fish = described(sketch(given))
        for name, one in manoeuvres(fish, limits(fish)).items():
            launch, usual = launch_of(one, fish), launch_of(MADE[name], FISH)
            assert (launch is None) == (usual is None)
            if launch is not None and usual is not None:
                assert launch == pytest.approx(ratio * usual, rel=1e-3), name


def test_every_command_is_checked_before_the_first_one_is_played() -> None:
    with pytest.raises(BadInput, match="fluid-x: launch = -2 0 0 is faster"):
        next(record_fluid(FISH, commands=[command(), command(launch="-2 0 0")]))


def test_a_swim_of_a_large_fish_begins_with_its_fin_off_the_wall() -> None:
    fish = described(sketch(LARGE))
    still = Recording("fluid-x", np.arange(0, 0.2, 0.02), {"command_rad": np.zeros(10)}, {})
    (swim,) = record_fluid(fish, commands=[still])
    rear = swim.columns["x_m"][0] - fish.tracked[0] + ends_of(fish)[0]
    assert -POOL_LENGTH / 2 + 0.3 < rear < 0


def test_a_swim_that_diverges_at_the_usual_step_has_a_shorter_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its guides meet at full stroke, so its tail jerks."""
    fish = sketched(SMALL, narrow=True)
    slow = manoeuvres(fish, limits(fish))["fluid-25-slow"]
    (swim,) = record_fluid(fish, commands=[slow])
    assert swim.time[-1] > 5.0 and all(np.isfinite(one).all() for one in swim.columns.values())
    monkeypatch.setattr(protocols, "HALVED", 1)
    with pytest.raises(BadInput, match=r"fluid-25-slow: .* diverges .* at a step of 2 ms; check"):
        list(record_fluid(fish, commands=[slow]))


def test_the_launch_check_tells_the_even_law_from_a_trailing_edge() -> None:
    gaits = [(1.2, 0.3), (2.0, 0.2), (3.0, 0.13)]
    backward = stuck(check_launches(kutta_led(even=True), gaits))
    assert {one.launch for one in backward} == {-0.03, -0.1, -0.3}
    assert not stuck(check_launches(POOL, gaits))


# Signs of the final speeds after launches at 0, 0.03, -0.03, -0.1 and -0.3 m/s: in the slowest beat
# of the band, and in the fastest.
FORWARD = "+++++"
RECOVERED = {
    "crank-fish": (FORWARD, FORWARD),
    "pulley-fish": ("++---", "-+---"),  # the paper's law: a fast beat also starts backward
    "pulley-fish-pool": (FORWARD, FORWARD),
}


@pytest.mark.parametrize("name", shipped())
def test_only_the_fish_with_a_trailing_edge_recovers_from_every_launch(name: str) -> None:
    fish = load_fish(name)
    slowest, *_, fastest = gaits(fish)
    ends = [one.speed for one in check_launches(fish, [slowest, fastest])]
    assert min(map(abs, ends)) > 0.05  # none stands
    signs = "".join("+" if speed > 0 else "-" for speed in ends)
    assert (signs[:5], signs[5:]) == RECOVERED[name]
    assert (fish.trailing_edge is not None) == (set(signs) == {"+"})


def test_manoeuvres_hold_out_one_of_each_kind_and_stay_inside_the_limits() -> None:
    limit = limits(FISH)
    names = [*fluid_runs(FISH, limit), *MADE]
    assert names == sorted(names)
    kinds = {name.split("-")[2] for name in MADE}
    held = {name.split("-")[2] for name in names[EVERY - 1 :: EVERY] if name.count("-") == 2}
    assert held == kinds == {"launch", "brake", "slow", "turn", "wander", "sprint", "dash"}
    for one in MADE.values():
        assert np.abs(one.columns["command_rad"]).max() <= limit.angle + 1e-9
        assert abs(one.columns["command_rad"][0]) < 0.3  # it has lagged for one period
    # Wandering swims turn as hard as policies do: some rest against the range's end.
    turned = [one for name, one in MADE.items() if name.endswith(("wander", "dash"))]
    rests = [np.mean(np.abs(one.columns["command_rad"]) > 0.99 * limit.angle) for one in turned]
    assert np.mean(rests) > 0.05 and sum(one > 0 for one in rests) >= 10


def test_the_naive_model_recovers_its_own_numbers() -> None:
    truth = Kinematic(0.15, 0.6, 0.8, 0.7, 0.3)
    runs = []
    for seed in range(3):
        rng, time = np.random.default_rng(seed), np.arange(400, dtype=np.float64) * STEP
        angle = 0.3 * rng.normal() + rng.uniform(0.3, 0.6) * np.sin(2 * np.pi * (1 + seed) * time)
        pose = path(truth, angle, np.zeros(3))
        runs.append(Run(f"r{seed}", Track(time, pose), as_run(filmed(), FISH).gait, angle, True))
    found = fit_kinematic(runs)
    assert list(vars(found).values()) == pytest.approx(list(vars(truth).values()), rel=0.05)
    for one in predict_kinematic(found, runs):
        assert path_errors(one).position_error_share < 0.02


def filmed() -> Recording:
    (swim,) = record_fluid(FISH, commands=[command()])
    return swim


def test_the_whole_law_is_what_a_new_fish_has() -> None:
    fish = whole(FISH)
    assert (fish.added_inertia, fish.added_along) == (1.0, 0.0)
    assert fish.trailing_edge is not None and fish.simulation.integrator == "Euler"
    assert replace(limits(FISH)) == limits(fish)


def test_the_launch_check_needs_no_steady_beat_and_no_range_of_the_motor() -> None:
    assert all(1 <= rate <= 4 and stroke for rate, stroke in gaits(FISH, [float("nan")]))
    crank = load_fish("crank-fish")
    assert {stroke for _, stroke in gaits(crank, [1.5])} == {None}
