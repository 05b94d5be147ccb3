"""A swim after a target that moves by the clock, as the station sees it.

The clock starts when the fish begins to swim. From then on it never waits: not for a fish that is
far away, and not for one that holds.
"""

import math
from dataclasses import dataclass, field

from tailbeat.link.status import State, Status
from tailbeat.operator.target_path import Place, TargetPath
from tailbeat.operator.tour import Pose

NOT_SEEN = (math.nan, math.nan, math.nan)
LATE = 1.0  # s that the last frame may be before the end of a path that was finished
RESTING = (State.HOLD, State.STOP)


@dataclass(frozen=True)
class Hold:
    """The fish went to HOLD or STOP: when [s] after the start, and the reason that it gave."""

    after: float
    state: str
    reason: str


@dataclass(frozen=True)
class FollowRecord:
    """What the station saw: when the fish `began` to swim, on the station's monotonic clock [s],
    and None if it never did; whether the target went to the end of its path; the holds; one row of
    `seen` for each camera frame: time after the start [s], x, y [m] and yaw [rad] of the tag (None
    where it was not seen), x and y of the target that was sent [m]. `last` is the fish's last
    state, with its reason."""

    began: float | None
    finished: bool
    holds: tuple[Hold, ...]
    seen: tuple[tuple[float | None, ...], ...]
    last: str = ""


@dataclass(eq=False)
class Follow:
    """The target on its `path`; see the module. Call `take` at every camera frame."""

    path: TargetPath
    began: float | None = None
    last: Status | None = None
    holds: list[Hold] = field(default_factory=list)
    seen: list[tuple[float, ...]] = field(default_factory=list)

    def take(self, status: Status | None, pose: Pose | None, at: float) -> Place:
        """Take a frame that was filmed at `at` [s] and the newest status; returns the place of the
        target at that time [m]."""
        if status is not None:
            self._note(status, at)
        since = 0.0 if self.began is None else max(at - self.began, 0.0)
        place = self.path.at(min(since, self.path.seconds))
        if self.began is not None:
            self.seen.append((since, *(pose or NOT_SEEN), *place))
        return place

    def over(self, now: float) -> bool:
        """Whether the target is at the end of its path at `now` [s]."""
        return self.began is not None and now - self.began >= self.path.seconds

    def record(self) -> FollowRecord:
        """What was seen, at the end."""
        last = self.last
        said = "" if last is None else f"{last.state.value}: {last.text}"
        whole = bool(self.seen) and self.seen[-1][0] > self.path.seconds - LATE
        return FollowRecord(self.began, whole, tuple(self.holds), tuple(self.seen), said)

    def _note(self, status: Status, at: float) -> None:
        """Start the clock when the fish swims first; count every change to HOLD or STOP since."""
        before, self.last = self.last, status
        if status.state is State.RUN and self.began is None:
            self.began = at
        changed = before is None or before.state is not status.state
        if self.began is not None and changed and status.state in RESTING:
            self.holds.append(Hold(at - self.began, status.state.value, status.text))
