"""Evaluations and comparisons: what they write, resume, read and refuse."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from policies import EARLIER
from tailbeat.cli.evaluate import _walls
from tailbeat.control.actions import Generator
from tailbeat.control.policy import load_policy, shipped
from tailbeat.evaluate import (
    compare,
    comparison,
    evaluation,
    out_of_distribution,
    store,
)  # fmt: skip
from tailbeat.evaluate.compare import ComparisonConfig
from tailbeat.evaluate.comparison import cell_path
from tailbeat.evaluate.evaluation import Evaluation, EvaluationConfig
from tailbeat.files import BadInput, plain, write_json
from tailbeat.fish.store import load_fish
from tailbeat.pool.mess import lab_at
from tailbeat.report.page import of_folder

TWIN = load_fish(str(EARLIER))
POLICY = "pulley-fish-pool-generator"
EPISODES = 3
SPACE = load_policy(POLICY).contract.actions


def tried(fish: str, water: str, tasks: tuple[str, ...], episodes: int, out: Path) -> Evaluation:
    """An evaluation of the shipped policy."""
    config = EvaluationConfig(fish, None, water, tasks, episodes)
    return evaluation.evaluate(load_policy(POLICY), config, out, lambda *_: None)


@pytest.fixture(scope="module")
def evaluated(tmp_path_factory) -> tuple[Path, Evaluation]:
    """A small evaluation of the shipped policy, with its page, which says that it was cut short."""
    out = tmp_path_factory.mktemp("trial") / "shipped"
    swum = tried("pulley-fish", "full", ("reach", "spectrum"), EPISODES, out)
    found = replace(swum, cut_short=("reach open",))
    write_json(out / "evaluation.json", found, overwrite=True)
    of_folder(out, "pulley-fish", data=found)
    return out, found


def cells_of(page: str) -> list[list[str]]:
    """The rows of a page's tables."""
    rows = re.findall(r"<tr>(.*?)</tr>", page, re.S)
    return [re.findall(r"<t[hd]>(.*?)</t[hd]>", row) for row in rows]


@pytest.mark.thorough
def test_an_evaluation_leaves_numbers_figures_and_one_page(evaluated):
    out, found = evaluated
    open_water = found.reach["reach open"]
    assert open_water.swims == EPISODES and open_water.near >= 2 / 3
    assert {row.runs for row in found.spectrum} >= {"identification", "reach open"}
    assert store.kept_fish(out) == TWIN
    page = (out / "report.html").read_text()
    assert "band 1 to 4 Hz" in page and "data:image/svg+xml;base64," in page
    assert 'src="' not in page.replace('src="data:', "")  # needs no other file
    for name in ("reach-sectors", "reach-open-map", "reach-open-paths", "power"):
        assert (out / "figures" / f"{name}.svg").stat().st_size > 5000
        assert (out / "figures" / f"{name}.png").stat().st_size > 5000


@pytest.mark.thorough
def test_the_page_shows_what_its_json_holds(evaluated):
    """Read back from both files: success rates of every condition, power, and the paper's rows."""
    out, found = evaluated
    held = json.loads((out / "report.json").read_text())
    assert held == json.loads((out / "evaluation.json").read_text()) == plain(found)
    assert held["run"]["seed"] == 0 and held["run"] == json.loads((out / "run.json").read_text())
    rows = cells_of((out / "report.html").read_text())
    for row in held["reach"].values():
        shown = [
            f"{100 * row[key]:.1f} ({100 * low:.1f} … {100 * high:.1f})"
            for key in ("arrived", "near")
            for low, high in (row[f"{key}_interval"],)
        ]
        assert any(cells[:3] == [str(EPISODES), *shown] for cells in rows), shown
    for row in held["spectrum"]:
        below = f"{row['share_below']:.3g}" if row["share_below"] is not None else "-"
        assert [row["runs"], row["gait"], str(row["pieces"]), below] in [c[:4] for c in rows]
    paper = {cells[0]: cells[1:] for cells in rows if len(cells) == 3}
    open_water = held["reach"]["reach open"]["trained_range"]
    static = paper["static targets within 5 cm"]
    assert static[0] == "11 of 22 (50 %)" and static[1].startswith(
        f"{100 * open_water['arrived']:.1f} ("
    )
    known = next(row for row in held["spectrum"] if row["runs"] == "identification")
    name = "velocity power below the band&#39;s upper edge: identification runs"
    assert paper[name] == ["92 %", f"{100 * known['share_below']:.0f} %"]


