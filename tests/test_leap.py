"""The recipe's short way: early verdicts, the leap into the last stage and back, and the polish."""

import json
from collections.abc import Collection
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("stable_baselines3", reason="the train extra is not installed")

from tailbeat.cli.progress import _cells
from tailbeat.control.actions import PERIOD
from tailbeat.control.policy import decide, load_policy
from tailbeat.env.assess import Swims, assess
from tailbeat.env.curriculum import LOWEST, STAGES, settings_of
from tailbeat.env.world import World
from tailbeat.files import BadInput, write_json
from tailbeat.train import callback as at
from tailbeat.train import checkpoint
from tailbeat.train.callback import TrainingCallback
from tailbeat.train.config import RunConfig, check
from tailbeat.train.episodes import Episodes
from tailbeat.train.progress import Progress, TrainingRow
from tailbeat.train.recipes import following, paper, quick, recipe_of, smoke
from tailbeat.train.spaces import action_space
from tailbeat.train.train import environment, learner, train
from tailbeat.train.verdict import certain
from test_train import FISH, planned_for

pytestmark = pytest.mark.long


@pytest.fixture(autouse=True)
def all_promise(monkeypatch: pytest.MonkeyPatch) -> None:
    """Exploring fish always promise a pass, and no film is drawn."""
    monkeypatch.setattr(Episodes, "promise", lambda self: 1.0)
    monkeypatch.setattr(at.rendering, "film", lambda *_: None)


def leaping(out: Path, **changes: Any) -> RunConfig:
    """A run that leaps from the first of four stages into the last."""
    run = planned_for(out, hours=0.1)
    rest: dict[str, Any] = {"rates": (1e-3,) * 3}
    rest |= {"promising": 0.9, "between": 10, "leap": 40, "polish": 0} | changes
    return replace(run, recipe=replace(run.recipe, stages=STAGES[:4], **rest))


def deciding(
    monkeypatch: pytest.MonkeyPatch, passes: Any, stop: Collection[int] = ()
) -> list[tuple[int, int]]:
    """Verdicts by a rule (stage from 1, updates); returns those that were asked for. One in a stage
    of `stop` interrupts the training."""
    asked: list[tuple[int, int]] = []

    def examined(self: TrainingCallback, *_: Any) -> tuple[bool, Swims]:
        told = self.progress.stage + 1, self.model._n_updates
        asked.append(told)
        self.stop = told[0] in stop
        some, self.seen = np.ones(4), np.zeros((4, 24), np.float32)
        return passes(*told), Swims(some > 0, *(some,) * 6, self.seen)

    monkeypatch.setattr(TrainingCallback, "_verdict", examined)
    return asked


@pytest.mark.thorough
def test_the_last_stage_follows_the_first_and_counts_for_all(tmp_path, monkeypatch):
    asked = deciding(monkeypatch, lambda stage, updates: True)
    done = train(leaping(tmp_path / "run"), False, print)
    assert [stage for stage, _ in asked] == [1, 4]
    assert done.finished and done.passed() == 4
    held = load_policy(tmp_path / "run" / "policy.onnx").contract.training
    assert held["stages_passed"] == 4 and held["stage"] == STAGES[3].name


@pytest.mark.thorough
def test_a_leap_that_does_not_pass_goes_back_to_the_stages_between(tmp_path, monkeypatch):
    failed: list[int] = []

    def passes(stage: int, updates: int) -> bool:
        first_time = stage == 4 and (not failed or updates <= failed[0] + 150)
        failed.extend([updates] if first_time else [])
        return not first_time

    asked = deciding(monkeypatch, passes)
    run = leaping(tmp_path / "run", between=40, leap=150)
    # Half a second, 25 updates: whatever an untrained fish does, its episodes then end.
    brief = replace(run.recipe, task=replace(run.recipe.task, seconds=0.5))
    done = train(replace(run, recipe=brief), False, print)
    order = [stage for i, (stage, _) in enumerate(asked) if not i or asked[i - 1][0] != stage]
    assert order == [1, 4, 2, 3, 4] and done.finished and done.passed() == 4
    tried = [updates for stage, updates in asked if stage == 4 and updates <= failed[0] + 150]
    assert len(tried) > 1 and min(np.diff(tried)) >= 40  # `between` lies between two verdicts
    assert [row.stage for row in done.promotions] == [1, 2, 3, 4]


