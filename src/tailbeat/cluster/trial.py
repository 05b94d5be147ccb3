"""One trial of a sweep, in a process of its own: `python -m tailbeat.cluster.trial FOLDER`.

The folder has all of a trial: what it is (`trial.json`), its training with checkpoints (`run`), and
the results of each part. A part that is done is not done again, so a trial goes on wherever its
folder is seen. One process works in it at a time: a second one waits.
"""

import fcntl
import json
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from psutil import Process

from tailbeat.cluster.plan import Evaluated, Sweep, Trial, Tried
from tailbeat.control.policy import Policy, decide, load_policy
from tailbeat.env.assess import assess
from tailbeat.env.curriculum import OPEN_WATER, Stage, settings_of
from tailbeat.env.task import as_seen
from tailbeat.evaluate import store
from tailbeat.evaluate.evaluation import EvaluationConfig, evaluate, waters_of
from tailbeat.evaluate.messy import LABS, PREFIX
from tailbeat.evaluate.reach import OPEN, in_twin, seeded
from tailbeat.evaluate.trial import CHUNK
from tailbeat.files import BadInput, write_json
from tailbeat.fish.store import load_fish, with_servo
from tailbeat.identify.posterior import factors_of
from tailbeat.pool.mess import for_training
from tailbeat.robot.fits import check_same_body
from tailbeat.train import checkpoint
from tailbeat.train.config import RunConfig, check, measured_run
from tailbeat.train.expect import FEWER, FISH, SECONDS, of_file
from tailbeat.train.progress import CURVE, TrainingRow, begun
from tailbeat.train.recipes import recipe_of
from tailbeat.train.spaces import action_space
from tailbeat.train.train import train

TRIAL, TRAINED, TRIED, RESULT = "trial.json", "trained.json", "tried.json", "result.json"
ENDED = 3  # exit code of a trial that was told to end; it goes on later


def run_of(trial: Trial, sweep: Sweep, folder: Path) -> RunConfig:
    """The training of a trial in `folder/run`. Raises BadInput."""
    changed: dict[str, Any] = dict(trial.changed)
    recipe = replace(recipe_of(trial.recipe, trial.task), **changed)
    fish = with_servo(load_fish(trial.fish), trial.servo)
    levels = (name or "clean" for name in (trial.mess, trial.build, trial.hard))
    wrong, built, hard = for_training(*levels)
    return RunConfig(
        fish,
        folder / "run",
        recipe,
        action_space(
            trial.actions, fish, trial.binds or recipe.binds, trial.floor or 0.0, trial.centre
        ),
        trial.seed,
        sweep.hours,
        device="cuda" if sweep.gpus else "cpu",
        checkpoint_minutes=sweep.checkpoint_minutes,
        draws=factors_of(trial.fish) if trial.physics == "posterior" else None,
        velocities=bool(trial.velocities),
        averages=bool(trial.averages),
        yaw_rate="camera" if trial.imu == "none" else "imu",
        errors=wrong,
        build=built,
        hard=hard,
    )


def check_trial(trial: Trial, sweep: Sweep, folder: Path) -> None:
    """Raises BadInput if a trial cannot be trained or evaluated: its fish, its actions, its memory,
    the pool's fish and waters. This machine needs no GPU."""
    run = replace(run_of(trial, sweep, folder), device="cpu")
    if sweep.evaluate is not None:
        check_same_body(run.fish, load_fish(sweep.evaluate.fish))
        waters_of(sweep.evaluate.pool)
    check(measured_run(run), resume=(folder / "run").exists())


def swim(folder: Path) -> None:
    """Train, try and evaluate what `folder` describes, as far as it is not done. Raises BadInput;
    SystemExit with `ENDED` if it is told to end."""
    held = json.loads((folder / TRIAL).read_text(encoding="utf-8"))
    sweep = Sweep.model_validate(held["sweep"], strict=False)
    trial = Trial(**held["trial"])
    run = run_of(trial, sweep, folder)
    if not (folder / TRAINED).is_file():
        _train(run, folder)
    policy = load_policy(str(run.out / "policy.onnx"))
    if not (folder / TRIED).is_file():
        write_json(folder / TRIED, _tried(policy, run, sweep.trial))
    pool = None if sweep.evaluate is None else _evaluated(policy, sweep.evaluate, folder)
    hits = {} if sweep.evaluate is None else _arrivals(sweep.evaluate, folder)
    trained = json.loads((folder / TRAINED).read_text(encoding="utf-8"))
    tried = json.loads((folder / TRIED).read_text(encoding="utf-8"))
    spent = time.time() - Process().create_time()
    result = {"trained": trained, "twin": tried, "pool": pool, "process_s": spent}
    result["hits"] = {"twin": tried.pop("hits", []), **hits}
    write_json(folder / RESULT, result, overwrite=True)


