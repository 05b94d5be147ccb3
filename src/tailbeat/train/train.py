"""Train a policy for a fish: build, resume, learn, write."""

import shutil
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from stable_baselines3 import SAC
from stable_baselines3.common.logger import configure

from tailbeat.env.hidden import HIDDEN
from tailbeat.env.vector_env import FishVecEnv
from tailbeat.files import BadInput, write_json
from tailbeat.train import checkpoint
from tailbeat.train import config as config
from tailbeat.train.callback import TrainingCallback
from tailbeat.train.config import RunConfig
from tailbeat.train.features import InformedPolicy, TargetFeatures
from tailbeat.train.progress import CURVE, Progress, Report, TrainingResult, TrainingRow
from tailbeat.train.recipes import DEPTH
from tailbeat.train.replay import RelabelBuffer
from tailbeat.train.sac import QuickSAC

FOREVER = 10**12


def silent(row: TrainingRow) -> None:
    """Report nothing."""


def train(
    run: RunConfig,
    resume: bool = False,
    report: Report = silent,
    stage: str | None = None,
    again: bool = True,
) -> Progress:
    """Train until the last stage is passed, the hours are over, a stage stalls or Ctrl-C.

    A run that was killed before its first checkpoint is resumed from the start.
    With a `stage` the run continues in that stage, whatever it has passed. A stage that has stalled
    gets the time of another budget when it is resumed; without `again` it does not. A run with a
    `start` begins with the networks of that run, in the last stage, and only polishes. However it
    ends, it writes `policy.onnx`, a checkpoint and `curve.json` into the folder. Raises BadInput
    for a bad config before anything is built, and if the disk is full.
    """
    run = config.measured_run(run)
    config.check(run, resume)
    if stage is not None:
        config.check_stage(run, stage)
    place = _resumed_from(run.out) if resume else None
    if run.recipe.torch_threads is not None:
        torch.set_num_threads(run.recipe.torch_threads)
    env = environment(run)
    model = learner(run, env)
    progress = Progress()
    if place is None:
        if run.start is not None:
            checkpoint.load_networks(run.start, model)
            progress.stage, progress.passed_at = len(run.recipe.stages) - 1, 0
        config.begin(run)
    else:
        progress = _restored(place, model, env, again)
    if stage is not None:
        _put_into(stage, run, progress)
    elif progress.finished:
        raise BadInput(f"{run.out}: this run has passed all its stages; choose one with --stage.")
    env.world.change(run.settings(progress.stage))  # before the first reset
    callback = TrainingCallback(run, progress, env, report)
    model.set_logger(configure(str(run.out / "tensorboard"), ["tensorboard"]))
    if place is None and run.start is not None:
        callback.model = model
        callback.write_policy()
        shutil.copyfile(run.out / "policy.onnx", callback.kept())  # what the polish must beat
    with _stopped_by_signals(callback):
        model.learn(
            FOREVER, callback=callback, log_interval=FOREVER, reset_num_timesteps=place is None
        )
    callback.keep()
    if not progress.finished:
        callback.write_policy()
    write_json(run.out / CURVE, asdict(progress), overwrite=True)
    return progress


def _resumed_from(out: Path) -> Path | None:
    """The checkpoint of a run, None if it was killed before its first. Raises BadInput if a session
    came to its end, which leaves one, and it is gone: nothing that was learnt is overwritten."""
    place = checkpoint.find(out)
    if place is None and (out / CURVE).exists():
        raise BadInput(
            f"{out}: its checkpoint is gone, so it cannot be resumed; start without --resume in a"
            f" new folder."
        )
    return place


def result(run: RunConfig, progress: Progress) -> TrainingResult:
    """Result of a run."""
    return TrainingResult(
        folder=run.out,
        policy=run.out / "policy.onnx",
        stages_passed=progress.passed(),
        stages=len(run.recipe.stages),
        finished=progress.finished,
        stalled=progress.stalled,
        hours=progress.seconds / 3600,
        promotions=tuple(progress.promotions),
        last=progress.history[-1] if progress.history else None,
    )


def environment(run: RunConfig) -> FishVecEnv:
    """The run's environment in its first stage."""
    recipe = run.recipe
    return FishVecEnv(
        run.fish,
        recipe.fish,
        run.settings(0),
        seed=run.seed,
        reward_scale=recipe.reward_scale,
        informed=run.informed,
    )


def learner(run: RunConfig, env: FishVecEnv) -> SAC:
    """The run's SAC, untrained, with an empty buffer."""
    recipe = run.recipe
    more: dict[str, Any] = {}
    if recipe.relabel:
        kwargs = {
            "source": env,
            "discount": run.discount,
            "returns": recipe.returns,
            "misses": recipe.misses,
        }
        more = {"replay_buffer_class": RelabelBuffer, "replay_buffer_kwargs": kwargs}
    kind = QuickSAC if recipe.quick else SAC
    shape: dict[str, Any] = {"net_arch": [recipe.width] * DEPTH}
    if recipe.close_up:
        shape["features_extractor_class"] = TargetFeatures
        shape["features_extractor_kwargs"] = {"measure": run.measure}
    if run.informed:
        shape["features_extractor_kwargs"] |= {"hidden": HIDDEN}
    if recipe.quick:
        shape["optimizer_kwargs"] = {"fused": True}
        more |= {"memory": recipe.memory, "rounded": recipe.rounded}
        more |= {"normalised": recipe.normalised, "taught": run.start is not None}
    return kind(
        InformedPolicy if run.informed else "MlpPolicy",
        env,
        learning_rate=recipe.rates[0],
        gamma=run.discount,
        tau=recipe.tau,
        buffer_size=recipe.buffer,
        batch_size=recipe.batch,
        learning_starts=recipe.starts,
        train_freq=1,
        gradient_steps=recipe.updates,
        ent_coef=recipe.entropy,
        policy_kwargs=shape,
        device=run.device,
        seed=run.seed,
        **more,
    )


def _restored(place: Path, model: SAC, env: FishVecEnv, again: bool) -> Progress:
    """Load a checkpoint into model and world; returns the progress, in which a stalled stage has
    another budget if it is begun `again`."""
    state = checkpoint.load(place, model, env.world)
    env._reset_seeds()  # SB3 asked for the seed of the start, which would replay the first episodes
    model.num_timesteps, model._n_updates = state.decisions, state.updates
    progress = state.progress
    # running episodes are lost with the world; those that ended early are mostly arrivals
    progress.recent = progress.over(env.num_envs, env.world.steps_per_episode)
    if progress.stalled and again:
        progress.stage_began, progress.stalled = progress.seconds, False
    return progress


def _put_into(stage: str, run: RunConfig, progress: Progress) -> None:
    """Enter a stage by name; the stages passed are kept."""
    names = [one.name for one in run.recipe.stages]
    progress.stage, progress.stage_began = names.index(stage), progress.seconds
    progress.finished, progress.leapt, progress.passed_at = False, None, None
    progress.recent.clear()


@contextmanager
def _stopped_by_signals(callback: TrainingCallback) -> Iterator[None]:
    """Ctrl-C and SIGTERM end the training after the current round, with a checkpoint."""

    def ask(*_: Any) -> None:
        callback.stop = True

    kept = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in kept.items():
            signal.signal(number, handler)