@pytest.mark.slow
def test_without_a_leap_every_stage_comes_in_turn(tmp_path, monkeypatch):
    asked = deciding(monkeypatch, lambda stage, updates: True)
    train(leaping(tmp_path / "run", leap=0), False, print)
    assert [stage for stage, _ in asked] == [1, 2, 3, 4]


@pytest.mark.thorough
@pytest.mark.parametrize("better", [True, False])
def test_a_polish_is_kept_only_if_it_arrives_earlier(tmp_path, monkeypatch, better):
    deciding(monkeypatch, lambda stage, updates: True)
    seconds = iter([9.0, 8.0 if better else 10.0])  # of the policy that passed, and of the polished
    monkeypatch.setattr(TrainingCallback, "_lateness", lambda self, decided: next(seconds))
    done = train(leaping(tmp_path / "run", polish=30), False, print)
    assert done.finished and done.passed_at is not None
    passed, kept = ((tmp_path / "run" / f"{name}.onnx").read_bytes() for name in NAMES)
    assert (kept == passed) is not better
    updates = load_policy(tmp_path / "run" / "policy.onnx").contract.training["updates"]
    assert (int(updates) >= done.passed_at + 30) is better


NAMES = ("stage-04", "policy")


@pytest.mark.thorough
def test_a_leap_outlives_an_interruption(tmp_path, monkeypatch):
    """Resumed in the last stage, a run goes back when it would have."""
    stop = {4}
    asked = deciding(monkeypatch, lambda stage, updates: stage < 4, stop)
    run = leaping(tmp_path / "run", leap=10**6)
    early = train(run, False, print)
    assert early.stage == 3 and early.leapt is not None
    state = tmp_path / "run" / "checkpoint" / "state.json"
    held = json.loads(state.read_text())
    state.write_text(json.dumps(held | {"leapt": held["leapt"] - 10**6}))
    asked.clear()
    stop.add(2)
    done = train(run, True, print)
    assert [stage for stage, _ in asked] == [2] and done.leapt is None


@pytest.mark.thorough
def test_a_polish_outlives_an_interruption(tmp_path, monkeypatch):
    deciding(monkeypatch, lambda stage, updates: True, {4})
    monkeypatch.setattr(TrainingCallback, "_lateness", lambda self, decided: 9.0)
    run = leaping(tmp_path / "run", polish=30)
    early = train(run, False, print)
    assert early.passed_at is not None and not early.finished
    done = train(run, True, print)
    assert done.finished and done.passed_at == early.passed_at
    updates = load_policy(tmp_path / "run" / "policy.onnx").contract.training["updates"]
    assert int(updates) >= early.passed_at + 30


def test_a_checkpoint_of_before_leaps_is_read(tmp_path):
    held = asdict(Progress(stage=2)) | {"decisions": 5, "updates": 7, "buffer": [3, False]}
    del held["leapt"], held["passed_at"]
    (tmp_path / "state.json").write_text(json.dumps(held))
    saved = checkpoint.read_state(tmp_path)
    assert (saved.progress.stage, saved.progress.leapt, saved.updates) == (2, None, 7)


@pytest.mark.parametrize("task", ["reach", "follow"])
def test_a_checkpoint_without_velocities_is_of_use_only_where_targets_stay(tmp_path, task):
    """Older buffers do not say how tag and target moved, which the reward of following needs."""
    recipe = recipe_of("smoke", task)
    run = RunConfig(FISH, tmp_path, recipe, action_space("generator", FISH))
    env = environment(run)
    model = learner(run, env)
    checkpoint.save(tmp_path, model, env.world, Progress(stage=0))
    place = tmp_path / "checkpoint"
    with np.load(place / "buffer.npz") as arrays:
        held = {name: arrays[name] for name in arrays if name != "went"}
    np.savez(place / "buffer.npz", **held)
    if task == "reach":
        assert checkpoint.load(place, model, env.world).progress.stage == 0
        return
    with pytest.raises(BadInput, match="lacks went; it was written before"):
        checkpoint.load(place, model, env.world)


