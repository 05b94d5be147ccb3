"""Checks of a policy's contract and network when it is loaded: each refuses with one sentence."""

import math
import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from tailbeat.control.actions import PERIOD, ActionSpace, size
from tailbeat.control.camera_yaw import SOURCES
from tailbeat.control.measure import PAPER, Measure
from tailbeat.control.network_file import ROWS
from tailbeat.control.observation import Entry
from tailbeat.files import BadInput

Single = NDArray[np.float32]
Pairs = tuple[Sequence[list[float]], ...]
Constants = TypeVar("Constants")
LARGEST = 1e6  # of the numbers in golden pairs
DEPTH = 30  # tables inside tables of a contract; a fish has nine
KINDS = {"fish": str, "fish_digest": str, "training": dict, "description": dict | None}
CLOSE = 1e-5  # golden actions agree to this on any machine; 1e-6 was measured here
PATIENCE = 5.0  # s for the first answers of a network


def check_kinds(content: Mapping[str, object]) -> None:
    """Raises TypeError for a text or a table of a contract that is something else."""
    for name, kind in KINDS.items():
        if not isinstance(content.get(name), kind):
            raise TypeError(f"{name} is a {type(content.get(name)).__name__}")


def check_depth(content: Any) -> None:
    """Raises ValueError for a contract whose tables are nested without end."""
    if _deeper(content, DEPTH):
        raise ValueError(f"it is nested more than {DEPTH} times")


def _deeper(value: Any, depth: int) -> bool:
    if not isinstance(value, dict | list):
        return False
    inside = value.values() if isinstance(value, dict) else value
    return depth == 0 or any(_deeper(one, depth - 1) for one in inside)


def measure_from(path: Path, held: Any) -> Measure:
    """The measure in a contract. Raises BadInput."""
    numbers = held if isinstance(held, dict) else {"measure": held}
    wrong = set(numbers) ^ set(vars(PAPER)) if numbers else set()
    bad = [k for k, ratio in numbers.items() if not (_is_number(ratio) and 0 < ratio < 1000)]
    if wrong or bad:
        raise BadInput(
            f"{path}: measure has missing, unknown or impossible ratios {sorted(wrong) or bad};"
            f" export the policy again."
        )
    return Measure(**held)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def check_times(path: Path, band: tuple[float, float], period: float) -> None:
    """Refuse a band [Hz] or a period [s] that no training of this package has."""
    low, high = band
    if not 0 <= low < high < math.inf:
        raise BadInput(f"{path}: band is {low:g} to {high:g} Hz; export the policy again.")
    if period != PERIOD:
        raise BadInput(
            f"{path}: its period is {period} s; this tailbeat decides every {PERIOD:g} s."
        )


def check_pairs(
    path: Path, golden: Pairs, observation: Sequence[Entry], space: ActionSpace
) -> None:
    """Refuse golden pairs that are not as many observations as actions, of the right sizes."""
    rows = (len(observation), size(space))
    if not _paired(golden, rows):
        raise BadInput(
            f"{path}: its golden pairs are not {rows[0]} observations and {rows[1]} actions each,"
            f" {ROWS} at most; export the policy again."
        )


def _paired(golden: Pairs, wide: tuple[int, int]) -> bool:
    """Whether both sides are as many rows of finite numbers, as wide as this."""
    try:
        sides = [np.array(side, dtype=float) for side in golden]
    except (OverflowError, TypeError, ValueError):
        return False
    count = len(golden[0]) if golden else 0
    fits = [one.shape for one in sides] == [(count, one) for one in wide]
    return fits and 0 < count <= ROWS and all((np.abs(one) < LARGEST).all() for one in sides)


def check_source(path: Path, yaw_rate: object) -> None:
    """Refuse a source of the yaw rate that this package does not have."""
    if yaw_rate not in SOURCES:
        raise BadInput(
            f"{path}: its yaw rate comes from {yaw_rate!r}; allowed are {', '.join(SOURCES)}."
            f" Export the policy again."
        )


def constants_from(kind: type[Constants], held: Any, has: bool) -> Constants | None:
    """The constants of a filter in a contract whose version `has` them; None in one that has not.
    Raises TypeError or ValueError for anything else."""
    if held is None and not has:
        return None
    found = kind(**held)
    fits = all(_is_number(one) and 0 < one < 1000 for one in held.values())
    if not has or not fits or set(held) != set(vars(found)):
        raise ValueError(f"{kind.__name__} {held}, {'not as in' if has else 'none in'} its version")
    return found


def check_observation(path: Path, observation: Sequence[Entry], ours_of: Sequence[Entry]) -> None:
    """Refuse a table of observations that is not the one of this package."""
    if len(observation) != len(ours_of):
        raise BadInput(
            f"{path}: {len(observation)} observations; this tailbeat makes {len(ours_of)}."
            f" Use the tailbeat that exported it."
        )
    for row, (theirs, ours) in enumerate(zip(observation, ours_of, strict=True)):
        if theirs != ours:
            raise BadInput(
                f"{path}: observation {row} is {theirs}; this tailbeat makes {ours}. Use the"
                f" tailbeat that exported it."
            )


def check_golden(
    path: Path,
    session: onnxruntime.InferenceSession,
    golden: Pairs,
    wide: int,
    space: ActionSpace,
) -> None:
    """Refuse a network that does not take `wide` observations, or does not give the golden actions
    for the golden ones."""
    seen, wanted = (np.array(side, dtype=np.float32) for side in golden)
    inputs = session.get_inputs()
    if [one.name for one in inputs] != ["observation"] or inputs[0].shape[-1] != wide:
        raise BadInput(f"{path}: the network does not take {wide} observations; export it again.")
    try:
        answer = _timed(session, seen)
    except TimeoutError:
        raise BadInput(
            f"{path}: the network gave no answer within {PATIENCE:g} s; give a smaller one."
        ) from None
    except Exception as error:  # onnxruntime raises a dozen kinds of its own
        raise BadInput(
            f"{path}: the network does not run on observations of single precision; export it"
            f" again."
        ) from error
    if answer.shape != (len(seen), size(space)):
        raise BadInput(
            f"{path}: the network gives {answer.shape[-1]} numbers; its action space takes"
            f" {size(space)}; export it again."
        )
    worst = float(np.abs(answer - wanted).max())
    if not worst <= CLOSE:
        raise BadInput(
            f"{path}: golden actions are off by {worst:.2g}, allowed is {CLOSE:g}: the network is"
            f" not the one that was exported; export it again."
        )


def _timed(session: onnxruntime.InferenceSession, seen: Single) -> Single:
    """The network's answer. Raises TimeoutError after `PATIENCE`, once the layer that runs then has
    ended."""
    options, late = onnxruntime.RunOptions(), threading.Event()

    def give_up() -> None:
        late.set()
        options.terminate = True

    timer = threading.Timer(PATIENCE, give_up)
    timer.start()
    try:
        answer: Single = session.run(None, {"observation": seen}, options)[0]
    except Exception as error:
        if late.is_set():
            raise TimeoutError from error
        raise
    finally:
        timer.cancel()
    return answer
