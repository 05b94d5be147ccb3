"""Swim the trials of a sweep with Ray Tune: on this machine, or on a cluster.

Ray places trials, begins failed ones again and ends hopeless ones. What a trial has done lies in
its folder, not in Ray: a trial that is begun again, here or on another node, goes on from there.
"""

import contextlib
import importlib.metadata
import json
import os
import platform
import signal
import subprocess
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from tailbeat.cluster import connection
from tailbeat.cluster.plan import Sweep, Trial
from tailbeat.files import BadInput, write_json
from tailbeat.processes import ALONE, end, end_with_parent, start

# Ray reads these when it is imported: our own table is shown, and no file that nobody reads.
os.environ.setdefault("RAY_AIR_NEW_OUTPUT", "0")
os.environ.setdefault("TUNE_DISABLE_AUTO_CALLBACK_LOGGERS", "1")
os.environ.setdefault("RAY_TRAIN_ENABLE_V2_MIGRATION_WARNINGS", "0")

import ray
import ray.util.client
from ray import tune
from ray.tune.schedulers import ASHAScheduler, FIFOScheduler, MedianStoppingRule
from ray.util.queue import Empty, Queue

LONGEST, PATIENCE = 10_000_000, 2_000  # updates: a trial's most, and before which none is ended
SAME = ("tailbeat", "mujoco", "torch", "stable-baselines3", "numpy")  # versions on every node
RESULT, TRIAL = "result.json", "trial.json"


@dataclass(frozen=True)
class Row:
    """Where a trial is: its name, "waiting", "running", "done", "failed" or "ended early", and the
    newest numbers of its training."""

    name: str
    state: str
    numbers: Mapping[str, float]


Report = Callable[[Row], None]


def versions() -> dict[str, str]:
    """The versions that driver and workers must share."""
    return {"python": platform.python_version()} | {
        name: importlib.metadata.version(name) for name in SAME
    }


def swim(sweep: Sweep, todo: Sequence[Trial], out: Path, report: Report) -> dict[str, str]:
    """Swim the trials `todo` in `out/trials`; returns why each failed one did, by its name. Ray
    must be connected. Ctrl-C ends it; trials keep their checkpoints. Raises BadInput if a trial
    needs more of a GPU than there is, or if a cluster of which this machine is no node is lost, and
    RayEnded."""
    gpus = ray.cluster_resources().get("GPU", 0.0)
    if sweep.gpus > gpus:
        raise BadInput(
            f"field gpus = {sweep.gpus:g}: Ray found {gpus:g} GPUs; leave it out to train on"
            f" processors."
        )
    write_trials(sweep, todo, out)
    space = {
        "name": tune.grid_search([trial.name for trial in todo]),
        "out": str(out.resolve()),
        "cores": sweep.cores,
        "versions": versions(),
    }
    if not ray.util.client.ray.is_connected():
        return _swim(sweep, space, report)
    try:
        return _swim_from_outside(sweep, space, report)
    except (ConnectionError, ray.exceptions.RayError) as error:
        raise BadInput(
            f"the Ray cluster was lost ({type(error).__name__}); run the command again with"
            f" --resume."
        ) from None


def _swim_from_outside(sweep: Sweep, space: dict[str, Any], report: Report) -> dict[str, str]:
    """Let a worker of the cluster run Ray Tune, and repeat what it tells: from outside, Tune would
    call `report` in the cluster."""
    rows = Queue(actor_options={"num_cpus": 0})
    there = ray.remote(num_cpus=0, max_retries=0)(_swim)
    task = there.remote(sweep, space, rows.put)
    while not ray.wait([task], timeout=0)[0] or not rows.empty():
        with contextlib.suppress(Empty):
            report(rows.get(timeout=1.0))
    found: dict[str, str] = ray.get(task)
    return found


def _swim(sweep: Sweep, space: dict[str, Any], report: Report) -> dict[str, str]:
    """Run Ray Tune over a space of trials, which are on disk."""
    told = _Told(report)
    tuner = tune.Tuner(
        tune.with_resources(_work, {"cpu": sweep.cores, "gpu": sweep.gpus}),
        param_space=space,
        tune_config=tune.TuneConfig(
            scheduler=_scheduler(sweep.scheduler),
            # A worker takes seconds to start. One whose trial was ended early cannot be taken
            # again: Ray waits for the trial's function, and then fails the next one.
            reuse_actors=sweep.scheduler == "none",
        ),
        run_config=tune.RunConfig(
            name="ray",
            storage_path=str(Path(space["out"]) / ".tune"),
            failure_config=tune.FailureConfig(max_failures=sweep.retries),
            callbacks=[told],
            verbose=0,
        ),
    )
    try:
        tuner.fit()
    except _Lost as lost:
        raise connection.RayEnded(
            f"{lost}, a process of Ray on this machine, ended: look at the machine's free memory,"
            f" then run the command again with --resume; trials go on from their checkpoints."
        ) from None
    return told.failed


