"""The training callback: counts arrivals, promotes, reports, evaluates, writes checkpoints."""

import shutil
import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import torch
from stable_baselines3 import SAC
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.type_aliases import TrainFreq, TrainFrequencyUnit

from tailbeat.control.actions import PERIOD
from tailbeat.control.policy import decide, load_policy
from tailbeat.env import curriculum, rendering
from tailbeat.env.assess import Decide, Settled, Summary, Swims, assess, never
from tailbeat.env.task import Settings
from tailbeat.env.vector_env import FishVecEnv
from tailbeat.env.world import World
from tailbeat.files import BadInput
from tailbeat.train import checkpoint
from tailbeat.train.config import RunConfig
from tailbeat.train.episodes import Episodes, EpisodeSums
from tailbeat.train.export import act, export
from tailbeat.train.facts import facts
from tailbeat.train.progress import Progress, Report, TrainingRow
from tailbeat.train.sac import QuickSAC
from tailbeat.train.verdict import examine

REPORT_SECONDS = 5.0
EXAM_SECONDS = 300.0  # between greedy evaluations
EXAM, EXAM_SEED = 64, 9_000  # number and seed of an evaluation's targets, always the same
POLISHED = 250  # targets by which the polished policy is compared with the one before


class TrainingCallback(BaseCallback):
    """SB3's callback. `progress` is the state of an earlier session; set `stop` to end the training
    after the current step."""

    model: SAC

    def __init__(self, run: RunConfig, progress: Progress, env: FishVecEnv, report: Report) -> None:
        super().__init__()
        self.run, self.progress, self.env, self.report = run, progress, env, report
        self.stop, self.due = False, dict[str, float]()
        self.tried: tuple[int, int] | None = None  # updates and episodes at the last verdict
        size = env.num_envs, env.world.steps_per_episode, run.recipe.window
        self.episodes = Episodes(progress, *size)

    # ---- SB3 calls these ------------------------------------------------------------------------

    def _on_training_start(self) -> None:
        now = time.monotonic()
        self.began, self.before = now, self.progress.seconds
        self.due = {
            "report": now + REPORT_SECONDS,
            "exam": now + EXAM_SECONDS,
            "keep": now + 60 * self.run.checkpoint_minutes,
        }
        self.last = now, self.progress.control_steps, self.model._n_updates
        self._enter()

    def _on_step(self) -> bool:
        self.progress.control_steps += self.env.num_envs
        for fish, info in enumerate(self.locals["infos"]):
            if "episode" in info:
                seconds = PERIOD * info["episode"]["l"]
                sums = EpisodeSums(**info["reward_terms"], seconds=seconds)
                self.episodes.count(fish, bool(info["reached"]), sums)
        self._take_time()
        if self.locals["dones"].any() and self.progress.passed_at is None:
            self._judge_stage()
        self._end_stage()
        for name, work in (("report", self._tell), ("exam", self._examine), ("keep", self.keep)):
            if time.monotonic() >= self.due[name]:
                work()
        over = time.monotonic() - self.began > 3600 * self.run.hours
        return not (self.stop or over or self.progress.finished or self.progress.stalled)

    def _take_time(self) -> None:
        self.progress.seconds = self.before + time.monotonic() - self.began

    # ---- stages ---------------------------------------------------------------------------------

    def _enter(self) -> None:
        """Set the world and the learning rate to the present stage."""
        recipe, stage = self.run.recipe, self.progress.stage
        self.env.world.change(self._settings())
        if isinstance(self.model, QuickSAC):  # correlated noise helps only at first
            self.model.memory = recipe.memory if stage == 0 else 0.0
        self.model.lr_schedule = self._rate  # SB3 ignores `learning_rate` once it is built
        self._set_pace()
        self.episodes.enter()

    def _settings(self) -> Settings:
        """The world's settings now."""
        return self.run.settings(self.progress.stage, self.progress.passed_at is not None)

    def _rate(self, _: float) -> float:
        """Learning rate: that of the stage, of a leap, or of the polish, falling to the lowest."""
        recipe, progress = self.run.recipe, self.progress
        if progress.passed_at is not None:
            done = (self.model._n_updates - progress.passed_at) / max(self.run.polish, 1)
            return max(recipe.late_rate * (1 - done), curriculum.LOWEST)
        if progress.leapt is not None:
            return recipe.late_rate
        return curriculum.learning_rate(recipe.stages, progress.stage, recipe.rates)

    def _set_pace(self) -> None:
        """Set the steps between updates: a decision on promotion takes at least thirty seconds of
        swimming, and most stages turn out to need no learning."""
        recipe, polished = self.run.recipe, self.progress.passed_at is not None
        few = len(self.episodes.judged()) < recipe.window
        waiting = recipe.waiting if few or polished else 1
        pace = TrainFreq(waiting, TrainFrequencyUnit.STEP)
        self.model.train_freq = pace  # type: ignore[assignment]  # SB3 converts it

    def _judge_stage(self) -> None:
        if self._ripe() and (swims := self._passed()) is not None:
            self._promote(swims)
            return
        self._set_pace()

    def _end_stage(self) -> None:
        """At every step, since on a slow machine no episode may end for longer than a short budget:
        end a leap that did not pass, the polish, or a stage that stalled."""
        recipe, progress, updates = self.run.recipe, self.progress, self.model._n_updates
        if progress.leapt is not None and updates > progress.leapt + recipe.leap:
            progress.leapt = None
            self._go_to(progress.passed())
        if progress.passed_at is not None:
            if updates >= progress.passed_at + self.run.polish:
                self._finish()
        elif progress.seconds - progress.stage_began > 3600 * recipe.budget_hours:
            progress.stalled = True

    def _ripe(self) -> bool:
        """Whether exploring fish do so well that a verdict is worth its swims. Between two verdicts
        lie some updates, or a whole window of episodes."""
        recipe, progress, episodes = self.run.recipe, self.progress, self.episodes
        updates_then, episodes_then = self.tried or (-recipe.between, -recipe.window)
        if recipe.promising is not None:
            rested = self.model._n_updates >= updates_then + recipe.between
            return rested and episodes.promise() >= recipe.promising
        rested = progress.episodes >= episodes_then + recipe.window
        enough = rested and len(episodes.judged()) == recipe.window
        return enough and episodes.success() > curriculum.PROMOTED

    def _passed(self) -> Summary | None:
        """Summary of greedy swims that pass this stage, None if they fail it. The paper's recipe
        asks for no greedy swims: there the first evaluation is only reported."""
        if not self.run.recipe.greedy:
            return self._examine().summary()
        said, swims = self._verdict()
        self.tried = self.model._n_updates, self.progress.episodes
        return swims.summary() if said else None

    def _verdict(self) -> tuple[bool, Swims]:
        first = EXAM_SEED + self.model._n_updates  # at every verdict other targets
        return examine(lambda batch, settled: self._examine(first + batch, settled))

    def _promote(self, greedy: Summary) -> None:
        """Write the policy, then enter the next stage, or the last after the first."""
        self._take_time()  # a verdict takes seconds
        progress, last = self.progress, len(self.run.recipe.stages) - 1
        progress.promotions.append(replace(self._tell(), greedy=greedy))
        self.write_policy()
        shutil.copyfile(self.run.out / "policy.onnx", self.kept())
        if progress.stage == last:
            progress.passed_at, progress.leapt = self.model._n_updates, None
            self.env.world.change(self._settings())
            self._set_pace()
        elif progress.stage == 0 and self.run.recipe.leap:
            progress.leapt = self.model._n_updates
            self._go_to(last)
        else:
            self._go_to(progress.stage + 1)
        self.keep()

    def _go_to(self, stage: int) -> None:
        progress = self.progress
        progress.stage, progress.stage_began = stage, progress.seconds
        progress.recent.clear()
        self._enter()

    def kept(self) -> Path:
        """The policy that passed this stage."""
        return self.run.out / f"stage-{self.progress.stage + 1:02d}.onnx"

    def _finish(self) -> None:
        """Hand over what the polish made, unless it reaches its targets later than before."""
        before, now = self.kept(), self.run.out / "policy.onnx"
        if self.run.polish:
            self.write_policy()
            earlier = self._lateness(partial(decide, load_policy(before)))
            if self._lateness(self._decide) > earlier:
                shutil.copyfile(before, now)
        settings, film = self._settings(), before.with_suffix(".mp4")
        rendering.film(partial(decide, load_policy(now)), self.run.fish, settings, film)
        self.progress.finished = True

    def _lateness(self, decided: Decide) -> float:
        """Mean time [s] to the targets of the last stage; a miss counts as the longest."""
        swims = self._swim(decided, EXAM_SEED, count=POLISHED)
        longest = self._settings().task.seconds
        return float(swims.lateness(longest).mean())

    # ---- reports and checkpoints ----------------------------------------------------------------

    def _decide(self, seen: Any) -> Any:
        return act(self.model, seen)

    def _examine(self, seed: int = EXAM_SEED, settled: Settled = never) -> Swims:
        """Greedy swims to targets of this stage; without a seed always the same."""
        swims = self._swim(self._decide, seed, settled)
        self.seen = swims.seen
        self.logger.record("greedy/reached", float(swims.reached.mean()))
        self.due["exam"] = time.monotonic() + EXAM_SECONDS
        return swims

    def _swim(
        self, decided: Decide, seed: int, settled: Settled = never, count: int = EXAM
    ) -> Swims:
        build = partial(World, self.run.fish, self._settings())
        return assess(decided, build, count, seed, settled)

    def write_policy(self) -> None:
        """Write `policy.onnx` with the present networks into the run's folder."""
        if not hasattr(self, "seen"):
            self._examine()
        training = facts(self.run, self.progress, self.model, self._settings())
        export(self.model, self.run, self.seen, training, self.run.out / "policy.onnx")

    def keep(self) -> None:
        """Write a checkpoint now. Raises BadInput if the networks are not finite."""
        self._check_finite()
        checkpoint.save(self.run.out, self.model, self.env.world, self.progress)
        self.due["keep"] = time.monotonic() + 60 * self.run.checkpoint_minutes

    def _tell(self) -> TrainingRow:
        """Make one row of the history, report it and log it."""
        self._check_finite()
        row = self._row()
        self.last = time.monotonic(), row.control_steps, row.updates
        self.progress.history.append(row)
        row = self.progress.estimated(row, self.run.polish)
        self.progress.history[-1] = row
        self.due["report"] = time.monotonic() + REPORT_SECONDS
        for name, value in vars(row).items():
            if isinstance(value, float | int):
                self.logger.record(f"course/{name}", value)
        self.logger.dump(row.control_steps)
        self.report(row)
        return row

    def _row(self) -> TrainingRow:
        progress, steps, updates = self.progress, self.progress.control_steps, self.model._n_updates
        span = max(time.monotonic() - self.last[0], 1e-9)
        means = self.episodes.means()
        return TrainingRow(
            seconds=progress.seconds,
            stage=progress.stage + 1,
            name=self.run.recipe.stages[progress.stage].name,
            success=self.episodes.success(),
            episodes=progress.episodes,
            control_steps=steps,
            updates=updates,
            steps_per_s=(steps - self.last[1]) / span,
            updates_per_s=(updates - self.last[2]) / span,
            distance=means.distance,
            effort=means.effort,
            bonus=means.bonus,
            episode_seconds=means.seconds,
            lost=int(self.env.world.simulator.warned.sum()),
        )

    def _check_finite(self) -> None:
        """End a run whose networks are not finite, before a checkpoint is written. Raises
        BadInput."""
        if not all(torch.isfinite(p).all() for p in self.model.policy.parameters()):
            raise BadInput(
                f"{self.run.out}: the training diverged before update {self.model._n_updates}: a"
                f" weight is not finite. The last checkpoint is intact: continue with --resume."
            )
