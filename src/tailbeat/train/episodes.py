"""Episodes of a training that have ended: arrivals in the present stage, and sums of rewards."""

from collections import deque
from typing import NamedTuple

import numpy as np

from tailbeat.train.progress import Progress

KEPT = 5  # windows of episodes that are kept


class EpisodeSums(NamedTuple):
    """One episode: the sums of the reward's terms, and its length [s]."""

    distance: float
    effort: float
    bonus: float
    seconds: float


class Episodes:
    """The episodes of `fish` that swim at once, of at most `steps` each; those of the present
    stage are also in `progress`. The success rate is over `window` of them."""

    def __init__(self, progress: Progress, fish: int, steps: int, window: int) -> None:
        self.progress, self.fish, self.steps, self.window = progress, fish, steps, window
        self.sums: deque[EpisodeSums] = deque(maxlen=window)
        self.enter()

    def enter(self) -> None:
        """Begin a stage: the running episodes started in the one before."""
        self.starts: list[int | None] = [None] * self.fish
        self.ended: deque[bool] = deque(maxlen=self.fish)  # arrivals of the last to end

    def count(self, fish: int, arrived: bool, sums: EpisodeSums) -> None:
        """Count the episode of one fish that has ended."""
        self.progress.episodes += 1
        begun = self.starts[fish]
        if begun is not None:
            self.ended.append(arrived)
            self.progress.recent.append((begun, arrived))
            del self.progress.recent[: -KEPT * self.window]
            self.sums.append(sums)
        self.starts[fish] = self.progress.clock(self.fish)

    def judged(self) -> list[bool]:
        """Arrivals of the last complete episodes, by start time.

        An arrival ends an episode early, so the episodes that ended last are mostly arrivals. An
        episode counts only once every episode that started as early has ended.
        """
        known = self.progress.over(self.fish, self.steps)
        order = sorted(known, key=lambda row: row[0])
        return [arrived for _, arrived in order[-self.window :]]

    def promise(self) -> float:
        """Share of arrivals among the last episodes of this stage to end, one per fish; 0 while
        they are fewer. It is more than the success rate, and known half a minute earlier."""
        full = len(self.ended) == self.fish
        return float(np.mean(self.ended)) if full else 0.0

    def success(self) -> float:
        """Rolling success rate of the stage."""
        judged = self.judged()
        return float(np.mean(judged)) if judged else 0.0

    def means(self) -> EpisodeSums:
        """Means over the last episodes, NaN before the first."""
        columns = zip(*self.sums, strict=True) if self.sums else ([np.nan],) * 4
        return EpisodeSums(*(float(np.mean(column)) for column in columns))
