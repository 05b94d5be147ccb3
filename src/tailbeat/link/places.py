"""The pool's size, and places in it as a person types them."""

from tailbeat.files import BadInput

LENGTH, WIDTH = 5.5, 2.7  # m, the paper's pool
TARGET = "1.5,0.5"  # x,y [m], the default target


def place(text: str, option: str = "--target") -> tuple[float, float]:
    """`x,y` [m] inside the pool."""
    try:
        x, y = map(float, text.split(","))
    except ValueError:
        raise BadInput(f"{option} {text!r}: give x,y in metres, as 1.2,-0.4.") from None
    if not (abs(x) <= LENGTH / 2 and abs(y) <= WIDTH / 2):
        raise BadInput(
            f"{option} {text}: outside the pool, whose ends lie at x = {LENGTH / 2:g} and"
            f" y = {WIDTH / 2:g}."
        )
    return x, y