@pytest.mark.thorough
def test_runs_of_an_earlier_version_are_read_and_gone_on_with(evaluated, tmp_path):
    """They had `plan.json` with `arms`, and called `beyond` what is out of distribution."""
    out, found = evaluated
    old, name = tmp_path / "old", out_of_distribution.AS_TRAINED
    shutil.copytree(out, old)
    run = json.loads((old / "run.json").read_text())
    run["arms"] = {
        one.replace("out of distribution: ", "beyond "): n
        for one, n in run.pop("conditions").items()
    }
    assert "beyond as trained" in run["arms"]
    (old / "plan.json").write_text(json.dumps(run))
    (old / "run.json").unlink()
    shutil.copy(old / "runs" / "reach-open.000.npz", old / "runs" / "beyond-as-trained.000.npz")
    read = evaluation.read(old)
    assert read.run == found.run and read.reach == found.reach
    assert [row.condition for row in read.out_of_distribution] == [name]
    assert tried("pulley-fish", "full", ("reach",), EPISODES, old).reach == found.reach
    (old / "plan.json").write_text(json.dumps(run | {"seed": "first"}))
    with pytest.raises(BadInput, match=r"plan.json: seed: Input should be a valid integer"):
        evaluation.read(old)


@pytest.mark.thorough
def test_a_page_of_runs_cut_short_says_so(evaluated, tmp_path):
    out, _ = evaluated
    copy = tmp_path / "copy"
    shutil.copytree(out, copy)
    assert evaluation.read(copy).cut_short == ()
    run = json.loads((copy / "run.json").read_text())
    run["conditions"]["reach open"] = 500
    (copy / "run.json").write_text(json.dumps(run))
    assert evaluation.read(copy).cut_short == ("reach open",)
    assert "Incomplete, read as far as they go: reach open." in (out / "report.html").read_text()


@pytest.mark.slow
@pytest.mark.long
def test_a_comparison_pairs_every_policy_with_its_twin(tmp_path, monkeypatch):
    """In swims of six seconds: how far they come does not matter here."""
    real = compare.conditions_of
    monkeypatch.setattr(
        compare, "conditions_of", lambda *of: [replace(one, seconds=6.0) for one in real(*of)]
    )
    config = ComparisonConfig((POLICY,), targets=2)
    for cell in compare.cells_of(config):
        write_json(cell_path(tmp_path / "c", *cell), compare.swim_cell(config, *cell))
    found = compare.conclude(tmp_path / "c")
    conditions = [row.condition for row in found.rows]
    assert sorted(conditions) == sorted(
        [
            "twin",
            "full",
            "no lag",
            "no stall",
            "no added inertia",
            "no delay",
            "ideal servo",
            "ensemble",
            "everyday labs",
            "rough labs",
        ]
    )
    full = next(row for row in found.rows if row.condition == "full")
    assert full.speed and full.speed > 0.05 and full.speed_in_twin and full.speed_in_twin > 0.05
    assert full.actuator_watts and full.actuator_watts > 0
    parts = [full.share_below_floor, full.share_inside, full.share_above]
    assert sum(part or 0.0 for part in parts) == pytest.approx(1.0)
    assert full.near_gap and full.near_gap.interval[0] <= full.near_gap.difference
    path, _ = of_folder(tmp_path / "c", "pulley-fish")
    kind = next(row for row in found.kinds if row.condition == "full")
    assert ["generator", "identified", "full", "1"] in [c[:4] for c in cells_of(path.read_text())]
    assert f"<td>{kind.speed:.3g}</td>" in path.read_text()
    assert json.loads((tmp_path / "c" / "report.json").read_text()) == plain(found)


@pytest.mark.parametrize("name", ["pulley-fish-pool-generator", "pulley-fish-pool-follow"])
def test_a_policy_observes_in_every_cell_what_it_was_trained_with(name):
    """A policy that observes velocities was given none, and the comparison ended in a traceback."""
    field = compare.Field(load_fish("pulley-fish"), 2, 0)
    entrant = compare._entrant(name, None, field.fish)
    found = compare.conditions_of(entrant, field)
    assert {one.motion for one in found} == {entrant.policy.contract.motion}
    assert {one.yaw_rate for one in found} == {entrant.policy.contract.yaw_rate}
    short = replace(found[1], seconds=1.0)
    assert compare.cell(entrant, short, field).targets == 2