def write_trials(sweep: Sweep, todo: Sequence[Trial], out: Path) -> list[Path]:
    """Write what each trial is into its folder in `out/trials`; returns the folders."""
    folders = [out / "trials" / trial.name for trial in todo]
    for folder, trial in zip(folders, todo, strict=True):
        folder.mkdir(parents=True, exist_ok=True)
        held = {"trial": asdict(trial), "sweep": sweep.model_dump()}
        write_json(folder / TRIAL, held, overwrite=True)
    return folders


def _scheduler(name: str) -> Any:
    """Ends hopeless trials by `score` at equal updates; see `score`."""
    if name == "none":
        return FIFOScheduler()
    common: dict[str, Any] = {"time_attr": "updates", "metric": "score", "mode": "max"}
    if name == "median":
        return MedianStoppingRule(grace_period=PATIENCE, **common)
    return ASHAScheduler(grace_period=PATIENCE, max_t=LONGEST, reduction_factor=3, **common)


def score(row: Mapping[str, float]) -> float:
    """What a scheduler compares: stages passed plus the success rate in the present one. In the
    first stage the rate does not count: all trials are poor at its start."""
    passed = row["stage"] - 1
    return passed + (row["success"] if passed else 0.0)


def _work(config: dict[str, Any]) -> None:
    """A trial in a Ray worker: start its process, pass its rows on. Raises RuntimeError with what
    the process said if it fails."""
    folder = Path(config["out"]) / "trials" / config["name"]
    own = versions()
    differ = [f"{k} {own[k]}, not {v}" for k, v in config["versions"].items() if own[k] != v]
    if differ:
        raise RuntimeError(f"{platform.node()} has {'; '.join(differ)}: install the same versions.")
    threads = dict.fromkeys(ALONE, str(config["cores"]))
    with open(folder / "log.txt", "a", encoding="utf-8") as log:
        child = start(
            ["-m", "tailbeat.cluster.trial", str(folder)],
            stdout=subprocess.PIPE,
            stderr=log,
            text=True,
            env={**os.environ, **threads},
            preexec_fn=end_with_parent,
        )
    try:
        for line in child.stdout or ():
            row = json.loads(line)
            tune.report({**row, "score": score(row)})
        code = child.wait()
    finally:
        end(child, signal.SIGTERM)
    if code:
        raise RuntimeError(_last_line(folder / "log.txt", code))


def _last_line(log: Path, code: int) -> str:
    lines = log.read_text(encoding="utf-8", errors="replace").split("\n")
    said = next((line.strip() for line in reversed(lines) if line.strip()), "")
    return said or f"its process ended with {code}"


class _Lost(BaseException):
    """The name of a process of Ray that ended. No Exception: Tune would wait for its workers."""


class _Told(tune.Callback):
    """Tells `report` of every trial that begins, learns, fails or ends. Raises _Lost once a process
    of the Ray that was started here has ended: Tune would wait for its workers for ever."""

    def __init__(self, report: Report) -> None:
        self.report, self.failed = report, dict[str, str]()

    def __getstate__(self) -> dict[str, Any]:
        """Nothing: Tune keeps a copy to restore itself from, which we do not use."""
        return {}

    def on_step_begin(self, iteration: int, trials: Any, **_: Any) -> None:
        ended = connection.ended()
        if ended is not None:
            raise _Lost(ended)

    def on_trial_start(self, iteration: int, trials: Any, trial: Any, **_: Any) -> None:
        self.report(Row(trial.config["name"], "running", {}))

    def on_trial_result(
        self, iteration: int, trials: Any, trial: Any, result: dict[str, Any], **_: Any
    ) -> None:
        names = ("stage", "success", "updates")
        numbers = {name: result[name] for name in names if name in result}
        self.report(Row(trial.config["name"], "running", numbers))

    def on_trial_complete(self, iteration: int, trials: Any, trial: Any, **_: Any) -> None:
        name = trial.config["name"]
        done = (Path(trial.config["out"]) / "trials" / name / RESULT).is_file()
        self.report(Row(name, "done" if done else "ended early", {}))

    def on_trial_error(self, iteration: int, trials: Any, trial: Any, **_: Any) -> None:
        name = trial.config["name"]
        self.failed[name] = _reason(trial)
        self.report(Row(name, "failed", {}))


def _reason(trial: Any) -> str:
    """Why a trial failed: the last line of its newest error, without the name of its class."""
    text = str(trial.get_error() or "its worker ended")
    if "ActorDiedError" in text or "ActorUnavailableError" in text:
        return "its worker was killed, or its node was lost"
    lines = [line.strip() for line in text.split("\n") if line.strip()]
    return lines[-1].removeprefix("RuntimeError: ")
