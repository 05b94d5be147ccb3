"""A policy's greedy swims to seeded targets in the twin: success rate, times and path lengths."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tailbeat.control.actions import PERIOD
from tailbeat.control.observation import bearing
from tailbeat.env.world import World, seeds_from

Array = NDArray[np.float64]
Decide = Callable[[NDArray[np.float32]], NDArray[np.float32]]
Build = Callable[[list[int]], World]
Settled = Callable[[NDArray[np.bool_], NDArray[np.bool_]], bool]
AT_ONCE = 250  # fish in one batch


@dataclass(frozen=True)
class Summary:
    """Summary of swims: number of targets, fraction reached, and over the arrivals the median time
    [s] and the median path length over the distance at the start. The medians are NaN if none
    arrived."""

    targets: int
    reached: float
    median_seconds: float
    median_path_ratio: float


@dataclass(frozen=True, eq=False)
class Swims:
    """Results of n swims (n,).

    `reached`; time to the end `seconds` [s]; path length `way` [m]; `distance` to the target at the
    start [m]; `bearing` of the target at the start [rad]; closest approach `nearest` [m]; mean
    distance `apart` [m]. `seen` (k, 24) are observations of the first four.
    """

    reached: NDArray[np.bool_]
    seconds: Array
    way: Array
    distance: Array
    bearing: Array
    nearest: Array
    apart: Array
    seen: NDArray[np.float32]

    def lateness(self, longest: float) -> Array:
        """Time to each target (n,) [s]; a miss counts as the `longest`."""
        return np.where(self.reached, self.seconds, longest)

    def summary(self) -> Summary:
        """Summarise all swims."""
        hits = self.reached
        ratio = self.way[hits] / self.distance[hits]
        return Summary(
            targets=int(hits.size),
            reached=float(hits.mean()),
            median_seconds=float(np.median(self.seconds[hits])) if hits.any() else float("nan"),
            median_path_ratio=float(np.median(ratio)) if hits.any() else float("nan"),
        )


def never(reached: NDArray[np.bool_], going: NDArray[np.bool_]) -> bool:
    """Every swim is swum to its end."""
    return False


def assess(decide: Decide, build: Build, count: int, seed: int, settled: Settled = never) -> Swims:
    """Swim to `count` targets, each fish once, in worlds that `build` makes from seeds. The same
    `seed` draws the same targets, noise and physics. Ends early once a batch is `settled` by which
    fish have `reached` and which are still `going`; those then count as not arrived."""
    seeds = seeds_from(seed, count)
    parts = [
        _together(decide, build(seeds[first : first + AT_ONCE]), settled)
        for first in range(0, count, AT_ONCE)
    ]
    return joined(parts)


def joined(parts: Sequence[Swims]) -> Swims:
    """Swims of several batches as one; the observations seen are the first batch's."""
    names = [name for name in Swims.__annotations__ if name != "seen"]
    whole = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    return Swims(**whole, seen=parts[0].seen)


def _together(decide: Decide, world: World, settled: Settled) -> Swims:
    seen = world.reset()
    start, target = world.pose.copy(), world.target.copy()
    distance = np.hypot(*(target - start[:, :2]).T)
    going, reached = np.ones(world.count, bool), np.zeros(world.count, bool)
    way, nearest, steps = np.zeros(world.count), distance.copy(), np.zeros(world.count, int)
    total = np.zeros(world.count)
    shown: list[NDArray[np.float32]] = []
    while going.any() and not (shown and settled(reached, going)):  # one step at least
        before = world.pose[:, :2]
        shown.append(seen[:4][going[:4]])
        done = world.step(np.asarray(decide(seen), dtype=np.float64))
        way += going * np.hypot(*(world.pose[:, :2] - before).T)
        apart = np.hypot(*(world.target - world.pose[:, :2]).T)
        nearest = np.where(going, np.minimum(nearest, apart), nearest)
        total += going * apart
        steps += going
        reached |= going & done.reached
        over = going & (done.terminated | done.truncated)
        seen = done.observation
        if over.any():
            going &= ~over
            world.simulator.keep(going)
    return Swims(
        reached, PERIOD * steps, way, distance, bearing(start, target), nearest,
        total / steps, np.concatenate(shown),
    )  # fmt: skip
