"""Trials in the pool: what is drawn, what is swum, and what is measured."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from policies import EARLIER
from tailbeat.cli.options import SHIPPED
from tailbeat.control.actions import PERIOD
from tailbeat.control.measure import PAPER, Measure
from tailbeat.control.policy import load_policy
from tailbeat.env import randomize
from tailbeat.env.sensors import quiet
from tailbeat.env.task import Scene
from tailbeat.evaluate import (
    compare,
    disturb,
    evaluation,
    rates,
    reach,
    scenes,
    spectrum,
    store,
    track,
)  # fmt: skip
from tailbeat.evaluate.evaluation import EvaluationConfig
from tailbeat.evaluate.runs import Runs, surge
from tailbeat.evaluate.trial import Condition, Pool, chunks_of, swim, swim_all
from tailbeat.files import BadInput
from tailbeat.fish.store import load_fish
from tailbeat.identify.tag_pose import tracked_pose
from tailbeat.link.places import POOL
from tailbeat.operator import paths
from tailbeat.pool.water import Water

FISH, TWIN = load_fish("pulley-fish"), load_fish("pulley-fish-pool")
POLICY = "pulley-fish-pool-generator"
FAST = Measure(speed=2.0)
SPACE = load_policy(POLICY).contract.actions


def pool(count: int = 4, waters: tuple[Water, ...] = (Water(),)) -> Pool:
    return Pool(FISH, TWIN, SPACE, waters, count, seed=3)


def beat(seen: np.ndarray) -> np.ndarray:
    """An open-loop beat: 1.5 Hz, straight ahead, whatever is seen."""
    action = np.array([-0.25, 0.0, 0.6, 0.0, 0.0, 0.0], dtype=np.float32)
    return np.tile(action, (len(seen), 1))


def rest(seen: np.ndarray) -> np.ndarray:
    """No beat at all."""
    return np.zeros((len(seen), 6), dtype=np.float32)


def runs(pose: Any, target: Any, **given: Any) -> Runs:
    """Runs of given ways (n, k, 3) and targets (n, k, 2), all to their ends."""
    n, k = np.shape(pose)[:2]
    values: dict[str, Any] = {
        "motor": np.zeros((n, k)), "setpoint": np.zeros((n, k - 1)), "steps": np.full(n, k - 1),
        "reached": np.zeros(n, bool), "lost": np.zeros(n, bool), "energy": np.zeros(n),
        "shape": np.zeros((0, k, 9)), "water": np.zeros(n, int),
        "size": np.ones(n), "reach": np.ones(n),
    }  # fmt: skip
    return Runs(
        **{"pose": np.asarray(pose, float), "target": np.asarray(target, float), **values, **given}
    )


# ---- what is drawn ------------------------------------------------------------------------------


def test_a_grid_has_one_target_in_every_stratum_of_bearing_and_of_range():
    count = 60
    scene = scenes.grid(FISH, count, 0, 0.5, 2.5, np.pi)
    tag = tracked_pose(FISH, scene.start)
    offset = scene.target[:, 0] - tag[:, :2]
    bearing = (np.arctan2(offset[:, 1], offset[:, 0]) - tag[:, 2] + np.pi) % (2 * np.pi)
    distance = np.hypot(*offset.T)
    for share in (bearing / (2 * np.pi), (distance - 0.5) / 2.0):
        assert sorted(np.floor(share * count).astype(int)) == list(range(count))
    assert np.array_equal(scene.target, scenes.grid(FISH, count, 0, 0.5, 2.5, np.pi).target)


def test_targets_inside_walls_lie_inside_and_where_none_fits_it_is_said():
    scene = scenes.walled(FISH, 50, 1, (0.5, 3.0), POOL)
    half = np.array(POOL) / 2
    assert (np.abs(scene.target[:, 0]) < half).all() and (np.abs(scene.start[:, :2]) < half).all()
    with pytest.raises(BadInput, match="no free target"):
        scenes.walled(FISH, 2, 1, (0.5, 3.0), (0.9, 0.7))


def test_the_eight_is_even_crosses_itself_and_fits_the_pool():
    way = paths.even(paths.eight, 400)
    step = np.hypot(*np.diff(np.vstack([way, way[:1]]), axis=0).T)
    assert step == pytest.approx(paths.lap_length(paths.eight) / 400, rel=0.01)
    assert np.hypot(*way.T).min() < 0.02
    assert (np.abs(way).max(axis=0) < np.array(POOL) / 2 - 0.5).all()


def test_a_follower_starts_behind_its_target_and_faces_along_the_way():
    scene = scenes.follow(FISH, paths.circle, 40.0, 10.0, 2)
    tag = tracked_pose(FISH, scene.start)
    offset = scene.target[:, 0] - tag[:, :2]
    assert np.hypot(*offset.T) == pytest.approx(scenes.BEHIND)
    ahead = np.stack([np.cos(tag[:, 2]), np.sin(tag[:, 2])], axis=1)
    assert (offset * ahead).sum(axis=1) == pytest.approx(scenes.BEHIND)


# ---- what is swum -------------------------------------------------------------------------------


def quiet_condition(scene: Scene, **changed: Any) -> Condition:
    """Two seconds without noise that end for nothing."""
    rest = {"sensors": quiet(), "physics": randomize.none(), "seconds": 2.0, "stop": False}
    return pool().condition("test", scene, **{**rest, **changed})


def test_a_swim_is_the_same_whichever_way_the_fish_faced_at_the_start():
    scene = scenes.grid(FISH, 3, 0, 0.5, 2.5, np.pi)
    swum = swim(beat, quiet_condition(scene), [1, 2, 3])
    start = swum.pose[:, :1]
    offset = swum.pose[..., :2] - start[..., :2]
    c, s = np.cos(start[..., 2]), np.sin(start[..., 2])
    ahead, left = c * offset[..., 0] + s * offset[..., 1], c * offset[..., 1] - s * offset[..., 0]
    assert ahead[:, -1] == pytest.approx(ahead[0, -1], abs=1e-4) and ahead[0, -1] > 0.1
    assert left[:, -1] == pytest.approx(left[0, -1], abs=1e-4)
    assert (swum.energy > 0).all()
    assert swum.steps.tolist() == [100] * 3


def test_a_fish_released_backward_goes_backward_first():
    calm = scenes.grid(FISH, 2, 0, 0.5, 2.5, 1.0)
    back = disturb._released(calm, -0.2, 0.0)
    still, moved = (surge(swim(beat, quiet_condition(one), [1, 2]), 0.1) for one in (calm, back))
    assert (moved[:, 5] < -0.05).all() and (still[:, 5] > -0.05).all()


def test_draws_of_a_posterior_reach_the_twin_and_are_evaluated():
    """Draws that are the fish change nothing; draws without any water let it drift."""
    scene = scenes.grid(FISH, 2, 0, 0.5, 2.5, 1.0)
    plain = replace(pool(2).in_twin("t", scene), seconds=2.0, sensors=quiet())
    bare = replace(plain, physics=randomize.none())
    fluid = replace(randomize.none(), fluid=randomize.Randomisation().fluid)
    own = np.ones((3, len(TWIN.zones), 5))
    same = swim(beat, replace(plain, physics=fluid, draws=own), [1, 2])
    assert np.array_equal(same.pose, swim(beat, bare, [1, 2]).pose, equal_nan=True)
    none = swim(beat, replace(plain, physics=fluid, draws=0 * own), [1, 2])
    assert np.nanmax(np.abs(none.pose - same.pose)) > 0.05
    policy = load_policy(POLICY)
    chosen = evaluation.pool_of(policy, EvaluationConfig(episodes=4, twin=str(EARLIER)))
    assert chosen.draws is not None and chosen.draws.shape[1:] == (len(TWIN.zones), 5)
    assert "reach posterior" in [made.name for made in reach.conditions(chosen)]
    assert "reach posterior" not in [made.name for made in reach.conditions(pool())]
    other = evaluation.pool_of(policy, EvaluationConfig(episodes=4))
    assert other.draws is None  # the shipped posterior is of a newer identification
    default = evaluation.pool_of(load_policy(SHIPPED), EvaluationConfig(episodes=4))
    assert default.draws is not None  # the default policy is of the shipped fish


def test_in_the_twin_a_swim_has_no_pool_s_energy_and_ends_when_told():
    scene = scenes.grid(FISH, 2, 0, 0.5, 2.5, 1.0)
    near = replace(scene, target=tracked_pose(FISH, scene.start)[:, None, :2] + 0.01)
    condition = replace(pool().in_twin("t", near), sensors=quiet(), physics=randomize.none())
    swum = swim(beat, condition, [1, 2])
    assert swum.reached.all() and (swum.steps == 1).all() and np.isnan(swum.energy).all()


def test_a_trial_cut_short_is_taken_up_and_gives_the_same(tmp_path, monkeypatch):
    monkeypatch.setattr("tailbeat.evaluate.trial.CHUNK", 2)
    condition = replace(quiet_condition(scenes.grid(FISH, 4, 0, 0.5, 2.5, 1.0)), seconds=0.4)
    said: list[Any] = []

    def stop_after_one(*progress: Any) -> None:
        said.append(progress)
        if len(said) == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        swim_all(beat, chunks_of([condition], tmp_path / "a", 0), stop_after_one)
    half, short = store.load(tmp_path / "a", "test", 2)
    assert half.count == 2 and short
    swim_all(beat, chunks_of([condition], tmp_path / "a", 0), stop_after_one)
    swim_all(beat, chunks_of([condition], tmp_path / "b", 0), lambda *_: None)
    whole, short = store.load(tmp_path / "a", "test", 2)
    assert not short and said[-1] == ("test", 4, 4)
    for name, values in vars(store.load(tmp_path / "b", "test", 2)[0]).items():
        assert np.array_equal(getattr(whole, name), values, equal_nan=True), name


# ---- what is measured ---------------------------------------------------------------------------


def test_shares_count_arrivals_and_near_passes_and_the_trained_range_is_its_own():
    angle = np.radians([0.0, 100.0, 155.0, -170.0])
    target = 2.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)[:, None]
    ways = np.zeros((4, 11, 3))
    ways[:, 1:, :2] = (
        target * np.linspace(0, [[1.0]], 10)[:, 0] * [[[1.0]], [[0.95]], [[1.0]], [[0.5]]]
    )
    hit = np.array([True, False, True, False])
    found = reach.numbers(runs(ways, np.repeat(target, 11, axis=1), reached=hit))
    assert found.arrived == 0.5 and found.near == 0.75
    assert found.trained_range is not None and found.trained_range.arrived == 0.5
    assert found.median_path_ratio == pytest.approx(1.0)
    assert {(row.low, row.high) for row in found.sectors} >= {(0, 30), (90, 120)}


def test_a_paired_difference_has_the_interval_of_the_pairs_that_differ():
    """By hand: of 50 pairs 12 and 2 differ; with one more each way 10/52 +- 1.96 sqrt((16/52 -
    (10/52)^2) / 52)."""
    first = np.array([True] * 12 + [False] * 2 + [True] * 36)
    second = np.array([False] * 12 + [True] * 2 + [True] * 36)
    found = rates.paired(second, first)
    assert found.difference == pytest.approx(0.20)
    assert found.interval == pytest.approx([0.0509, 0.3337], abs=1e-4)


def test_a_fish_on_its_target_s_heels_crosses_twice_and_one_that_circles_does_not():
    steps = round(73.0 / PERIOD)
    way = paths.even(paths.eight, steps)
    target = np.vstack([way, way[:1]])
    behind = np.roll(target, 40, axis=0)
    away = target + np.array([0.0, 1.0])
    ways = [np.column_stack([one, np.zeros(len(one))]) for one in (behind, away)]
    found = runs(np.array(ways), np.array([target, target]))
    assert track.crossings(found).tolist() == [2, 0]
    row = track.result(track.TARGET_PATHS[0], found.part(slice(0, 1)))
    assert row.two_crossings == 1 and row.kept == 1
    assert row.median_distance == pytest.approx(0.8 * row.target_speed, rel=0.05)
    assert row.aside_rms < 0.02


def test_a_swim_that_was_lost_has_not_kept_its_target():
    way = paths.even(paths.eight, round(73.0 / PERIOD))
    target = np.tile(way, (3, 1, 1))
    pose = np.dstack([target, np.zeros(target.shape[:2])])
    pose[1, 500:] = np.nan  # it diverged
    lost = np.array([False, True, True])  # the last one in its last step
    row = track.result(track.TARGET_PATHS[0], runs(pose, target, lost=lost))
    assert (row.swims, row.kept, row.two_crossings) == (3, 1, 2)
    assert track.passes(way[:300], way[:300]) == 0  # the target has not come to the middle


def test_a_quick_fish_has_less_time_to_settle():
    target = np.zeros((1, 400, 2))
    pose = np.zeros((1, 400, 3))
    pose[:, : round(4 / PERIOD), 0] = 1.0  # it arrives after 4 s
    kept = [track.result(track.TARGET_PATHS[-1], runs(pose, target), m).kept for m in (PAPER, FAST)]
    assert kept == [1, 0]


def test_every_water_is_swum_after_a_moving_target():
    waters = tuple(Water(body_friction=0.03 + 0.001 * i) for i in range(16))
    (one,) = track.conditions(pool(waters=waters))
    assert one.count == track.SWIMS * len(track.TARGET_PATHS)
    assert one.water is not None and set(one.water) == set(waters)


def test_a_slow_fish_that_sways_or_leads_crosses_too():
    """Half a hertz of 4 cm to either side hides the direction over 0.4 s, not that over 2 s. A fish
    that passes the middle a second before its target crosses it too."""
    steps = round(73.0 / PERIOD)
    way = paths.even(paths.eight, steps)
    target = np.vstack([way, way[:1]])
    ahead = np.roll(target, -50, axis=0)
    beat = np.sin(2 * np.pi * 18 * (PERIOD * np.arange(steps + 1) / 36.5 - 0.5))  # 0 at each pass
    sway = 0.05 * beat[:, None] * [0.5, -0.9]
    ways = [np.column_stack([one, np.zeros(len(one))]) for one in (ahead, target + sway)]
    found = runs(np.array(ways), np.array([target, target]))
    assert track.crossings(found)[0] == 2 > track.crossings(found)[1]
    assert track.crossings(found, track.LONG).tolist() == [2, 2]


def test_a_led_target_waits_for_its_fish_and_a_timed_one_does_not():
    away = []
    for lead in (0.7, np.inf):
        scene = scenes.follow(TWIN, paths.circle, 10.0, 3.0, 2, lead)
        condition = Condition(
            "a", TWIN, scene, SPACE, None, sensors=quiet(), physics=randomize.none(), seconds=3.0,
            stop=False,
        )  # fmt: skip
        away.append(swim(rest, condition, [1, 2]).distance)
    assert away[0][:, 0] == pytest.approx(scenes.BEHIND, abs=0.01)
    assert ((away[0][:, -1] > 0.7) & (away[0][:, -1] < 0.72)).all()
    assert (away[1][:, -1] > 1.2).all()


def test_velocity_power_of_a_known_beat_falls_on_its_side_of_the_edge():
    time = PERIOD * np.arange(501)
    motor = np.stack([0.5 * np.sin(2 * np.pi * 2.0 * time), 0.5 * np.sin(2 * np.pi * 6.0 * time)])
    pose = np.zeros((2, 501, 3))
    pose[0, :, 0], pose[1, :, 0] = 0.1 * time, -0.1 * time
    swum = runs(pose, np.ones((2, 501, 2)), motor=motor)
    rows = {row.gait: vars(row) for row in spectrum.numbers({"made": swum}, (3.0, 4.0))}
    assert rows["forward"]["share_below"] > 0.98 and rows["reversing"]["share_below"] < 0.02
    # the same angle at three times the rate has nine times the velocity power
    assert rows["all"]["share_below"] == pytest.approx(0.1, abs=0.01)
    assert rows["forward"]["share_below_floor"] > 0.98 and rows["forward"]["share_inside"] < 0.02
    assert rows["reversing"]["share_above"] > 0.98
    for row in rows.values():
        parts = [row[f"share_{name}"] for name in ("below_floor", "inside", "above")]
        assert sum(parts) == pytest.approx(1.0)
        assert parts[0] + parts[1] == pytest.approx(row["share_below"])
    short = {row.gait: vars(row) for row in spectrum.numbers({"made": swum}, (1.0, 4.0))}
    assert short["forward"]["share_below_floor"] is None  # in 2 s 1 Hz beats twice
    assert short["forward"]["share_above"] < 0.02 and short["all"]["share_below_floor"] < 0.02


def test_a_gait_swum_in_the_twin_is_replayed_at_its_own_speed():
    scene = scenes.still(np.zeros((2, 3)), np.full((2, 2), 3.0))
    condition = Condition(
        "twin", TWIN, scene, SPACE, None, sensors=quiet(), physics=randomize.none(), seconds=4.0
    )
    swum = swim(beat, condition, [1, 2])
    assert compare.replayed(swum, TWIN) == pytest.approx(compare.path_speed(swum.pose), rel=0.02)