def test_a_polish_says_how_far_it_is():
    row = TrainingRow(90.0, 10, "arc 180", 1.0, 9, 9, 2_500, 1.0, 20.0, *(0.0,) * 4, lost=0)
    told = Progress(stage=9, passed_at=2_000).estimated(row, 4_000)
    assert (told.polished, told.promotion_in) == (0.125, 3_500 / 20)
    cells = _cells(told)
    assert cells["stage"] == "10 arc 180, 12 % polished" and cells["ready in"] == "2.9 min"
    assert "promotion in" in _cells(Progress(stage=9).estimated(row, 4_000))


def test_a_run_begun_before_leaps_goes_on_with_them(tmp_path):
    held = asdict(planned_for(tmp_path, recipe=quick()).record())
    for name in ("promising", "between", "leap", "polish", "late_rate"):
        del held["recipe"][name]
    write_json(tmp_path / "run.json", held)
    check(planned_for(tmp_path, recipe=quick()), resume=True)
    with pytest.raises(BadInput, match=r"recipe.batch was 256, now 128"):
        check(planned_for(tmp_path, recipe=replace(quick(), batch=128)), resume=True)


def test_a_run_begun_before_normalised_critics_goes_on_without_them(tmp_path):
    before = planned_for(tmp_path, recipe=replace(quick(), normalised=False))
    held = asdict(before.record())
    del held["recipe"]["normalised"]
    write_json(tmp_path / "run.json", held)
    check(before, resume=True)
    with pytest.raises(BadInput, match=r"was False, now True.*--no-normalised\)"):
        check(planned_for(tmp_path, recipe=quick()), resume=True)


def test_the_rate_of_leap_and_polish(tmp_path):
    run = leaping(tmp_path, polish=100)
    progress = Progress(stage=3, leapt=50)
    told = TrainingCallback.__new__(TrainingCallback)
    told.run, told.progress = run, progress
    told.model = type("Model", (), {"_n_updates": 60})()
    assert told._rate(0.0) == run.recipe.late_rate
    progress.leapt, progress.passed_at = None, 60
    assert told._rate(0.0) == run.recipe.late_rate
    told.model._n_updates = 110
    assert told._rate(0.0) == pytest.approx(run.recipe.late_rate / 2)
    told.model._n_updates = 160
    assert told._rate(0.0) == LOWEST


def test_swims_that_are_settled_from_the_start_make_one_step():
    """With 13 misses in 252 of 256 swims nothing can pass any more."""
    build = partial(World, FISH, settings_of(STAGES[0]))

    def still(seen: Any) -> Any:
        return np.zeros((len(seen), 6), np.float32)

    swims = assess(still, build, 4, 1, lambda reached, going: certain(239, 13, reached, going))
    assert not swims.reached.any() and set(swims.seconds) == {PERIOD}


def test_following_asks_greedy_fish_early_but_has_neither_leap_nor_polish():
    """Half a minute beside the target takes as long for every fish: nothing arrives early, so a
    share of exploring fish is no more than their success rate."""
    recipe = following(quick())
    assert (recipe.leap, recipe.polish) == (0, 0) and recipe.promising is not None
    assert 0.7 < recipe.promising < 0.95 and recipe.between > quick().between
    assert following(paper()).promising is None and not following(paper()).greedy
    assert following(smoke()).promising is None


@pytest.mark.slow  # some minutes
@pytest.mark.parametrize("seed", [0, 3])
def test_the_whole_task_is_learned_within_3_000_updates(tmp_path, monkeypatch, seed):
    """Eight seeds needed 748 to 1,490; with usual critics 1,742 to 2,914."""
    monkeypatch.undo()
    run = RunConfig(FISH, tmp_path / "run", replace(quick(), polish=0), seed=seed, hours=0.5)
    done = train(run, False, lambda row: None)
    assert done.finished and done.passed_at is not None and done.passed_at <= 3_000
    policy = load_policy(tmp_path / "run" / "policy.onnx")
    build = partial(World, FISH, settings_of(STAGES[8], policy.contract.actions))
    swims = assess(partial(decide, policy), build, 1_000, 7)
    assert swims.reached.mean() >= 0.99
