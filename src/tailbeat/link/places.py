"""The pool's size, and places in it as a person types them."""

import math

from tailbeat.files import BadInput

LENGTH, WIDTH = 5.5, 2.7  # m, the paper's pool, which the virtual one is
POOL = (LENGTH, WIDTH)  # where no calibration tells the size
SMALLEST, LARGEST = 0.3, 100.0  # m of a pool's side
TARGET = "1.5,0.5"  # x,y [m], the default target


def is_pool(length: float, width: float) -> bool:
    """Whether a pool may have these sides [m]."""
    return all(math.isfinite(side) and SMALLEST <= side <= LARGEST for side in (length, width))


def pool_size(text: str, option: str = "--pool") -> tuple[float, float]:
    """`length,width` [m] of a pool. Raises BadInput."""
    try:
        length, width = map(float, text.split(","))
    except ValueError:
        raise BadInput(f"{option} {text!r}: give length,width in metres, as 5.5,2.7.") from None
    if not is_pool(length, width):
        raise BadInput(f"{option} {text}: each side must be {SMALLEST:g} to {LARGEST:g} m.")
    return length, width


def place(
    text: str, option: str = "--target", pool: tuple[float, float] = POOL
) -> tuple[float, float]:
    """`x,y` [m] inside a pool of this length and width [m]. Raises BadInput."""
    try:
        x, y = map(float, text.split(","))
    except ValueError:
        raise BadInput(f"{option} {text!r}: give x,y in metres, as 1.2,-0.4.") from None
    if not (abs(x) <= pool[0] / 2 and abs(y) <= pool[1] / 2):
        raise BadInput(
            f"{option} {text}: outside the pool, whose ends lie at x = {pool[0] / 2:g} and"
            f" y = {pool[1] / 2:g}."
        )
    return x, y
