"""Progress of a training: its rows, its state between sessions, its result."""

import json
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from tailbeat.control.measure import Measure
from tailbeat.env.assess import Summary
from tailbeat.env.curriculum import PROMOTED
from tailbeat.files import BadInput

RUN = "run.json"  # what a run is started with
CURVE = "curve.json"  # written at the end of a session
RECENT = 24  # rows of the history from which the time to promotion is estimated


def begun(folder: Path) -> bool:
    """Whether the folder holds a run to continue; before its first checkpoint it starts anew."""
    return (folder / RUN).is_file()


def measure_of_run(folder: Path) -> Measure:
    """The measure in which a run was trained. Raises BadInput."""
    path = folder / RUN
    try:
        return Measure(**json.loads(path.read_text(encoding="utf-8")).get("measure", {}))
    except (OSError, ValueError, TypeError, AttributeError):
        raise BadInput(
            f"{path}: missing or unreadable; give the folder of a run of `tailbeat train`."
        ) from None


@dataclass(frozen=True)
class TrainingRow:
    """One report of a training.

    `seconds` of training in all sessions; `stage` counts from 1, `name` is its name; `success` is
    the rolling success rate of the stage. `episodes`, `control_steps` (of all fish) and `updates`
    are totals; the two rates [1/s] are since the last row. `distance`, `effort`, `bonus` are the
    mean sums of the reward's terms in recent episodes, `episode_seconds` their mean length [s].
    `lost` counts fish whose physics diverged. `promotion_in` estimates the time to the next stage,
    or to the end of the polish [s], None if success does not rise; `polished` is the fraction of
    the polish that is done, None before it. At a promotion, `greedy` is the evaluation without
    exploration.
    """

    seconds: float
    stage: int
    name: str
    success: float
    episodes: int
    control_steps: int
    updates: int
    steps_per_s: float
    updates_per_s: float
    distance: float
    effort: float
    bonus: float
    episode_seconds: float
    lost: int
    promotion_in: float | None = None
    polished: float | None = None
    greedy: Summary | None = None


Report = Callable[[TrainingRow], None]


@dataclass
class Progress:
    """Progress of a training, saved in a checkpoint beside the networks."""

    stage: int = 0
    seconds: float = 0.0  # of training, in all sessions
    control_steps: int = 0  # of all fish
    stage_began: float = 0.0  # value of `seconds` at the stage's start
    episodes: int = 0
    # this stage's episodes: start time in control steps, and whether the fish arrived
    recent: list[tuple[int, bool]] = field(default_factory=list)
    history: list[TrainingRow] = field(default_factory=list)
    promotions: list[TrainingRow] = field(default_factory=list)
    leapt: int | None = None  # updates at the leap into the last stage, until it is decided
    passed_at: int | None = None  # updates when the last stage was passed: from here on, polish
    finished: bool = False
    stalled: bool = False

    def clock(self, fish: int) -> int:
        """Control steps that each of the `fish` has made."""
        return self.control_steps // fish

    def over(self, fish: int, steps: int) -> list[tuple[int, bool]]:
        """Episodes of `recent` that started at least `steps` ago. Every episode that started as
        early has ended."""
        latest = self.clock(fish) - steps
        return [(begun, arrived) for begun, arrived in self.recent if begun <= latest]

    def passed(self) -> int:
        """Number of stages passed: each is harder than those before it, which count with it. A run
        with a `start` counts as if it had passed them."""
        if self.passed_at is not None:
            return self.stage + 1
        return max((row.stage for row in self.promotions), default=0)

    def estimated(self, row: TrainingRow, polish: int) -> TrainingRow:
        """The newest row of the history with its estimates, of a run with `polish` updates."""
        if self.passed_at is None:
            return replace(row, promotion_in=self._promotion_in())
        done = row.updates - self.passed_at
        left = (polish - done) / row.updates_per_s if row.updates_per_s > 0 else None
        return replace(row, promotion_in=left, polished=done / polish if polish else 1.0)

    def _promotion_in(self) -> float | None:
        """Time until the rolling success rate allows promotion, from its slope over the last
        rows."""
        rows = [row for row in self.history if row.stage == self.stage + 1]
        if len(rows) < RECENT // 2:
            return None
        time, success = np.array([[row.seconds, row.success] for row in rows[-RECENT:]]).T
        slope = float(np.polyfit(time - time[0], success, 1)[0])
        missing = PROMOTED - float(success[-1])
        return max(missing / slope, 0.0) if slope > 1e-6 else None


@dataclass(frozen=True)
class TrainingResult:
    """Result of a training.

    Folder and policy; how many of its stages it passed, and whether all; whether the last one took
    longer than its budget; hours in all sessions; a row for every promotion; the last row.
    """

    folder: Path
    policy: Path
    stages_passed: int
    stages: int
    finished: bool
    stalled: bool
    hours: float
    promotions: tuple[TrainingRow, ...]
    last: TrainingRow | None
