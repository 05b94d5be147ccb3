"""Settings and other metadata of an imported file: what is allowed, and what its comments state."""

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from tailbeat.files import BadInput

NUMBERS = ("gain", "load_mass_kg", "load_arm_m", "supply_v")  # settings that are above 0
LOADS = ("tail", "pendulum", "nothing")
TEXTS = ("load", "motor", "trajectory")  # metadata of --meta that may be words
# What our own recordings state. Other comment lines of a file are left out.
KEPT = frozenset((*NUMBERS, *TEXTS, "source", "begin", "launch", "purpose"))
KEPT |= {"date", "servo_model", "water"}
COMMENT = re.compile(r"# *(\w+) *: *(.*)")


def positive(value: object) -> float:
    """`value` as a finite number above 0; NaN for anything else, and for True and False."""
    try:
        number = float(str(value))
    except ValueError:  # also of a number with thousands of digits
        return math.nan
    return number if 0 < number < math.inf else math.nan


def allowed(key: str) -> str:
    """What a metadata key may be, in words."""
    if key == "load":
        return "tail, pendulum or nothing"
    return "a finite number above 0" if key in NUMBERS else "a word or a number"


def fits(key: str, text: str) -> bool:
    """Whether a text is allowed for a metadata key."""
    if key == "load":
        return text in LOADS
    return math.isfinite(positive(text)) if key in NUMBERS else text != ""


def same(key: str, one: str, other: str) -> bool:
    """Whether two texts that fit a key state the same: numbers by value, words by letters."""
    return math.isclose(float(one), float(other)) if key in NUMBERS else one == other


def of_comments(file: Path, lines: Sequence[str]) -> dict[str, str]:
    """What the comment lines `# key: value` of a CSV state, for the keys in `KEPT`. Separators that
    a spreadsheet adds at a line's end are dropped. Raises BadInput as `checked` does, and for two
    values of one key."""
    found: dict[str, str] = {}
    for match in filter(None, map(COMMENT.fullmatch, lines)):
        key, text = match[1], match[2].rstrip(" ,;\t")
        if found.setdefault(key, text) != text and key in KEPT:
            said = f"metadata {key} is stated twice, {found[key]!r} and {text!r}"
            raise BadInput(f"{file}: {said}; remove one of the lines.")
    return checked(file, found)


def checked(file: Path, stated: Mapping[str, str]) -> dict[str, str]:
    """What a file states for the keys in `KEPT`, without empty texts. Raises BadInput for a text
    that its key does not allow."""
    kept = {key: text for key, text in stated.items() if key in KEPT and text}
    for key, text in kept.items():
        if not fits(key, text):
            said = f"metadata {key} = {text!r} is not {allowed(key)}"
            raise BadInput(f"{file}: {said}; correct or remove it.")
    return kept
