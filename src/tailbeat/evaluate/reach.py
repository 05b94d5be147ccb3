"""How many targets does a policy reach, and where: in its twin, or zero-shot in pools."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.control.actions import PERIOD
from tailbeat.control.policy import Policy, check_fits, decide, load_policy
from tailbeat.env.assess import Build, assess
from tailbeat.env.curriculum import Stage, settings_of
from tailbeat.env.task import Settings
from tailbeat.env.world import World
from tailbeat.evaluate.runs import NEAR, Runs
from tailbeat.evaluate.scenes import grid, walled
from tailbeat.evaluate.trial import Arm, Pool
from tailbeat.files import BadInput
from tailbeat.fish.description import Fish
from tailbeat.fish.store import digest, load_fish
from tailbeat.pool.plant import Surroundings
from tailbeat.pool.simulator import PoolSimulator
from tailbeat.pool.water import Water, ensemble

Z95 = 1.96
SECTOR = 30  # degrees of bearing, both sides together
NEAREST, FARTHEST = 0.5, 3.0  # m
Flags = NDArray[np.bool_]


def in_twin(fish: Fish, settings: Settings) -> Build:
    """Worlds of the fish's own twin."""
    return lambda seeds: World(fish, settings, seeds)


def in_pool(fish: Fish, settings: Settings, waters: Sequence[Water]) -> Build:
    """Worlds of the plant, the waters one after the other; sensors and targets as `settings`
    say, its physics ranges unused: what varies is the water."""

    def build(seeds: list[int]) -> World:
        each = [waters[i % len(waters)] for i in range(len(seeds))]
        return World(fish, settings, seeds, simulator=PoolSimulator(fish, each))

    return build


def reach(policy: Policy, build: Build, count: int, seed: int) -> dict[str, Any]:
    """Shares within 5 and 20 cm with 95 % Wilson intervals, in all and by sector of bearing."""
    swims = assess(partial(decide, policy), build, count, seed)
    sectors = by_sector(swims.bearing, swims.reached, swims.nearest, swims.seconds)
    return {**swims.summary(), **shares(swims.reached, swims.nearest), "sectors": sectors}


def try_policy(
    path: str, fish: str, arc: float, count: int, seed: int, exact: bool, pools: int
) -> dict[str, Any]:
    """Swim a policy to seeded targets: in the twin with all noise and randomisation (`exact`:
    undisturbed), or in `pools` waters of the virtual pool's ensemble."""
    if not 0 < arc <= 180 or count < 1 or pools < 0:
        raise BadInput(
            f"--arc {arc:g}, --targets {count}, --pools {pools}: allowed are 0 to 180, 1 and more,"
            f" 0 and more."
        )
    policy, described = load_policy(path), load_fish(fish)
    held = policy.contract
    who = (held.fish, held.fish_digest) if pools else (described.name, digest(described))
    check_fits(held, *who, described.band, PERIOD)
    share = 0.0 if exact else 1.0
    stage = Stage("trial", 3, share, share, float(np.radians(arc)))
    settings = settings_of(stage, held.actions)
    waters = ensemble(pools, seed) if pools else []
    build = in_pool(described, settings, waters) if pools else in_twin(described, settings)
    return {"policy": path, "arc_deg": arc, "pools": pools, **reach(policy, build, count, seed)}


# ---- the trial ----------------------------------------------------------------------------------


def arms(pool: Pool) -> list[Arm]:
    """Bearings +-180 deg, 0.5-3 m: open water, inside the paper's walls, and the twin."""
    around = (Surroundings(walls=pool.walls),)
    scene = grid(pool.fish, pool.count, pool.seed, NEAREST, FARTHEST, np.pi)
    inside = walled(pool.fish, pool.count, pool.seed, NEAREST, FARTHEST, pool.walls)
    return [
        pool.arm("reach open", scene),
        pool.arm("reach walled", inside, around=around),
        pool.in_twin("reach twin", scene),
    ]


