"""`policy try`: swim a policy to seeded targets, in its twin or zero-shot in pools."""

from dataclasses import dataclass, replace

import numpy as np

from tailbeat.control.actions import PERIOD
from tailbeat.control.camera_yaw import Source
from tailbeat.control.policy import check_fits, load_policy
from tailbeat.env.curriculum import OPEN_WATER, Stage, settings_of
from tailbeat.env.task import Task, as_seen
from tailbeat.evaluate.reach import SeededTrial, in_pool, in_twin, reach
from tailbeat.files import BadInput
from tailbeat.fish.store import digest, load_fish
from tailbeat.pool.water import ensemble
from tailbeat.robot.fits import check_same_body, check_swims, twin_of


@dataclass(frozen=True)
class TrialConfig:
    """`targets` targets at `least_arc` to `arc` [deg] to either side and `nearest` to `farthest`
    [m] away (None: the task's own), drawn from `seed`.

    They are in the twin with all noise and randomisation (`exact`: without), or in `pools` waters
    of the pool. With `newer` the twin is a newer identification of the fish that the policy was
    trained on. `yaw_rate` is the source of the yaw rate; None: the one of the training.
    """

    arc: float = 120.0
    targets: int = 1000
    seed: int = 0
    exact: bool = False
    pools: int = 0
    newer: bool = False
    yaw_rate: Source | None = None
    least_arc: float = 0.0
    nearest: float | None = None
    farthest: float | None = None


def try_policy(path: str, fish: str, config: TrialConfig) -> SeededTrial:
    """Swim a policy to seeded targets. Raises BadInput if it was not trained for this fish, or, for
    a newer identification, on another body, and for targets that cannot be drawn."""
    _check(config)
    policy, described = load_policy(path), load_fish(fish)
    held = policy.contract
    if config.newer:
        check_same_body(twin_of(policy, None), described)
    elif config.pools:
        check_swims(policy, None, described)
    else:
        check_fits(held, described.name, digest(described), described.band, PERIOD)
    noise = float(not config.exact)
    stage = Stage("trial", 3, noise, noise, float(np.radians(config.arc)))
    settings = as_seen(settings_of(stage, held.actions, OPEN_WATER, held.measure), held)
    task = _targets(config, settings.task)
    settings = replace(settings, task=task, yaw_rate=config.yaw_rate or held.yaw_rate)
    build = in_twin(described, settings)
    if config.pools:
        own = replace(settings, corrections=held.corrections)
        build = in_pool(described, own, ensemble(config.pools, config.seed))
    return reach(policy, build, config.targets, config.seed)


def _targets(config: TrialConfig, task: Task) -> Task:
    """Where the targets of a trial are. Raises BadInput."""
    nearest = task.nearest if config.nearest is None else config.nearest
    farthest = task.farthest if config.farthest is None else config.farthest
    if not task.arrival < nearest <= farthest <= task.limit:
        raise BadInput(
            f"--nearest {nearest:g}, --farthest {farthest:g}: allowed are above"
            f" {task.arrival:g} m, where a target is reached, up to {task.limit:g} m, where a fish"
            f" is lost, the nearest first."
        )
    least = float(np.radians(config.least_arc))
    return replace(task, least_arc=least, nearest=nearest, farthest=farthest)


def _check(config: TrialConfig) -> None:
    if config.newer and config.pools:
        raise BadInput("--newer: it is about the twin; omit --pools.")
    if not 0 < config.arc <= 180 or config.targets < 1 or config.pools < 0:
        raise BadInput(
            f"--arc {config.arc:g}, --targets {config.targets}, --pools {config.pools}: allowed are"
            f" above 0 to 180, 1 or more, 0 or more."
        )
    if not 0 <= config.least_arc <= config.arc:
        raise BadInput(f"--least-arc {config.least_arc:g}: allowed are 0 to --arc, {config.arc:g}.")
