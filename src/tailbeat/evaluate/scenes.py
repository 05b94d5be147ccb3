"""Starts and targets of trials: sampled grids and closed paths, from a seed."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from tailbeat.control.actions import PERIOD
from tailbeat.control.measure import PAPER, Measure
from tailbeat.env.task import Scene
from tailbeat.files import BadInput
from tailbeat.fish.description import Fish
from tailbeat.identify.tag_pose import tracked_pose
from tailbeat.operator.paths import Shape, even

Array = NDArray[np.float64]
CLEAR = 0.4  # m, least distance of a start from the walls, of the paper's fish; targets: half
TRIES = 2000
BEHIND = 0.5  # m, distance of a fish's start behind a moving target


def grid(fish: Fish, count: int, seed: int, near: float, far: float, arc: float) -> Scene:
    """Targets that stay, over bearings within `arc` [rad] to either side and distances `near` to
    `far` [m] from the tag, one in every stratum of both (Latin hypercube). Fish at rest, with
    random headings."""
    draw = qmc.LatinHypercube(2, rng=np.random.default_rng(seed)).random(count)
    heading = np.random.default_rng([seed, 1]).uniform(-np.pi, np.pi, count)
    start = np.column_stack([np.zeros((count, 2)), heading])
    bearing, distance = arc * (2 * draw[:, 0] - 1), near + (far - near) * draw[:, 1]
    return still(start, aim(fish, start, bearing, distance))


def aim(fish: Fish, start: Array, bearing: Array, distance: Array) -> Array:
    """Positions (n, 2) by bearing and distance from the tags of fish that start at (n, 3)."""
    tag = tracked_pose(fish, start)
    angle = tag[:, 2] + bearing
    return np.asarray(
        tag[:, :2] + distance[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    )


def still(start: Array, target: Array, velocity: Array | None = None) -> Scene:
    """Fish at (n, 3) with targets (n, 2) that stay."""
    moved = np.zeros_like(start) if velocity is None else velocity
    return Scene(start, moved, target[:, None], np.full(len(start), np.inf))


def walled(
    fish: Fish,
    count: int,
    seed: int,
    span: tuple[float, float],
    walls: tuple[float, float],
    clear: float = CLEAR,
) -> Scene:
    """Starts anywhere inside walls (length, width) [m], `clear` [m] of them, and targets `span`
    (from, to) [m] away, also inside. Raises BadInput if none is found."""
    rng, half, (near, far) = np.random.default_rng(seed), np.array(walls) / 2, span
    starts, targets = np.empty((count, 3)), np.empty((count, 2))
    for i in range(count):
        for _ in range(TRIES):
            start = np.array([*rng.uniform(-1, 1, 2) * (half - clear), rng.uniform(-np.pi, np.pi)])
            bearing, distance = rng.uniform(-np.pi, np.pi, 1), rng.uniform(near, far, 1)
            place = aim(fish, start[None], bearing, distance)[0]
            if (half > clear).all() and (np.abs(place) < half - clear / 2).all():
                break
        else:
            raise BadInput(
                f"walls of {walls[0]:g} x {walls[1]:g} m: no free target {near:g} to {far:g} m"
                f" away in {TRIES} draws; use a larger pool or nearer targets."
            )
        starts[i], targets[i] = start, place
    return still(starts, targets)


def moving(scene: Scene, speed: float, seconds: float, seed: int) -> Scene:
    """The same fish; their targets move in straight lines of random direction at `speed` [m/s]."""
    rng = np.random.default_rng([seed, 2])
    angle = rng.uniform(-np.pi, np.pi, len(scene.start))
    way = speed * PERIOD * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    steps = np.arange(round(seconds / PERIOD) + 1)
    ways = scene.target[:, :1] + steps[None, :, None] * way[:, None]
    return replace(scene, target=ways)


# ---- closed paths -------------------------------------------------------------------------------


def stays(phase: Array) -> Array:
    """One place, as a path."""
    return np.zeros((len(phase), 2))


def follow(
    fish: Fish,
    path: Shape,
    lap: float,
    seconds: float,
    count: int,
    lead: float = np.inf,
    measure: Measure = PAPER,
) -> Scene:
    """Targets that go round a path in `lap` [s], or longer if they wait for a fish that is more
    than `lead` [m] away. Fish start behind them, on the tangent. All of it is given for the paper's
    fish, and taken in the `measure` of the fish."""
    steps = round(seconds * measure.time / PERIOD) + 1
    per_lap = round(lap * measure.time / PERIOD)
    way = measure.reach * even(path, per_lap)[np.arange(steps) % per_lap]
    ahead = way[1] - way[0]
    ahead = ahead if ahead.any() else np.array([1.0, 0.0])  # a target that stays has no direction
    heading = np.arctan2(ahead[1], ahead[0])
    offset = tracked_pose(fish, np.zeros(3))[0] + BEHIND * measure.reach
    start = np.array([*(way[0] - offset * ahead / np.hypot(*ahead)), heading])
    starts, ways = np.tile(start, (count, 1)), np.tile(way, (count, 1, 1))
    return Scene(starts, np.zeros((count, 3)), ways, np.full(count, lead * measure.reach))
