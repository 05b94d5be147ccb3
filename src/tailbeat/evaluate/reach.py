"""How many targets a policy reaches, and where: in its twin, or zero-shot in pools."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import cycle, islice
from typing import Any

import numpy as np

from tailbeat.control.policy import Policy, decide
from tailbeat.env.assess import Build, Swims, assess
from tailbeat.env.task import Settings
from tailbeat.env.world import World
from tailbeat.evaluate.rates import Flags, SuccessRates, success
from tailbeat.evaluate.runs import Runs
from tailbeat.evaluate.scenes import CLEAR, grid, walled
from tailbeat.evaluate.trial import Condition, Pool
from tailbeat.files import BadInput
from tailbeat.fish.description import Fish
from tailbeat.pool.plant import Surroundings
from tailbeat.pool.simulator import PoolSimulator
from tailbeat.pool.water import Water

OPEN = "reach open"  # the condition without walls
SECTOR = 30  # degrees of bearing, left and right together
NEAREST, TRAINED, FARTHEST = 0.5, 2.5, 3.0  # m, of the paper's fish; trained to the second


@dataclass(frozen=True, kw_only=True)
class Group(SuccessRates):
    """The targets of one sector of bearing [deg], of one interval of distance [m], or of one water
    (`low` and `high` are its index). Half and nine in ten of all targets were reached within
    `median_s` and `p90_s` [s]; a miss counts as infinite, and None means that too few were
    reached."""

    low: float
    high: float
    targets: int
    median_s: float | None
    p90_s: float | None


@dataclass(frozen=True, kw_only=True)
class Cell(SuccessRates):
    """The targets of one interval of `bearing` [deg], both sides together, and one of `distance`
    [m], each (from, to)."""

    bearing: tuple[float, float]
    distance: tuple[float, float]
    targets: int


@dataclass(frozen=True, kw_only=True)
class SeededTrial(SuccessRates):
    """Swims to seeded targets: fraction `reached`; over those the median time [s] and the median
    path length over the distance, NaN if none was reached. All were reached within
    `slowest_seconds`; None means that one was missed."""

    targets: int
    reached: float
    median_seconds: float
    median_path_ratio: float
    slowest_seconds: float | None
    sectors: tuple[Group, ...]


@dataclass(frozen=True, kw_only=True)
class ReachResult(SuccessRates):
    """Swims of one condition: in all, within the paper's trained range (+-120 deg, to 2.5 m), by
    bearing, range and water, and by bearing and range at once (`cells`). Median time [s] and median
    path length over the distance are those of the swims that arrived; `lost` counts swims that
    ended out of range."""

    swims: int
    trained_range: SuccessRates | None
    median_seconds: float | None
    median_path_ratio: float | None
    lost: int
    sectors: tuple[Group, ...]
    ranges: tuple[Group, ...]
    waters: tuple[Group, ...]
    cells: tuple[Cell, ...]


def in_twin(fish: Fish, settings: Settings) -> Build:
    """A function that builds worlds of the fish's own twin from seeds."""
    return lambda seeds: World(fish, settings, seeds)


def in_pool(fish: Fish, settings: Settings, waters: Sequence[Water]) -> Build:
    """A function that builds worlds of the plant from seeds, with the waters in turn. Sensors and
    targets are those of `settings`; its physics ranges are not used."""
    return lambda seeds: World(
        fish, settings, seeds, simulator=PoolSimulator(fish, [*islice(cycle(waters), len(seeds))])
    )


def reach(policy: Policy, build: Build, count: int, seed: int) -> SeededTrial:
    """Swim a policy to `count` targets in worlds built from `seed`. Raises BadInput for worlds in
    another measure than the policy's."""
    swims = assess(partial(decide, policy), partial(_fitting, policy, build), count, seed)
    return seeded(policy, swims)


def seeded(policy: Policy, swims: Swims) -> SeededTrial:
    """The numbers of swims to seeded targets."""
    near = swims.nearest < policy.contract.measure.near
    sectors = by_sector(swims.bearing, swims.reached, near, swims.seconds)
    return SeededTrial(
        **vars(swims.summary()),
        **vars(success(swims.reached, near)),
        slowest_seconds=_time(np.where(swims.reached, swims.seconds, np.inf), 1.0),
        sectors=sectors,
    )


def _fitting(policy: Policy, build: Build, seeds: list[int]) -> World:
    """A world in the policy's measure."""
    world = build(seeds)
    own, wanted = world.settings.measure, policy.contract.measure
    if own != wanted:
        raise BadInput(
            f"settings: their measure is {own}, the policy's is {wanted}, so it would see other"
            f" distances; take settings_for(policy.contract)."
        )
    return world


# ---- the trial ----------------------------------------------------------------------------------


