"""How many targets does a policy reach, and where: in its twin, or zero-shot in pools."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.control.policy import Policy, decide
from tailbeat.fish.description import Fish
from tailbeat.learn.assess import Build, Swims, assess
from tailbeat.learn.world import Settings, World
from tailbeat.pool.body import PoolBody
from tailbeat.pool.water import Water

Array = NDArray[np.float64]
Z95 = 1.96
SECTOR = 30  # degrees of bearing, both sides together


def in_twin(fish: Fish, settings: Settings) -> Build:
    """Worlds of the fish's own twin."""
    return lambda seeds: World(fish, settings, seeds)


def in_pool(fish: Fish, settings: Settings, waters: Sequence[Water]) -> Build:
    """Worlds of the plant, the waters one after the other; sensors and targets as `settings`
    say, its physics ranges unused: what varies is the water."""

    def build(seeds: list[int]) -> World:
        each = [waters[i % len(waters)] for i in range(len(seeds))]
        return World(fish, settings, seeds, body=PoolBody(fish, each))

    return build


def reach(policy: Policy, build: Build, count: int, seed: int) -> dict[str, Any]:
    """Shares within 5 and 20 cm with 95 % Wilson intervals, in all and by sector of bearing."""
    swims = assess(partial(decide, policy), build, count, seed)
    return {**swims.summary(), **_shares(swims, np.ones(count, bool)), "sectors": by_sector(swims)}


def by_sector(swims: Swims) -> list[dict[str, Any]]:
    """The same by bearing of the target at the start."""
    away = np.abs((np.degrees(swims.bearing) + 180) % 360 - 180)
    found = []
    for low in range(0, 180, SECTOR):
        inside = (away >= low) & (away < low + SECTOR + (low + SECTOR == 180))
        if inside.any():
            row = {"bearing [deg]": f"{low}-{low + SECTOR}", "targets": int(inside.sum())}
            found.append({**row, **_shares(swims, inside)})
    return found


def _shares(swims: Swims, inside: NDArray[np.bool_]) -> dict[str, Any]:
    near = swims.nearest[inside] < 0.2
    hits = swims.reached[inside]
    return {
        "within_5cm": float(hits.mean()),
        "interval_5cm": wilson(int(hits.sum()), hits.size),
        "within_20cm": float(near.mean()),
        "interval_20cm": wilson(int(near.sum()), near.size),
    }


def wilson(hits: int, count: int) -> list[float]:
    """95 % interval of a share, Wilson's (1927)."""
    share, square = hits / count, Z95**2
    middle = (share + square / (2 * count)) / (1 + square / count)
    half = np.sqrt(share * (1 - share) / count + square / (4 * count**2)) * Z95
    half /= 1 + square / count
    return [float(max(middle - half, 0.0)), float(min(middle + half, 1.0))]
