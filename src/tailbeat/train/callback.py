"""The training callback: counts arrivals, promotes, reports, evaluates, writes checkpoints."""

import shutil
import time
from collections import deque
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import torch
from stable_baselines3 import SAC
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.type_aliases import TrainFreq, TrainFrequencyUnit

from tailbeat.control.actions import PERIOD
from tailbeat.env import curriculum, rendering
from tailbeat.env.assess import Summary, Swims, assess, joined
from tailbeat.env.errors import Errors
from tailbeat.env.vector_env import FishVecEnv
from tailbeat.env.world import World
from tailbeat.files import BadInput
from tailbeat.train import checkpoint
from tailbeat.train.config import RunConfig
from tailbeat.train.export import Facts, act, export
from tailbeat.train.progress import Progress, Report, TrainingRow
from tailbeat.train.sac import QuickSAC
from tailbeat.train.verdict import passed

REPORT_SECONDS = 5.0
EXAM_SECONDS = 300.0  # between greedy evaluations
EXAM, EXAM_SEED = 64, 9_000  # number and seed of an evaluation's targets, always the same
KEPT = 5  # windows of episodes that are kept
RECENT = 24  # rows of the history from which the time to promotion is estimated


class EpisodeSums(NamedTuple):
    """One episode: the sums of the reward's terms, and its length [s]."""

    distance: float
    effort: float
    bonus: float
    seconds: float


