"""Closed paths of a target, for the paper's fish: figure eight, circle, square."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Shape = Callable[[Array], Array]
HALF_EIGHT = (
    1.6,
    0.6,
)  # m, along and across the pool; not given in the paper, chosen to fit its pool
LAP = 73.0  # s, one lap of the paper's figure-eight
MARGIN = 0.4  # m between a path and the walls


def eight(phase: Array) -> Array:
    """Figure eight (k, 2) [m] for phases 0 to 1. It starts at the tip of a lobe (an offset of 1/4)
    and crosses itself at the origin."""
    angle = 2 * np.pi * (phase + 0.25)
    along, across = HALF_EIGHT
    return np.stack([along * np.sin(angle), across * np.sin(2 * angle)], axis=1)


def circle(phase: Array) -> Array:
    """A circle of 0.8 m radius."""
    angle = 2 * np.pi * phase
    return 0.8 * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def square(phase: Array) -> Array:
    """A square of 1.6 m with round corners (a superellipse of power 4)."""
    angle = 2 * np.pi * phase
    c, s = np.cos(angle), np.sin(angle)
    return 0.8 * np.stack(
        [np.sign(c) * np.sqrt(np.abs(c)), np.sign(s) * np.sqrt(np.abs(s))], axis=1
    )


PATHS: dict[str, Shape] = {"eight": eight, "circle": circle, "square": square}


def even(path: Shape, count: int) -> Array:
    """`count` points (count, 2) at equal distances along one lap of a closed path."""
    fine = path(np.linspace(0, 1, 4001))
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(fine, axis=0).T))])
    place = np.linspace(0, way[-1], count, endpoint=False)
    return np.stack([np.interp(place, way, column) for column in fine.T], axis=1)


def lap_length(path: Shape) -> float:
    """Length of one lap [m]."""
    fine = path(np.linspace(0, 1, 4001))
    return float(np.hypot(*np.diff(fine, axis=0).T).sum())
