"""The pool's size, and places in it as a person types them."""

import math

from tailbeat.files import BadInput

LENGTH, WIDTH = 5.5, 2.7  # m, the paper's pool, which the virtual one is
POOL = (LENGTH, WIDTH)  # where no calibration tells the size
SMALLEST, LARGEST = 0.3, 100.0  # m of a pool's side
ANY_POOL = (LARGEST, LARGEST)  # while the pool's size is not known
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
    if where := outside((x, y), pool):
        raise BadInput(f"{option} {text}: {where}.")
    return x, y


def outside(at: tuple[float, float], pool: tuple[float, float]) -> str:
    """Says so where a place [m] is not in a pool of this length and width [m]; "" where it is."""
    length, width = pool[0] / 2, pool[1] / 2
    if abs(at[0]) <= length and abs(at[1]) <= width:
        return ""
    return f"outside the pool, whose ends lie at x = {length:g} and y = {width:g}"