class TrainingCallback(BaseCallback):
    """SB3's callback. `progress` is the state of an earlier session; set `stop` to end the training
    after the current step."""

    model: SAC

    def __init__(self, run: RunConfig, progress: Progress, env: FishVecEnv, report: Report) -> None:
        super().__init__()
        self.run, self.progress, self.env, self.report = run, progress, env, report
        self.stop, self.next_verdict = False, 0
        self.sums: deque[EpisodeSums] = deque(maxlen=run.recipe.window)
        self.starts: list[int | None] = [None] * env.num_envs  # episodes started in this stage

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
                self._count(fish, info)
        self.progress.seconds = self.before + time.monotonic() - self.began
        if self.locals["dones"].any():
            self._judge_stage()
        self._end_stalled_stage()
        for name, work in (("report", self._tell), ("exam", self._examine), ("keep", self.keep)):
            if time.monotonic() >= self.due[name]:
                work()
        over = time.monotonic() - self.began > 3600 * self.run.hours
        return not (self.stop or over or self.progress.finished or self.progress.stalled)

    # ---- stages ---------------------------------------------------------------------------------

    def _enter(self) -> None:
        """Set the world and the learning rate to the present stage."""
        recipe, stage = self.run.recipe, self.progress.stage
        self.env.world.change(self.run.settings(stage))
        if isinstance(self.model, QuickSAC):  # correlated noise helps only at first
            self.model.memory = recipe.memory if stage == 0 else 0.0
        rate = curriculum.learning_rate(recipe.stages, stage, recipe.rates)
        self.model.lr_schedule = lambda _: rate  # SB3 ignores `learning_rate` once it is built
        self._set_pace(self._judged())
        self.starts = [None] * self.env.num_envs  # running episodes started in the stage before

    def _set_pace(self, judged: list[bool]) -> None:
        """Set the steps between updates: a decision on promotion takes at least thirty seconds of
        swimming, and most stages turn out to need no learning."""
        recipe = self.run.recipe
        waiting = recipe.waiting if len(judged) < recipe.window else 1
        pace = TrainFreq(waiting, TrainFrequencyUnit.STEP)
        self.model.train_freq = pace  # type: ignore[assignment]  # SB3 converts it

    def _count(self, fish: int, info: dict[str, Any]) -> None:
        self.progress.episodes += 1
        begun = self.starts[fish]
        if begun is not None:
            self.progress.recent.append((begun, bool(info["reached"])))
            del self.progress.recent[: -KEPT * self.run.recipe.window]
            seconds = PERIOD * info["episode"]["l"]
            self.sums.append(EpisodeSums(**info["reward_terms"], seconds=seconds))
        self.starts[fish] = self.progress.clock(self.env.num_envs)

    def _judged(self) -> list[bool]:
        """Arrivals of the last complete episodes, by start time.

        An arrival ends an episode early, so the episodes that ended last are mostly arrivals. An
        episode counts only once every episode that started as early has ended.
        """
        known = self.progress.over(self.env.num_envs, self.env.world.steps_per_episode)
        order = sorted(known, key=lambda row: row[0])
        return [arrived for _, arrived in order[-self.run.recipe.window :]]

    def _judge_stage(self) -> None:
        judged = self._judged()
        if self._ripe(judged) and (swims := self._passed()) is not None:
            self._promote(swims)
            return
        self._set_pace(judged)

    def _end_stalled_stage(self) -> None:
        """At every step: on a slow machine no episode may end for longer than a short budget."""
        progress = self.progress
        spent = progress.seconds - progress.stage_began
        if not progress.finished and spent > 3600 * self.run.recipe.budget_hours:
            progress.stalled = True

    def _ripe(self, judged: list[bool]) -> bool:
        """Whether exploring fish do so well that a verdict is worth its swims. After a failed one
        a whole window of episodes must end first."""
        recipe, progress = self.run.recipe, self.progress
        enough = len(judged) == recipe.window and progress.episodes >= self.next_verdict
        return enough and _fraction(judged) > curriculum.PROMOTED

    def _passed(self) -> Summary | None:
        """Summary of greedy swims that pass this stage, None if they fail it. The paper's recipe
        asks for no greedy swims: there the first evaluation is only reported."""
        swims = [self._examine()]
        if not self.run.recipe.greedy:
            return swims[0].summary()
        while (said := passed(joined(swims).reached.tolist(), curriculum.PROMOTED)) is None:
            swims.append(self._examine(len(swims)))
        self.next_verdict = self.progress.episodes + self.run.recipe.window
        return joined(swims).summary() if said else None

    def _promote(self, greedy: Summary) -> None:
        """Write the policy and a film, then enter the next stage."""
        progress, stages = self.progress, self.run.recipe.stages
        row = replace(self._tell(), greedy=greedy)
        progress.promotions.append(row)
        self.write_policy()
        kept = self.run.out / f"stage-{progress.stage + 1:02d}"
        shutil.copyfile(self.run.out / "policy.onnx", kept.with_suffix(".onnx"))
        settings = self.run.settings(progress.stage)
        rendering.film(self._decide, self.run.fish, settings, kept.with_suffix(".mp4"))
        if progress.stage + 1 == len(stages):
            progress.finished = True
            return
        progress.stage, progress.stage_began = progress.stage + 1, progress.seconds
        progress.recent.clear()
        self._enter()
        self.keep()

    # ---- reports and checkpoints ----------------------------------------------------------------

    def _decide(self, seen: Any) -> Any:
        return act(self.model, seen)

    def _examine(self, number: int = 0) -> Swims:
        """Greedy swims to fixed targets of this stage; another `number` has other targets."""
        fish, settings = self.run.fish, self.run.settings(self.progress.stage)
        seed = EXAM_SEED + number
        swims = assess(self._decide, lambda seeds: World(fish, settings, seeds), EXAM, seed)
        self.seen = swims.seen
        self.logger.record("greedy/reached", float(swims.reached.mean()))
        self.due["exam"] = time.monotonic() + EXAM_SECONDS
        return swims

    def write_policy(self) -> None:
        """Write `policy.onnx` with the present networks into the run's folder."""
        if not hasattr(self, "seen"):
            self._examine()
        stage = self.run.recipe.stages[self.progress.stage]
        training: Facts = {
            "stage": stage.name,
            "stages_passed": self.progress.passed(),
            "seed": self.run.seed,
            "recipe": self.run.recipe.name,
            "physics": self.run.record().physics,
            "errors": _widths(self.run.errors),
            "updates": self.model._n_updates,
            "control_steps": self.progress.control_steps,
            "hours": round(self.progress.seconds / 3600, 3),
            "target_speed": self.run.settings(self.progress.stage).task.target_speed,
            "rounded": isinstance(self.model, QuickSAC) and self.model.rounded,
        }
        export(self.model, self.run, self.seen, training, self.run.out / "policy.onnx")

    def keep(self) -> None:
        """Write a checkpoint now."""
        checkpoint.save(self.run.out, self.model, self.env.world, self.progress)
        self.due["keep"] = time.monotonic() + 60 * self.run.checkpoint_minutes

    def _tell(self) -> TrainingRow:
        """Make one row of the history, report it and log it."""
        self._check_finite()
        row = self._row()
        self.last = time.monotonic(), row.control_steps, row.updates
        self.progress.history.append(row)
        row = replace(row, promotion_in=self._promotion_in())
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
        return TrainingRow(
            seconds=progress.seconds,
            stage=progress.stage + 1,
            name=self.run.recipe.stages[progress.stage].name,
            success=_fraction(self._judged()),
            episodes=progress.episodes,
            control_steps=steps,
            updates=updates,
            steps_per_s=(steps - self.last[1]) / span,
            updates_per_s=(updates - self.last[2]) / span,
            distance=_mean([one.distance for one in self.sums]),
            effort=_mean([one.effort for one in self.sums]),
            bonus=_mean([one.bonus for one in self.sums]),
            episode_seconds=_mean([one.seconds for one in self.sums]),
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

    def _promotion_in(self) -> float | None:
        """Estimated time [s] until the rolling success rate allows promotion, from its slope over
        the last rows; None if it does not rise."""
        rows = [row for row in self.progress.history if row.stage == self.progress.stage + 1]
        if len(rows) < RECENT // 2:
            return None
        time_, success = np.array([[row.seconds, row.success] for row in rows[-RECENT:]]).T
        slope = float(np.polyfit(time_ - time_[0], success, 1)[0])
        missing = curriculum.PROMOTED - float(success[-1])
        return max(missing / slope, 0.0) if slope > 1e-6 else None


def _fraction(judged: list[bool]) -> float:
    """Rolling success rate of a stage."""
    return float(np.mean(judged)) if judged else 0.0


def _mean(values: list[float]) -> float:
    return float(np.mean(values)) if values else float("nan")


def _widths(errors: Errors | None) -> str:
    """Half widths of what robots had wrong in training, in SI."""
    given = {} if errors is None else {name: w for name, w in vars(errors).items() if w}
    return ", ".join(f"{name} {width:.3g}" for name, width in given.items()) or "none"
