"""A policy swims to targets in the virtual pool: in process, or live through emulated devices."""

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

from numpy import float64
from numpy.typing import NDArray

from tailbeat.control.policy import Policy, load_policy
from tailbeat.evaluate.evaluation import EvaluationConfig, pool_of
from tailbeat.evaluate.live_swim import as_seen, tour_of
from tailbeat.evaluate.store import read_record
from tailbeat.evaluate.tour import Tour, tour
from tailbeat.evaluate.trial import Pool, Progress
from tailbeat.files import BadInput
from tailbeat.operator.tour import TargetResult, draw_targets
from tailbeat.pool.mess import lab_at, level

if TYPE_CHECKING:
    from tailbeat.emulators.live import Chain

Say = Callable[[str], None]
Counting = Callable[[], AbstractContextManager[Progress]]  # shows a progress bar


@dataclass(frozen=True)
class SwimConfig:
    """A `policy` (name or file) swims as the pool's `fish` to `targets` targets, drawn from `seed`.
    `twin` names the fish that it was trained on, if that is not a shipped one. `mess`: what the lab
    gets wrong, a level of `pool.mess`; the lab is drawn from the seed."""

    policy: str
    fish: str = "pulley-fish"
    twin: str | None = None
    targets: int = 8
    seed: int = 0
    mess: str = "clean"


@dataclass(frozen=True)
class Toured:
    """The station's report of a tour: its targets, and how often the fish was armed again."""

    targets: tuple[TargetResult, ...]
    armed_anew: int


@dataclass(frozen=True, eq=False)
class Swum:
    """A tour swum by `policy` in `pool`, and its configuration; for a swim in real time also its
    log, and how often the fish was armed again."""

    tour: Tour
    policy: Policy
    pool: Pool
    asked: SwimConfig
    log: Path | None = None
    armed_anew: int | None = None


def direct(config: SwimConfig, counting: Counting) -> Swum:
    """Swim to targets in the pool's plant, in process and faster than real time. Raises
    BadInput."""
    loaded, where, drawn = _entered(config)
    with counting() as progress:
        lab = lab_at(config.mess, config.seed)
        swum = tour(loaded, where, drawn, config.seed, progress, lab)
    return Swum(swum, loaded, where, config)


def live(config: SwimConfig, out: Path, say: Say) -> Swum:
    """Swim in real time, through camera, network, servo and IMU; results are read from the fish's
    log."""
    from tailbeat.emulators.live import swim  # needs OpenCV

    loaded, where, drawn = _entered(config)
    log, seen = log_in(out), out / "tour.json"
    seen.unlink(missing_ok=True)
    swim(_chain(config, "127.0.0.1:0", out, where.walls), config.targets, say)
    toured = read_record(Toured, seen)
    arrival = where.measure.arrival
    swum = as_seen(tour_of(log, where.fish, drawn, arrival), toured.targets)
    return Swum(swum, loaded, where, config, log, toured.armed_anew)


def attended(config: SwimConfig, page: str, out: Path, say: Say) -> Path:
    """Swim in real time to the target that the operator drags on the page at `host:port`, until
    Ctrl-C; returns the log."""
    from tailbeat.emulators.live import swim  # needs OpenCV

    _, where, _ = _entered(config)
    log = log_in(out)
    swim(_chain(config, page, out, where.walls), 0, say)
    return log


def _chain(config: SwimConfig, page: str, out: Path, walls: tuple[float, float]) -> "Chain":
    from tailbeat.emulators.live import Chain  # needs OpenCV

    name, fish, seed = config.policy, config.fish, config.seed
    return Chain(name, fish, seed, page, out, mess=config.mess, pool=walls)


def log_in(out: Path) -> Path:
    """Make a folder for a swim; returns the path of its log. An existing log is renamed."""
    out.mkdir(parents=True, exist_ok=True)
    log = out / "swim.mcap"
    if log.exists():
        log.rename(out / f"swim-{datetime.now():%Y%m%d-%H%M%S}.mcap")
    return log


def _entered(config: SwimConfig) -> tuple[Policy, Pool, NDArray[float64]]:
    """Check the configuration; returns the policy, the pool and the targets. Raises BadInput."""
    if not 1 <= config.targets <= 100:
        raise BadInput(f"--targets {config.targets}: allowed are 1 to 100.")
    level(config.mess)
    loaded = load_policy(config.policy)
    given = EvaluationConfig(config.fish, config.twin, "full", episodes=2, seed=config.seed)
    where = pool_of(loaded, given)
    drawn = draw_targets(config.targets, config.seed, where.walls, where.measure)
    return loaded, where, drawn