def process_span(folder: Path) -> tuple[float, float]:
    """When the process that ended a trial was started, with its imports, and when it had its result
    [s since 1970]."""
    path = folder / RESULT
    ended = path.stat().st_mtime
    return ended - float(json.loads(path.read_text(encoding="utf-8"))["process_s"]), ended


def _train(run: RunConfig, folder: Path) -> None:
    """Train until all stages are passed, one stalls or the hours are over; a training that is over
    is not continued."""
    course, used = _course(run), False
    if not _over(course):
        used = _learn(run)
        course = _course(run)
    if not _over(course) and not used:
        sys.exit(ENDED)
    if course["finished"] and run.space().kind != "turning":
        _expect(run)
    write_json(folder / TRAINED, _numbers(course, run))


def _course(run: RunConfig) -> dict[str, Any]:
    """What a training wrote at its end; empty before."""
    path = run.out / CURVE
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}


def _over(course: dict[str, Any]) -> bool:
    return bool(course and (course["finished"] or course["stalled"]))


def _learn(run: RunConfig) -> bool:
    """Train from the last checkpoint, or from the start; returns whether its hours are used up.
    They include those before the checkpoint. A stage that had stalled when the trial was killed
    gets no second budget."""

    def report(row: TrainingRow) -> None:
        say(updates=row.updates, stage=row.stage, success=row.success, seconds=row.seconds)

    place, began = checkpoint.find(run.out), time.monotonic()
    before = checkpoint.read_state(place).progress.seconds if place else 0.0
    left = max(3600 * run.hours - before, 1.0)  # a session also writes policy and curve
    train(replace(run, hours=left / 3600), begun(run.out), report, again=False)
    return time.monotonic() - began >= left


def _expect(run: RunConfig) -> None:
    """Write what the policy's swims look like into its file, as `tailbeat train` does."""
    size = FEWER if run.recipe.name == "smoke" else (FISH, SECONDS)
    try:
        of_file(str(run.out / "policy.onnx"), size=size)
    except BadInput as error:
        print(f"{error} `drive` has no sign test for it.", file=sys.stderr)


def _numbers(course: dict[str, Any], run: RunConfig) -> dict[str, Any]:
    last = course["history"][-1] if course["history"] else {}
    return {
        "stages_passed": max((row["stage"] for row in course["promotions"]), default=0),
        "stages": len(run.recipe.stages),
        "finished": course["finished"],
        "stalled": course["stalled"],
        "seconds": course["seconds"],
        "updates": last.get("updates", 0),
    }


def _tried(policy: Policy, run: RunConfig, asked: Tried) -> dict[str, Any]:
    """Swims in the twin, with all noise and randomisation, to the targets of every trial: their
    numbers, and the `hits` of each target."""
    held = policy.contract
    stage = Stage("trial", 3, 1.0, 1.0, float(np.radians(asked.arc)))
    settings = settings_of(stage, held.actions, OPEN_WATER, held.measure)
    settings = as_seen(settings, held)
    swims = assess(partial(decide, policy), in_twin(run.fish, settings), asked.targets, 0)
    return {**vars(seeded(policy, swims)), "hits": swims.reached.tolist()}


def _evaluated(policy: Policy, asked: Evaluated, folder: Path) -> dict[str, Any]:
    """Swims in the pool; those on disk are not swum again."""
    tasks = ("reach", "messy") if asked.messy else ("reach",)
    config = EvaluationConfig(asked.fish, pool=asked.pool, tasks=tasks, episodes=asked.episodes)
    done = evaluate(policy, config, folder / "evaluation", lambda name, swum, total: None)
    found = {name: asdict(one) for name, one in done.reach.items()}
    return found | {one.condition: asdict(one) for one in done.messy}


def _arrivals(asked: Evaluated, folder: Path) -> dict[str, list[bool]]:
    """Which targets were reached in open water of the pool, and in the labs of each level."""
    where = {"open": OPEN} | ({name: f"{PREFIX}{name}" for name in LABS} if asked.messy else {})
    chunks = -(-asked.episodes // CHUNK)
    swum = {k: store.load(folder / "evaluation", name, chunks)[0] for k, name in where.items()}
    return {k: [bool(one) for one in runs.reached] for k, runs in swum.items()}


def say(**row: float) -> None:
    """Report a row of numbers to the process that started this one: a line of JSON."""
    print(json.dumps(row), flush=True)


@contextmanager
def owned(folder: Path) -> Iterator[None]:
    """Be the only process that works in a folder; wait for another one to end."""
    with open(folder / ".owner", "wb") as owner:
        fcntl.flock(owner, fcntl.LOCK_EX)
        yield


def main(folder: Path) -> None:
    """Swim a trial. What is wrong goes to standard error in one line; the exit code is then 2."""
    try:
        with owned(folder):
            swim(folder)
    except (BadInput, OSError) as error:
        print(f"{error}", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
