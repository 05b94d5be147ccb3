"""Where a fish starts that is to follow a target by the clock."""

import numpy as np
from numpy.typing import NDArray

from tailbeat.control.measure import LENGTH, Measure
from tailbeat.evaluate.motion import root
from tailbeat.evaluate.scenes import BEHIND
from tailbeat.evaluate.trial import Pool
from tailbeat.files import BadInput
from tailbeat.link.places import POOL
from tailbeat.operator.target_path import TargetPath

Array = NDArray[np.float64]
TEST_SWIM = 0.6  # m that the paper's fish moves before the swim, in the sign test and coasting
CLEAR = 0.1  # m of the paper's fish: a turned start is so far from the walls (chosen)
TURNS = np.radians([0, *(side * turn for turn in range(5, 181, 5) for side in (1, -1))]).tolist()


def behind(
    path: TargetPath, measure: Measure, pool: tuple[float, float] = POOL
) -> tuple[float, float, float]:
    """Where the tag starts: x, y [m] and yaw [rad], behind the path's first place and looking at
    it.

    The sign test before the swim brings the fish nearer. Its tail stays inside the pool: where
    there is no room on the tangent, the start is turned about the first place, as little as can be.
    Raises BadInput for a fish that is too long.
    """
    place, tail = path.places[0], LENGTH * measure.size  # m behind the tag, at most
    inside = np.array(pool) - 2 * CLEAR * measure.size  # a turned tail beats along a wall
    rooms = {
        turn: _room(place, path.heading + turn, inside if turn else np.array(pool)) - tail
        for turn in TURNS
    }
    enough = [turn for turn, room in rooms.items() if room >= TEST_SWIM * measure.size]
    turn = enough[0] if enough else max(rooms, key=lambda one: rooms[one])
    if rooms[turn] < 0:
        raise BadInput(
            f"--path {path.name}: a fish of {tail:.2g} m has no room behind the path's first point"
            f" in a pool of {pool[0]:g} x {pool[1]:g} m; let the path begin elsewhere."
        )
    yaw = path.heading + turn
    away = min(BEHIND * measure.reach + TEST_SWIM * measure.size, rooms[turn])
    x, y = (place - away * np.array([np.cos(yaw), np.sin(yaw)])).tolist()
    return x, y, yaw


def tested(path: TargetPath, pool: Pool) -> Array:
    """Start of the fish frame (1, 3) of a swim without a sign test: where the test would leave the
    fish, but at rest."""
    x, y, yaw = behind(path, pool.measure, pool.walls)
    moved = TEST_SWIM * pool.measure.size
    return root(pool.fish, np.array([[x + moved * np.cos(yaw), y + moved * np.sin(yaw), yaw]]))


def _room(place: Array, yaw: float, pool: Array) -> float:
    """Distance from a place to the wall behind a fish with this yaw [m]."""
    ahead = np.array([np.cos(yaw), np.sin(yaw)])
    back = np.abs(ahead) > 1e-9
    walls = -np.sign(ahead) * pool / 2
    return float(np.min((place - walls)[back] / ahead[back]))