def test_a_comparison_may_be_of_some_conditions_alone():
    some = ComparisonConfig((POLICY,), targets=2, only=("twin", "rough labs"))
    assert [condition for _, condition in compare.cells_of(some)] == ["twin", "rough labs"]
    with pytest.raises(BadInput, match="--only 'sea': not a condition; allowed are twin, full, no"):
        compare.cells_of(replace(some, only=("full", "sea")))


def test_policies_of_a_sweep_are_told_apart_by_their_trials(tmp_path, monkeypatch):
    """All of them are `run/policy.onnx`, and were refused as two of the same name."""
    paths = [tmp_path / f"trials/direct-seed-{seed}/run/policy.onnx" for seed in (0, 1)]
    paths.append(tmp_path / "mine/policy.onnx")
    for path in paths:
        path.parent.mkdir(parents=True)
        shutil.copyfile(shipped()[POLICY], path)
    config = ComparisonConfig(tuple(map(str, paths)), targets=2, only=("twin",))
    names = ["direct-seed-0", "direct-seed-1", "mine"]
    assert compare.cells_of(config) == [(name, "twin") for name in names]
    monkeypatch.chdir(tmp_path / "mine")
    here = replace(config, policies=("policy.onnx",))
    assert compare.cells_of(here) == [("mine", "twin")]


def test_cells_of_a_policy_that_was_trained_anew_are_not_its_own(tmp_path):
    path, out = tmp_path / "mine/policy.onnx", tmp_path / "comparison"
    path.parent.mkdir()
    shutil.copyfile(shipped()[POLICY], path)
    config = ComparisonConfig((str(path),), targets=2, only=("twin", "full"))
    first, second = compare.cells_of(config)
    write_json(cell_path(out, *first), compare.swim_cell(config, *first))
    assert compare.cells_left(config, out) == [second]
    one = load_fish("pulley-fish")
    changed = one.model_copy(update={"added_inertia": 0.5})
    assert compare.pool_digest(changed) != compare.pool_digest(one)
    for other, complaint in {
        replace(config, targets=3): "--targets was 2, now 3",
        replace(config, seed=1, only=("full",)): "--seed was 0, now 1",
    }.items():
        with pytest.raises(BadInput, match=complaint):
            compare.cells_left(other, out)
    held = json.loads(cell_path(out, *first).read_text())
    write_json(cell_path(out, *first), held | {"pool": "of before"}, overwrite=True)
    with pytest.raises(BadInput, match="pulley-fish, the waters or the messy labs are others now"):
        compare.cells_left(config, out)
    write_json(cell_path(out, *first), held, overwrite=True)
    shutil.copyfile(shipped()["pulley-fish-pool-follow"], path)
    with pytest.raises(BadInput, match=r"mine\.twin\.json: policy mine is another one now"):
        compare.cells_left(config, out)


def test_cells_of_an_earlier_version_are_read(tmp_path):
    """They said `arm`, and lacked the policy's digest and three of the fractions of power."""
    config = ComparisonConfig((POLICY,), targets=2)
    first, *_ = compare.cells_of(config)
    write_json(cell_path(tmp_path, *first), compare.swim_cell(config, *first))
    found = compare.conclude(tmp_path)
    (path,) = (tmp_path / "cells").iterdir()
    held = json.loads(path.read_text())
    held["arm"] = held.pop("condition")
    for name in ("digest", "pool", "share_below_floor", "share_inside", "share_above"):
        del held[name]
    path.write_text(json.dumps(held))
    row, same = comparison.read(tmp_path).rows[0], found.rows[0]
    assert row == replace(same, share_below_floor=None, share_inside=None, share_above=None)
    assert compare.cells_left(config, tmp_path) == compare.cells_of(config)[1:]


