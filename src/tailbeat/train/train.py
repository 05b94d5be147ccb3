"""From a fish to a policy: build, resume, learn, write. `config` says what, `callback` watches."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields
from typing import Any

import torch
from stable_baselines3 import SAC
from stable_baselines3.common.logger import configure

from tailbeat.env.vector_env import FishVecEnv
from tailbeat.files import BadInput, write_json
from tailbeat.train import checkpoint
from tailbeat.train import config as planned
from tailbeat.train.callback import Coach, Course, Report
from tailbeat.train.config import Plan
from tailbeat.train.features import CloseUp
from tailbeat.train.recipes import DEPTH
from tailbeat.train.replay import RelabelBuffer
from tailbeat.train.sac import QuickSAC

FOREVER = 10**12


def train(plan: Plan, resume: bool, report: Report, stage: str | None = None) -> Course:
    """Train until the last stage is passed, the hours are over, a stage stalls or Ctrl-C. With a
    `stage` the run goes on in that one, whatever it has passed.

    Leaves `policy.onnx`, a checkpoint and `curve.json` in the folder whatever ended it. Raises
    BadInput before anything is built if the plan will not do, and when the disk is full.
    """
    planned.check(plan, resume)
    if stage is not None:
        planned.check_stage(plan, stage)
    place = checkpoint.find(plan.out) if resume else None
    if plan.recipe.torch_threads is not None:
        torch.set_num_threads(plan.recipe.torch_threads)
    env = environment(plan)
    model = learner(plan, env)
    course = Course()
    if place is None:
        planned.begin(plan)
    else:
        course = _restored(place, model, env)
    if stage is not None:
        _put_into(stage, plan, course)
    elif course.finished:
        raise BadInput(f"{plan.out}: this run has passed its stages; nothing to resume.")
    coach = Coach(plan, course, env, report)
    model.set_logger(configure(str(plan.out / "tensorboard"), ["tensorboard"]))
    with _stopped_by_signals(coach):
        model.learn(
            FOREVER, callback=coach, log_interval=FOREVER, reset_num_timesteps=place is None
        )
    coach.keep()
    coach.write_policy()
    write_json(plan.out / "curve.json", course.__dict__, overwrite=True)
    return course


def result(plan: Plan, course: Course) -> dict[str, Any]:
    """What came of a run: its folder, its policy, the stages that it passed."""
    return {
        "folder": str(plan.out),
        "policy": str(plan.out / "policy.onnx"),
        "stages_passed": course.passed(),
        "stages": sum(not one.by_hand for one in plan.recipe.stages),
        "finished": course.finished,
        "stalled": course.stalled,
        "hours": course.seconds / 3600,
        "promotions": course.promotions,
        "last": course.history[-1] if course.history else None,
    }


def environment(plan: Plan) -> FishVecEnv:
    """The plan's fish in its first stage."""
    recipe = plan.recipe
    return FishVecEnv(
        plan.fish,
        recipe.fish,
        plan.settings(0),
        seed=plan.seed,
        reward_scale=recipe.reward_scale,
    )


def learner(plan: Plan, env: FishVecEnv) -> SAC:
    """The plan's SAC, untrained, with an empty buffer."""
    recipe = plan.recipe
    more: dict[str, Any] = {}
    if recipe.relabel:
        kwargs = {
            "source": env,
            "discount": recipe.discount,
            "returns": recipe.returns,
            "misses": recipe.misses,
        }
        more = {"replay_buffer_class": RelabelBuffer, "replay_buffer_kwargs": kwargs}
    kind = QuickSAC if recipe.quick else SAC
    shape: dict[str, Any] = {"net_arch": [recipe.width] * DEPTH}
    if recipe.close_up:
        shape["features_extractor_class"] = CloseUp
    if recipe.quick:
        shape["optimizer_kwargs"] = {"fused": True}
        more |= {"memory": recipe.memory, "rounded": recipe.rounded}
    return kind(
        "MlpPolicy",
        env,
        learning_rate=recipe.rates[0],
        gamma=recipe.discount,
        tau=recipe.tau,
        buffer_size=recipe.buffer,
        batch_size=recipe.batch,
        learning_starts=recipe.starts,
        train_freq=1,
        gradient_steps=recipe.updates,
        ent_coef=recipe.entropy,
        policy_kwargs=shape,
        device=plan.device,
        seed=plan.seed,
        **more,
    )


def _restored(place: Any, model: SAC, env: FishVecEnv) -> Course:
    """Put a checkpoint into model and world; the course so far."""
    state = checkpoint.load(place, model, env.world)
    model.num_timesteps, model._n_updates = state["decisions"], state["updates"]
    names = {one.name for one in fields(Course)}
    course = Course(**{name: value for name, value in state.items() if name in names})
    # fish still on their way are lost with the world: what is left of their time is arrivals
    course.recent = course.over(env.num_envs, env.world.steps_per_episode)
    course.stalled = False  # it may have another budget's time
    course.stage_began = course.seconds if state["stalled"] else course.stage_began
    return course


def _put_into(stage: str, plan: Plan, course: Course) -> None:
    """Begin a stage by hand; the stages passed stay what they were."""
    names = [one.name for one in plan.recipe.stages]
    course.stage, course.stage_began = names.index(stage), course.seconds
    course.finished = False
    course.recent.clear()


@contextmanager
def _stopped_by_signals(coach: Coach) -> Iterator[None]:
    """Ctrl-C and SIGTERM end the training after the current round, with a checkpoint."""

    def ask(*_: Any) -> None:
        coach.stop = True

    kept = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in kept.items():
            signal.signal(number, handler)