def numbers(runs: Runs) -> dict[str, Any]:
    """Shares in all, within the paper's trained range (+-120 deg, to 2.5 m), by bearing, range and
    water; times and ways of those that arrived."""
    hits = runs.reached
    start = runs.distance[:, 0]
    trained = (np.abs(runs.bearing) <= np.radians(120)) & (start <= 2.5)
    step = np.hypot(*np.moveaxis(np.diff(runs.pose[..., :2], axis=1), 2, 0))
    ratio = np.nansum(step, axis=1)[hits] / start[hits]
    return {
        "swims": runs.count,
        **shares(hits, runs.nearest),
        "trained range": shares(hits[trained], runs.nearest[trained]) if trained.any() else None,
        "median_seconds": float(np.median(runs.seconds[hits])) if hits.any() else None,
        "median_path_ratio": float(np.median(ratio)) if hits.any() else None,
        "lost": int(runs.lost.sum()),
        "sectors": by_sector(runs.bearing, hits, runs.nearest, runs.seconds),
        "ranges": by_range(start, hits, runs.nearest, runs.seconds),
        "waters": by_water(runs),
    }


def by_sector(bearing: Any, reached: Flags, nearest: Any, seconds: Any) -> list[dict[str, Any]]:
    """Shares and times by bearing of the target at the start, both sides together."""
    away = np.abs((np.degrees(bearing) + 180) % 360 - 180)
    edges = [(low, low + SECTOR) for low in range(0, 180, SECTOR)]
    rows = [(f"{a}-{b}", (away >= a) & (away < b + (b == 180))) for a, b in edges]
    return _rows("bearing [deg]", rows, reached, nearest, seconds)


def by_range(start: Any, reached: Flags, nearest: Any, seconds: Any) -> list[dict[str, Any]]:
    """Shares and times by distance of the target at the start, by half metres."""
    edges = np.arange(NEAREST, FARTHEST, 0.5)
    rows = [(f"{a:g}-{a + 0.5:g}", (start >= a - 1e-6) & (start < a + 0.5)) for a in edges]
    return _rows("range [m]", rows, reached, nearest, seconds)


def by_water(runs: Runs) -> list[dict[str, Any]]:
    """Shares by which of the waters."""
    rows = [(str(number), runs.water == number) for number in np.unique(runs.water)]
    return _rows("water", rows, runs.reached, runs.nearest, runs.seconds) if len(rows) > 1 else []


def _rows(
    name: str, groups: Any, reached: Flags, nearest: Any, seconds: Any
) -> list[dict[str, Any]]:
    taken = np.where(reached, seconds, np.inf)
    return [
        {
            name: label,
            "targets": int(inside.sum()),
            **shares(reached[inside], nearest[inside]),
            **times(taken[inside]),
        }
        for label, inside in groups
        if inside.any()
    ]


def times(taken: Any) -> dict[str, float | None]:
    """Time [s] within which half and nine in ten of all arrive, a miss taking for ever: None if
    so many do not. It tells a fish that turns from one that first swims away."""
    found = {
        name: float(np.quantile(taken, share, method="higher"))
        for name, share in (("median_s", 0.5), ("p90_s", 0.9))
    }
    return {name: value if np.isfinite(value) else None for name, value in found.items()}


def shares(reached: Flags, nearest: Any) -> dict[str, Any]:
    """Shares within 5 and 20 cm with their 95 % intervals."""
    near = nearest < NEAR
    return {
        "within_5cm": float(reached.mean()),
        "interval_5cm": wilson(int(reached.sum()), reached.size),
        "within_20cm": float(near.mean()),
        "interval_20cm": wilson(int(near.sum()), near.size),
    }


def paired(first: Flags, second: Flags) -> dict[str, Any]:
    """Difference of two shares over the same targets, second less first, with its 95 % interval
    (normal, from the pairs that differ)."""
    n, gained = first.size, int((second & ~first).sum())
    gone = int((first & ~second).sum())
    gap = (gained - gone) / n
    half = Z95 * np.sqrt(max(gained + gone - n * gap**2, 0.0)) / n
    return {"difference": gap, "interval": [gap - float(half), gap + float(half)]}


def wilson(hits: int, count: int) -> list[float]:
    """95 % interval of a share, Wilson's (1927)."""
    share, square = hits / count, Z95**2
    middle = (share + square / (2 * count)) / (1 + square / count)
    half = np.sqrt(share * (1 - share) / count + square / (4 * count**2)) * Z95
    half /= 1 + square / count
    return [float(max(middle - half, 0.0)), float(min(middle + half, 1.0))]
