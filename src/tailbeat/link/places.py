"""The pool's size, and positions in the pool that a person types."""

import math

from tailbeat.files import BadInput

LENGTH, WIDTH = 5.5, 2.7  # m, the paper's pool and the virtual pool
POOL = (LENGTH, WIDTH)  # used where no calibration gives the size
SMALLEST, LARGEST = 0.3, 100.0  # m, allowed side of a pool
ANY_POOL = (LARGEST, LARGEST)  # used while the pool's size is not known
TARGET = (1.5 / 2.75, 0.5 / 1.35)  # the default target, over half of the pool's length and width


def is_pool(length: float, width: float) -> bool:
    """Whether these sides [m] are allowed for a pool."""
    return all(math.isfinite(side) and SMALLEST <= side <= LARGEST for side in (length, width))


def room(reach: float) -> tuple[float, float]:
    """Length and width [m] of the virtual pool for a fish whose measure has this `reach`."""
    return LENGTH * reach, WIDTH * reach


def as_text(pool: tuple[float, float]) -> str:
    """A pool's length and width [m] as `pool_size` reads them."""
    return f"{pool[0]:.6g},{pool[1]:.6g}"


def within(share: tuple[float, float], pool: tuple[float, float]) -> str:
    """The place `x,y` [m] at shares of half of a pool's length and width, as `place` reads it."""
    return f"{share[0] * pool[0] / 2:.3f},{share[1] * pool[1] / 2:.3f}"


def pool_size(text: str, option: str = "--pool") -> tuple[float, float]:
    """Parse `length,width` [m] of a pool. Raises BadInput."""
    try:
        length, width = map(float, text.split(","))
    except ValueError:
        raise BadInput(f"{option} {text!r}: give length,width in metres, like 5.5,2.7.") from None
    if not is_pool(length, width):
        raise BadInput(f"{option} {text}: each side must be {SMALLEST:g} to {LARGEST:g} m.")
    return length, width


def place(
    text: str, option: str = "--target", pool: tuple[float, float] = POOL
) -> tuple[float, float]:
    """Parse `x,y` [m] of a position inside a pool of this length and width [m]. Raises BadInput."""
    try:
        x, y = map(float, text.split(","))
    except ValueError:
        raise BadInput(f"{option} {text!r}: give x,y in metres, like 1.2,-0.4.") from None
    if where := outside((x, y), pool):
        raise BadInput(f"{option} {text}: {where}.")
    return x, y


def pose(
    text: str, option: str = "--start", pool: tuple[float, float] = POOL
) -> tuple[float, float, float]:
    """Parse `x,y,heading` [m, m, deg] inside a pool of this length and width [m]; returns x, y [m]
    and yaw [rad]. Raises BadInput."""
    try:
        x, y, heading = map(float, text.split(","))
    except ValueError:
        heading = x = y = math.nan
    if not math.isfinite(heading):
        raise BadInput(
            f"{option} {text!r}: give x,y,heading in metres and degrees, like 1.2,-0.4,90."
        )
    if where := outside((x, y), pool):
        raise BadInput(f"{option} {text}: {where}.")
    return x, y, math.radians(heading)


def outside(at: tuple[float, float], pool: tuple[float, float]) -> str:
    """A sentence part if `at` [m] is outside a pool of this length and width [m]; "" if it is
    inside."""
    length, width = pool[0] / 2, pool[1] / 2
    if abs(at[0]) <= length and abs(at[1]) <= width:
        return ""
    return f"outside the pool: allowed x -{length:g} to {length:g} m, y -{width:g} to {width:g} m"
