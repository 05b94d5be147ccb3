"""A policy swims to targets in the virtual pool: in process, or live through emulated devices."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from numpy import float64
from numpy.typing import NDArray

from tailbeat.control.policy import Policy, load_policy
from tailbeat.evaluate.evaluation import EvaluationConfig, pool_of
from tailbeat.evaluate.live_swim import as_seen, tour_of
from tailbeat.evaluate.store import read_json
from tailbeat.evaluate.tour import Tour, tour
from tailbeat.evaluate.trial import Pool, Progress
from tailbeat.files import BadInput
from tailbeat.operator.tour import draw_targets

Say = Callable[[str], None]
Counting = Callable[[], AbstractContextManager[Progress]]  # opens a bar and closes it


@dataclass(frozen=True, eq=False)
class Swum:
    """A tour that was swum by `policy` in `pool`, and what was `asked` for."""

    tour: Tour
    policy: Policy
    pool: Pool
    asked: dict[str, Any]


def direct(
    policy: str, fish: str, twin: str | None, targets: int, seed: int, counting: Counting
) -> Swum:
    """Swim to targets in the pool's plant, without bytes and faster than real time."""
    loaded, where, drawn = _entered(policy, fish, twin, targets, seed)
    with counting() as progress:
        swum = tour(loaded, where.fish, where.waters[0], drawn, seed, progress)
    return Swum(swum, loaded, where, {"policy": policy, "seed": seed})


def live(
    policy: str, fish: str, twin: str | None, targets: int, seed: int, out: Path, say: Say
) -> Swum:
    """The same in real time, through camera, network, servo and IMU; told from the fish's log."""
    from tailbeat.emulators.live import swim  # needs OpenCV

    loaded, where, drawn = _entered(policy, fish, twin, targets, seed)
    log, seen = _room(out), out / "tour.json"
    seen.unlink(missing_ok=True)
    swim(policy, fish, targets, seed, "127.0.0.1:0", out, say)
    toured = read_json(seen)
    swum = as_seen(tour_of(log, where.fish, drawn), toured["targets"])
    asked = {"policy": policy, "seed": seed, "log": str(log), "armed_anew": toured["armed_anew"]}
    return Swum(swum, loaded, where, asked)


def attended(
    policy: str, fish: str, twin: str | None, seed: int, console: str, out: Path, say: Say
) -> Path:
    """In real time after the target that the operator drags, until Ctrl-C; the log that is kept."""
    from tailbeat.emulators.live import swim  # needs OpenCV

    _entered(policy, fish, twin, 1, seed)
    log = _room(out)
    swim(policy, fish, 0, seed, console, out, say)
    return log


def _room(out: Path) -> Path:
    """Make a folder for a swim; the log that it will have. One that lies there is kept beside."""
    out.mkdir(parents=True, exist_ok=True)
    log = out / "swim.mcap"
    if log.exists():
        log.rename(out / f"swim-{datetime.now():%Y%m%d-%H%M%S}.mcap")
    return log


def _entered(
    policy: str, fish: str, twin: str | None, targets: int, seed: int
) -> tuple[Policy, Pool, NDArray[float64]]:
    """What was asked for, checked: the policy, where it swims, its targets."""
    if not 1 <= targets <= 100:
        raise BadInput(f"--targets {targets}: allowed are 1 to 100.")
    loaded = load_policy(policy)
    where = pool_of(loaded, EvaluationConfig(fish, twin, "full", episodes=2, seed=seed))
    return loaded, where, draw_targets(targets, seed)
