"""Trials in the pool: what is drawn, what is measured, what survives a stop, what is refused."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tailbeat.control.actions import PERIOD, Generator
from tailbeat.control.policy import load_policy
from tailbeat.env import randomize
from tailbeat.env.sensors import quiet
from tailbeat.env.task import Scene
from tailbeat.evaluate import compare, disturb, evaluation, reach, scenes, spectrum, track
from tailbeat.evaluate import runs as store
from tailbeat.evaluate.runs import Runs, surge
from tailbeat.evaluate.trial import Arm, Pool, swim, swim_all
from tailbeat.files import BadInput
from tailbeat.fish.store import load_fish
from tailbeat.identify.runs import tracked_pose
from tailbeat.link.places import LENGTH, WIDTH
from tailbeat.pool.water import Water
from tailbeat.report.page import of_folder

FISH, TWIN = load_fish("pulley-fish"), load_fish("pulley-fish-pool")
POLICY = "pulley-fish-pool-generator"
POOL = (LENGTH, WIDTH)
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
    scene = scenes.walled(FISH, 50, 1, 0.5, 3.0, POOL)
    half = np.array(POOL) / 2
    assert (np.abs(scene.target[:, 0]) < half).all() and (np.abs(scene.start[:, :2]) < half).all()
    with pytest.raises(BadInput, match="no free target"):
        scenes.walled(FISH, 2, 1, 0.5, 3.0, (0.9, 0.7))


def test_the_eight_is_even_crosses_itself_and_fits_the_pool():
    way = scenes.even(scenes.eight, 400)
    step = np.hypot(*np.diff(np.vstack([way, way[:1]]), axis=0).T)
    assert step == pytest.approx(scenes.lap_length(scenes.eight) / 400, rel=0.01)
    assert np.hypot(*way.T).min() < 0.02
    assert (np.abs(way).max(axis=0) < np.array(POOL) / 2 - 0.5).all()


def test_a_follower_starts_behind_its_target_and_faces_along_the_way():
    scene = scenes.follow(FISH, scenes.circle, 40.0, 10.0, 2)
    tag = tracked_pose(FISH, scene.start)
    offset = scene.target[:, 0] - tag[:, :2]
    assert np.hypot(*offset.T) == pytest.approx(scenes.BEHIND)
    ahead = np.stack([np.cos(tag[:, 2]), np.sin(tag[:, 2])], axis=1)
    assert (offset * ahead).sum(axis=1) == pytest.approx(scenes.BEHIND)


# ---- what is swum -------------------------------------------------------------------------------


def quiet_arm(scene: Scene, **changed: Any) -> Arm:
    """Two seconds without noise that end for nothing."""
    rest = {"sensors": quiet(), "physics": randomize.none(), "seconds": 2.0, "stop": False}
    return pool().arm("test", scene, **{**rest, **changed})


def test_a_swim_is_the_same_whichever_way_the_fish_faced_at_the_start():
    scene = scenes.grid(FISH, 3, 0, 0.5, 2.5, np.pi)
    swum = swim(beat, quiet_arm(scene), [1, 2, 3])
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
    still, moved = (surge(swim(beat, quiet_arm(one), [1, 2]), 0.1) for one in (calm, back))
    assert (moved[:, 5] < -0.05).all() and (still[:, 5] > -0.05).all()


def test_in_the_twin_a_swim_has_no_pool_s_energy_and_ends_when_told():
    scene = scenes.grid(FISH, 2, 0, 0.5, 2.5, 1.0)
    near = replace(scene, target=tracked_pose(FISH, scene.start)[:, None, :2] + 0.01)
    arm = replace(pool().in_twin("t", near), sensors=quiet(), physics=randomize.none())
    swum = swim(beat, arm, [1, 2])
    assert swum.reached.all() and (swum.steps == 1).all() and np.isnan(swum.energy).all()


def test_a_trial_cut_short_is_taken_up_and_gives_the_same(tmp_path, monkeypatch):
    monkeypatch.setattr("tailbeat.evaluate.trial.CHUNK", 2)
    arm = replace(quiet_arm(scenes.grid(FISH, 4, 0, 0.5, 2.5, 1.0)), seconds=0.4)
    said: list[Any] = []

    def stop_after_one(*progress: Any) -> None:
        said.append(progress)
        if len(said) == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        swim_all(beat, [arm], tmp_path / "a", 0, stop_after_one)
    half, short = store.load(tmp_path / "a", "test", 2)
    assert half.count == 2 and short
    swim_all(beat, [arm], tmp_path / "a", 0, stop_after_one)
    swim_all(beat, [arm], tmp_path / "b", 0, lambda *_: None)
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
    assert found["within_5cm"] == 0.5 and found["within_20cm"] == 0.75
    assert found["trained range"]["within_5cm"] == 0.5
    assert found["median_path_ratio"] == pytest.approx(1.0)
    assert {row["bearing [deg]"] for row in found["sectors"]} >= {"0-30", "90-120"}


def test_a_paired_difference_has_the_interval_of_the_pairs_that_differ():
    """By hand: of 50 pairs 12 and 2 differ, so 0.20 +- 1.96 sqrt(14 - 50 * 0.2^2) / 50."""
    first = np.array([True] * 12 + [False] * 2 + [True] * 36)
    second = np.array([False] * 12 + [True] * 2 + [True] * 36)
    found = reach.paired(second, first)
    assert found["difference"] == pytest.approx(0.20)
    assert found["interval"] == pytest.approx([0.0642, 0.3358], abs=1e-3)


def test_a_fish_on_its_target_s_heels_crosses_twice_and_one_that_circles_does_not():
    steps = round(73.0 / PERIOD)
    way = scenes.even(scenes.eight, steps)
    target = np.vstack([way, way[:1]])
    behind = np.roll(target, 40, axis=0)
    away = target + np.array([0.0, 1.0])
    ways = [np.column_stack([one, np.zeros(len(one))]) for one in (behind, away)]
    found = runs(np.array(ways), np.array([target, target]))
    assert track.crossings(found).tolist() == [2, 0]
    row = track._row("eight 73 s", found.part(slice(0, 1)), "eight")
    assert row["two_crossings"] == 1 and row["kept"] == 1
    assert row["median_distance"] == pytest.approx(0.8 * row["target_speed"], rel=0.05)
    assert row["aside_rms"] < 0.02


def test_a_led_target_waits_for_its_fish_and_a_timed_one_does_not():
    away = []
    for lead in (0.7, np.inf):
        scene = scenes.follow(TWIN, scenes.circle, 10.0, 3.0, 2, lead)
        arm = Arm("a", TWIN, scene, SPACE, None, sensors=quiet(), physics=randomize.none(),
                  seconds=3.0, stop=False)  # fmt: skip
        away.append(swim(rest, arm, [1, 2]).distance)
    assert away[0][:, 0] == pytest.approx(scenes.BEHIND, abs=0.01)
    assert ((away[0][:, -1] > 0.7) & (away[0][:, -1] < 0.72)).all()
    assert (away[1][:, -1] > 1.2).all()


def test_velocity_power_of_a_known_beat_falls_on_its_side_of_the_edge():
    time = PERIOD * np.arange(501)
    motor = np.stack([0.5 * np.sin(2 * np.pi * 2.0 * time), 0.5 * np.sin(2 * np.pi * 6.0 * time)])
    pose = np.zeros((2, 501, 3))
    pose[0, :, 0], pose[1, :, 0] = 0.1 * time, -0.1 * time
    swum = runs(pose, np.ones((2, 501, 2)), motor=motor)
    rows = {row["gait"]: row for row in spectrum.numbers({"made": swum}, (3.0, 4.0))}
    assert rows["forward"]["share_below"] > 0.98 and rows["reversing"]["share_below"] < 0.02
    # the same angle at three times the rate has nine times the velocity power
    assert rows["all"]["share_below"] == pytest.approx(0.1, abs=0.01)
    assert rows["forward"]["share_below_floor"] > 0.98 and rows["forward"]["share_inside"] < 0.02
    assert rows["reversing"]["share_above"] > 0.98
    for row in rows.values():
        parts = [row[f"share_{name}"] for name in ("below_floor", "inside", "above")]
        assert sum(parts) == pytest.approx(1.0)
        assert parts[0] + parts[1] == pytest.approx(row["share_below"])
    short = {row["gait"]: row for row in spectrum.numbers({"made": swum}, (1.0, 4.0))}
    assert short["forward"]["share_below_floor"] is None  # in 2 s 1 Hz beats twice
    assert short["forward"]["share_above"] < 0.02 and short["all"]["share_below_floor"] < 0.02
    assert rows["all"] == {k: spectrum.complete(rows["all"])[k] for k in rows["all"]}
    assert spectrum.complete({"runs": "old", "share_below": 0.9})["share_above"] is None


def test_a_gait_swum_in_the_twin_is_replayed_at_its_own_speed():
    scene = scenes.still(np.zeros((2, 3)), np.full((2, 2), 3.0))
    arm = Arm(
        "twin", TWIN, scene, SPACE, None, sensors=quiet(), physics=randomize.none(), seconds=4.0
    )
    swum = swim(beat, arm, [1, 2])
    assert compare.replayed(swum, TWIN) == pytest.approx(compare.path_speed(swum.pose), rel=0.02)


# ---- the verbs ----------------------------------------------------------------------------------


def tried(fish: str, pool: str, tasks: list[str], episodes: int, out: Path) -> dict[str, Any]:
    """An evaluation of the shipped policy."""
    policy = load_policy(POLICY)
    where = evaluation.pool_of(policy, fish, None, pool, episodes, 0)
    return evaluation.evaluate(policy, where, tasks, out, lambda *_: None)


@pytest.fixture(scope="module")
def evaluated(tmp_path_factory) -> tuple[Path, dict[str, Any]]:
    """A small evaluation of the shipped policy, with its page."""
    out = tmp_path_factory.mktemp("trial") / "shipped"
    found = tried("pulley-fish", "full", ["reach", "spectrum"], 6, out)
    of_folder(out, "pulley-fish")
    return out, found


def test_an_evaluation_leaves_numbers_figures_and_one_page(evaluated):
    out, found = evaluated
    open_water = found["reach"]["reach open"]
    assert open_water["swims"] == 6 and open_water["within_20cm"] >= 4 / 6
    assert {row["runs"] for row in found["spectrum"]} >= {"identification", "reach open"}
    page = (out / "report.html").read_text()
    assert "share_below_floor" in page and "band 1 to 4 Hz" in page
    assert "11 of 22" in page and "data:image/svg+xml;base64," in page
    assert 'src="' not in page.replace("src='data:", "")  # needs no other file
    assert json.loads((out / "report.json").read_text())["plan"]["seed"] == 0
    for name in ("reach-sectors", "reach-open-map", "reach-open-paths", "power"):
        assert (out / "figures" / f"{name}.svg").stat().st_size > 5000
        assert (out / "figures" / f"{name}.png").stat().st_size > 5000


def test_a_page_of_runs_cut_short_says_so(evaluated, tmp_path):
    out, _ = evaluated
    copy = tmp_path / "copy"
    shutil.copytree(out, copy)
    plan = json.loads((copy / "plan.json").read_text())
    plan["arms"]["reach open"] = 500
    (copy / "plan.json").write_text(json.dumps(plan))
    path, found = of_folder(copy, "pulley-fish")
    assert found["cut_short"] == ["reach open"]
    assert "Cut short" in path.read_text()


def test_a_comparison_pairs_every_policy_with_its_twin_and_is_shared_between_processes(tmp_path):
    args = ([POLICY], "pulley-fish", None, 3, 0)
    for share in ("1/2", "2/2"):
        found = compare.compare(*args, share, tmp_path / "c", lambda *_: None)
    arms = [row["arm"] for row in found["rows"]]
    assert sorted(arms) == sorted(
        [
            "twin",
            "full",
            "no lag",
            "no stall",
            "no added inertia",
            "no delay",
            "ideal servo",
            "ensemble",
        ]
    )
    full = next(row for row in found["rows"] if row["arm"] == "full")
    assert full["speed"] > 0.05 and full["speed_in_twin"] > 0.05 and full["actuator_watts"] > 0
    parts = [full[f"share_{name}"] for name in ("below_floor", "inside", "above")]
    assert sum(parts) == pytest.approx(1.0)
    assert full["gap_20cm"]["interval"][0] <= full["gap_20cm"]["difference"]
    assert of_folder(tmp_path / "c", "pulley-fish")[0].is_file()


def test_what_does_not_fit_is_refused(evaluated, tmp_path):
    out, _ = evaluated
    with pytest.raises(BadInput, match="fish is not the pool's"):
        tried("crank-fish", "full", ["reach"], 6, tmp_path / "a")
    with pytest.raises(BadInput, match="episodes was 6, now 7"):
        tried("pulley-fish", "full", ["reach"], 7, out)
    with pytest.raises(BadInput, match="--pool 'sea': allowed are ensemble"):
        tried("pulley-fish", "sea", ["reach"], 6, tmp_path / "a")
    with pytest.raises(BadInput, match="--tasks dive: allowed are reach"):
        tried("pulley-fish", "full", ["dive"], 6, tmp_path / "a")
    for size, complaint in (
        ("1x0.7", "no free target"),
        ("3x2", "the eight needs"),
        ("a", "--walls"),
    ):
        with pytest.raises(BadInput, match=complaint):
            where = evaluation.pool_of(load_policy(POLICY), "pulley-fish", None, "full", 4, 0, size)
            evaluation.arms_of(where, ["reach", "track"])
    with pytest.raises(BadInput, match="empty or missing folder"):
        of_folder(tmp_path / "nothing", "pulley-fish")
    with pytest.raises(BadInput, match="--share '3/2'"):
        compare.compare([POLICY], "pulley-fish", None, 4, 0, "3/2", tmp_path / "b", lambda *_: None)
    assert not (tmp_path / "a").exists()
    assert isinstance(SPACE, Generator)
