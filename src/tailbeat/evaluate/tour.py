"""A tour: a policy swims to one target after the other in the virtual pool."""

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from tailbeat.control.actions import PERIOD
from tailbeat.control.measure import PATIENCE
from tailbeat.control.policy import Policy, decide
from tailbeat.env import errors
from tailbeat.env.task import Task, settings_for, sized
from tailbeat.evaluate.labs import world_in_labs
from tailbeat.evaluate.trial import Pool, Progress
from tailbeat.operator.tour import TargetResult
from tailbeat.pool.mess import AS_DESCRIBED, Lab

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Tour:
    """A swim past `targets` (m, 2) [m].

    `shape` (k, nv) and `pose` (k, 3) at the control steps, the index `goal` of the target at each
    (k,); per target whether it was `reached`, the `seconds` it took, and the closest approach
    `nearest` [m].
    """

    targets: Array
    shape: Array
    pose: Array
    goal: NDArray[np.int64]
    reached: NDArray[np.bool_]
    seconds: Array
    nearest: Array

    def results(self) -> tuple[TargetResult, ...]:
        """Result of each target."""
        columns = (self.targets, self.reached, self.nearest, self.seconds)
        ends = zip(*(column.tolist() for column in columns), strict=True)
        return tuple(
            TargetResult(number, x, y, reached, nearest, seconds)
            for number, ((x, y), reached, nearest, seconds) in enumerate(ends, 1)
        )


def tour(
    policy: Policy,
    pool: Pool,
    targets: Array,
    seed: int,
    progress: Progress,
    lab: Lab = AS_DESCRIBED,
) -> Tour:
    """Swim to each target until it is reached or its time is over, in a pool's first water and in a
    lab; start in the pool's middle."""
    m = policy.contract.measure
    task = sized(Task(seconds=PATIENCE * len(targets)), m)
    held = policy.contract
    settings = replace(settings_for(held), task=task)
    world = world_in_labs(pool.fish, settings, [(lab, pool.waters[0])], [seed], pool.walls)
    choose = partial(decide, policy)
    shape, pose, goal, ends = [], [], [], []
    world.reset()
    world.seen.frames[..., 3:5] = errors.seen(world.wrong, targets[:1])
    seen = world.reset(np.zeros(1, bool))
    for number, place in enumerate(targets):
        world.target[0], nearest = place, np.inf
        for _ in range(round(m.patience / PERIOD)):
            done = world.step(np.asarray(choose(seen), dtype=np.float64))
            seen = done.observation
            shape.append(world.simulator.qpos[0].copy())
            pose.append(world.pose[0].copy())
            goal.append(number)
            nearest = min(nearest, float(np.hypot(*(place - world.pose[0, :2]))))
            if done.reached[0]:
                break
        progress("targets", number + 1, len(targets))
        ends.append((bool(done.reached[0]), PERIOD * goal.count(number), nearest))
    reached, seconds, closest = map(np.array, zip(*ends, strict=True))
    return Tour(targets, np.array(shape), np.array(pose), np.array(goal), reached, seconds, closest)