@pytest.mark.thorough
def test_what_does_not_fit_is_refused(evaluated, tmp_path):
    out, _ = evaluated
    with pytest.raises(BadInput, match="fish is not the pool's"):
        tried("crank-fish", "full", ("reach",), 6, tmp_path / "a")
    with pytest.raises(BadInput, match=f"episodes was {EPISODES}, now 7"):
        tried("pulley-fish", "full", ("reach",), 7, out)
    with pytest.raises(BadInput, match="--pool 'sea': allowed are ensemble"):
        tried("pulley-fish", "sea", ("reach",), 6, tmp_path / "a")
    with pytest.raises(BadInput, match="--tasks dive: allowed are reach"):
        tried("pulley-fish", "full", ("dive",), 6, tmp_path / "a")
    with pytest.raises(BadInput, match="beyond is now called out-of-distribution"):
        tried("pulley-fish", "full", ("beyond",), 6, tmp_path / "a")
    for size, complaint in (
        ("1x0.7", "no free target"),
        ("3x2", "the eight needs"),
        ("a", "--walls"),
    ):
        with pytest.raises(BadInput, match=complaint):
            config = EvaluationConfig(pool="full", episodes=4, walls=_walls(size))
            where = evaluation.pool_of(load_policy(POLICY), config)
            evaluation.conditions_of(where, ["reach", "track"])
    for lab, tasks, complaint in (
        ("rough", ("reach",), "--mess rough: it is for the task track"),
        ("dirty", ("track",), "mess 'dirty': allowed are clean"),
    ):
        config = EvaluationConfig(pool="full", tasks=tasks, episodes=4, lab=lab)
        with pytest.raises(BadInput, match=complaint):
            evaluation.evaluate(load_policy(POLICY), config, tmp_path / "a", lambda *_: None)
    with pytest.raises(BadInput, match="folder is empty or missing"):
        of_folder(tmp_path / "nothing", "pulley-fish")
    assert not (tmp_path / "a").exists()
    assert isinstance(SPACE, Generator)


def test_a_posterior_is_that_of_the_fish_inside_the_policy():
    """A policy may carry an older fish of the same name: its draws were those of the newer one."""
    own = load_fish("pulley-fish-pool")
    assert evaluation._draws("pulley-fish-pool", own) is not None
    older = own.model_copy(update={"added_inertia": own.added_inertia + 0.1})
    assert evaluation._draws("pulley-fish-pool", older) is None


def test_the_page_of_a_folder_is_of_the_fish_that_swam_there(tmp_path):
    """Another fish's body was drawn on its angles, or the figures ended in a traceback."""
    policy, config = load_policy(POLICY), EvaluationConfig(seed=5)
    store.begin(tmp_path, evaluation.describe(policy, evaluation.pool_of(policy, config)))
    with pytest.raises(BadInput, match="pulley-fish swam there, not crank-fish"):
        of_folder(tmp_path, "crank-fish")


def test_behind_a_path_every_swim_has_its_own_lab_and_other_tasks_stay_clean():
    policy, config = load_policy(POLICY), EvaluationConfig(seed=5, lab="rough")
    pool = evaluation.pool_of(policy, config)
    clean = replace(pool, lab="clean")
    [messy] = evaluation.conditions_of(pool, ["track"])
    [track] = evaluation.conditions_of(clean, ["track"])
    labs = [lab_at("rough", 5, i) for i in range(track.count)]
    assert messy.wear == tuple(lab.wear for lab in labs) and len(set(messy.wrong)) > 100
    assert messy.wrong == tuple(lab.errors for lab in labs)
    assert [one.walls for one in messy.around] == [pool.walls] * track.count
    assert not track.wrong and len(track.around) == len(track.wear) == 1
    reaching = (evaluation.conditions_of(of, ["reach"]) for of in (pool, clean))
    for one, same in zip(*reaching, strict=True):
        assert (one.wear, one.around, one.wrong) == (same.wear, same.around, same.wrong)


def test_swims_of_other_labs_do_not_go_into_one_folder(tmp_path):
    policy, config = load_policy(POLICY), EvaluationConfig(seed=5)
    run = evaluation.describe(policy, evaluation.pool_of(policy, config))
    store.begin(tmp_path, replace(run, lab="rough"))
    with pytest.raises(BadInput, match="lab was rough, now clean"):
        store.begin(tmp_path, run)
    assert store.read_description(tmp_path).lab == "rough"
