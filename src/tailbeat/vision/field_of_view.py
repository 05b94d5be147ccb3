"""Where the camera does not see the fish's tag: a fish that swims there is lost."""

from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from tailbeat.vision.calibration import Calibration

Single = NDArray[np.float32]
WALLS = ("x = -{x:g} m", "x = {x:g} m", "y = -{y:g} m", "y = {y:g} m")
EDGE = 4.0  # px from the picture's edge within which the tracker believes no corner
NEAR = 0.03  # m: no tag in the middle of a fish comes nearer to a wall (chosen)
FAR, STEP = 1.0, 0.005  # m from a wall: how far is looked, and how finely
POINTS = 41  # along each wall, but for its ends, where another wall is near
MIDDLE = 0.9


def unseen(made: Calibration) -> tuple[float, float, float, float]:
    """How far [m] from the walls at -x, x, -y and y the fish's tag, whichever way it is turned, is
    not whole in the picture; 0 where it always is. The pool's size must be known."""
    assert made.pool is not None
    picture = _outline(made)
    half = np.array(made.pool) / 2
    radius = made.fish.side / np.sqrt(2)
    found = []
    for axis, sign in ((0, -1.0), (0, 1.0), (1, -1.0), (1, 1.0)):
        along = np.linspace(-MIDDLE, MIDDLE, POINTS) * half[1 - axis]
        seen = [
            all(_inside(picture, axis, sign * (half[axis] - away), at) >= radius for at in along)
            for away in np.arange(0.0, FAR, STEP)
        ]
        found.append(float(STEP * np.argmax(seen)) if any(seen) else FAR)
    a, b, c, d = found
    return a, b, c, d


def blind(made: Calibration) -> str:
    """A sentence part that names the strips along walls where the fish's tag is not seen; "" if
    there are none."""
    if made.pool is None:
        return ""
    x, y = (side / 2 for side in made.pool)
    strips = [
        f"{100 * far:.0f} cm along the wall at {wall.format(x=x, y=y)}"
        for wall, far in zip(WALLS, unseen(made), strict=True)
        if far > NEAR
    ]
    return f"the fish's tag is not whole in the picture: {', '.join(strips)}" if strips else ""


def _outline(made: Calibration) -> Single:
    """The edge of what the tracker believes (n, 1, 2) [m], at the height of the fish's tag."""
    columns, rows = made.lens.size
    last = np.array([columns - 1 - EDGE, rows - 1 - EDGE])
    share = np.linspace(0.0, 1.0, 100)[:, None]
    corners = np.array([[EDGE, EDGE], [last[0], EDGE], last, [EDGE, last[1]], [EDGE, EDGE]])
    sides = [a + share * (b - a) for a, b in pairwise(corners)]
    return made.places(np.concatenate(sides), made.fish.height).astype(np.float32)[:, None]


def _inside(outline: Single, axis: int, across: float, along: float) -> float:
    """Distance [m] of a place from the outline, negative outside."""
    place = (across, along) if axis == 0 else (along, across)
    return float(cv2.pointPolygonTest(outline, place, True))