def conditions(pool: Pool) -> list[Condition]:
    """The conditions: bearings +-180 deg, 0.5-3 m, in open water, inside the paper's walls, in the
    twin, and in the twin over its posterior if it has one."""
    around = (Surroundings(walls=pool.walls),)
    near, far = NEAREST * pool.measure.reach, FARTHEST * pool.measure.reach
    scene = grid(pool.fish, pool.count, pool.seed, near, far, np.pi)
    clear = CLEAR * pool.measure.reach
    inside = walled(pool.fish, pool.count, pool.seed, (near, far), pool.walls, clear)
    found = [
        pool.condition(OPEN, scene),
        pool.condition("reach walled", inside, around=around),
        pool.in_twin("reach twin", scene),
    ]
    if pool.draws is not None:
        found.append(pool.in_twin("reach posterior", scene, pool.draws))
    return found


def numbers(runs: Runs) -> ReachResult:
    """Results of the swims of one condition."""
    hits = runs.reached
    start = runs.distance[:, 0]
    trained = (np.abs(runs.bearing) <= np.radians(120)) & (start <= TRAINED * runs.reach)
    step = np.hypot(*np.moveaxis(np.diff(runs.pose[..., :2], axis=1), 2, 0))
    ratio = np.nansum(step, axis=1)[hits] / start[hits]
    return ReachResult(
        swims=runs.count,
        **vars(success(hits, runs.near)),
        trained_range=success(hits[trained], runs.near[trained]) if trained.any() else None,
        median_seconds=float(np.median(runs.seconds[hits])) if hits.any() else None,
        median_path_ratio=float(np.median(ratio)) if hits.any() else None,
        lost=int(runs.lost.sum()),
        sectors=by_sector(runs.bearing, hits, runs.near, runs.seconds),
        ranges=by_range(runs, start),
        waters=by_water(runs),
        cells=by_cell(runs, start),
    )


def by_sector(bearing: Any, reached: Flags, near: Flags, seconds: Any) -> tuple[Group, ...]:
    """Success rates and times by bearing of the target at the start, left and right together."""
    groups = [(*edges, inside) for edges, inside in _sectors(bearing)]
    return _groups(groups, reached, near, seconds)


def by_range(runs: Runs, start: Any) -> tuple[Group, ...]:
    """Success rates and times by distance of the target at the start [m], by half metres of the
    paper's fish."""
    groups = [(*edges, inside) for edges, inside in _ranges(runs, start)]
    return _groups(groups, runs.reached, runs.near, runs.seconds)


def by_cell(runs: Runs, start: Any) -> tuple[Cell, ...]:
    """Success rates by bearing [rad] and distance [m] of the target at the start; a cell without
    targets is left out."""
    return tuple(
        Cell(
            bearing=sector,
            distance=span,
            targets=int((there & far).sum()),
            **vars(success(runs.reached[there & far], runs.near[there & far])),
        )
        for sector, there in _sectors(runs.bearing)
        for span, far in _ranges(runs, start)
        if (there & far).any()
    )


def _sectors(bearing: Any) -> list[tuple[tuple[float, float], Flags]]:
    """Edges [deg] of each sector, and which targets lie in it."""
    away = np.abs((np.degrees(bearing) + 180) % 360 - 180)
    edges = [(low, low + SECTOR) for low in range(0, 180, SECTOR)]
    return [((a, b), (away >= a) & (away < b + (b == 180))) for a, b in edges]


def _ranges(runs: Runs, start: Any) -> list[tuple[tuple[float, float], Flags]]:
    """Edges [m] of each half metre of the paper's fish, and which targets lie in it."""
    reach = float(runs.reach[0])
    edges = np.arange(NEAREST, FARTHEST + 0.5, 0.5) * reach
    pairs = zip(edges.tolist(), edges[1:].tolist(), strict=False)
    return [((a, b), (start >= a - 1e-6) & (start < b)) for a, b in pairs]


def by_water(runs: Runs) -> tuple[Group, ...]:
    """Success rates and times by water; empty if there is only one."""
    groups = [(number, number, runs.water == number) for number in np.unique(runs.water).tolist()]
    return _groups(groups, runs.reached, runs.near, runs.seconds) if len(groups) > 1 else ()


def _groups(
    groups: Iterable[tuple[float, float, Flags]], reached: Flags, near: Flags, seconds: Any
) -> tuple[Group, ...]:
    taken = np.where(reached, seconds, np.inf)
    return tuple(
        Group(
            low=low,
            high=high,
            targets=int(inside.sum()),
            **vars(success(reached[inside], near[inside])),
            median_s=_time(taken[inside], 0.5),
            p90_s=_time(taken[inside], 0.9),
        )
        for low, high, inside in groups
        if inside.any()
    )


def _time(taken: Any, fraction: float) -> float | None:
    found = float(np.quantile(taken, fraction, method="higher"))
    return found if np.isfinite(found) else None
