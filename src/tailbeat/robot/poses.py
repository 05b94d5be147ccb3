"""The camera's frames that the loop accepts: poses, their age, and the station's clock."""

import math
import time
from collections import deque
from dataclasses import dataclass, field, replace
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from tailbeat.control import camera_yaw
from tailbeat.link import datagrams as link
from tailbeat.link import places
from tailbeat.link.clock import SECOND
from tailbeat.link.datagrams import Frame, Receiver
from tailbeat.robot import plausible
from tailbeat.robot.plausible import Bounds
from tailbeat.robot.safety import SafetyLimits

FRAMES = 3
ASK_EVERY = 0.25  # s between two requests for the station's clock


@dataclass(eq=False)
class Poses:
    """Accepted frames that show the fish, `seen`, newest last.

    `jumps` counts implausible frames in a row. `target` [m], if set, replaces the target's tag.
    `clock_step` [s] is the jump of the station's clock since arming.
    """

    receiver: Receiver
    bounds: Bounds
    target: tuple[float, float] | None = None
    seen: deque[Frame] = field(default_factory=lambda: deque(maxlen=camera_yaw.FRAMES))
    jumps: int = 0
    jumped_at: int = 0  # ns, capture of the newest implausible frame
    clock_step: float = 0.0
    compared: int = -1  # sequence number of the last echo that was tested
    asked: float = -math.inf  # s, time of the last clock request
    questions: int = 0

    def update(self, limits: SafetyLimits) -> None:
        """Test the clocks for a jump, then keep the receiver's newer frames."""
        self._compare_clocks(limits)
        for frame in reversed(self.receiver.frames):
            newer = not self.seen or frame.captured > self.seen[-1].captured
            if frame.fish is not None and newer:
                self._take(frame)

    def _take(self, frame: Frame) -> None:
        """Keep a newer frame if the fish can have moved there since the last one."""
        if self.seen and not plausible.pose_follows(self.seen[-1], frame, self.bounds):
            self.jumps += frame.captured > self.jumped_at
            self.jumped_at = max(frame.captured, self.jumped_at)
            return
        self.jumps = 0
        self.seen.append(frame)

    def _compare_clocks(self, limits: SafetyLimits) -> None:
        """After a jump of the station's clock, use only the echoes since, and correct the frames'
        times unless they are on the new clock already."""
        receiver = self.receiver
        if receiver.told == self.compared:
            return
        self.compared = receiver.told
        step = plausible.clock_step(receiver.clock.echoes, self.bounds)
        if not step:
            return
        self.clock_step += step / SECOND
        newest = receiver.clock.echoes[-1]
        receiver.clock.echoes.clear()
        receiver.clock.echoes.append(newest)
        receiver.frames.clear()  # else frames of a clock that was set back would be rejected as old
        self._shift(step, limits)

    def _shift(self, step: int, limits: SafetyLimits) -> None:
        """Correct the frames' times for a clock jump of `step` [ns]."""
        now = time.monotonic_ns()
        for _ in range(len(self.seen)):
            frame = self.seen.popleft()
            age = self.receiver.age(frame, now) or 0.0
            shifted = replace(frame, captured=max(frame.captured + step, 0))
            on_it = -limits.clock_doubt < age < limits.pose_hold
            self.seen.append(frame if on_it else shifted)

    def question(self, now: float) -> bytes | None:
        """A clock request to the station if one is due at `now` [s], else None."""
        if now - self.asked < ASK_EVERY:
            return None
        self.asked, self.questions = now, self.questions + 1
        receiver = self.receiver
        stamp = time.monotonic_ns()
        return link.ask_datagram(receiver.key, receiver.nonce, self.questions, stamp)

    def age(self, now_ns: int) -> float | None:
        """Age of the newest pose [s]; None if there is none."""
        return self.receiver.age(self.seen[-1], now_ns) if self.seen else None

    def pose(self) -> tuple[float, float, float]:
        """The newest x, y [m] and yaw [rad], or NaN."""
        newest = self.seen[-1].fish if self.seen else None
        return newest or (math.nan, math.nan, math.nan)

    def stamped(
        self, now: float, now_ns: int
    ) -> tuple[float, float, tuple[float, float, float]] | None:
        """The newest pose with its capture [s] on the station's clock and on the robot's; None
        without one."""
        newest = self.seen[-1] if self.seen else None
        age = self.age(now_ns)
        if newest is None or newest.fish is None or age is None:
            return None
        return newest.captured / SECOND, now - age, newest.fish

    def yaw_rate(self) -> float | None:
        """The slope of the accepted headings [rad/s], see `control.camera_yaw`; None before the
        first pose, and 0 while the poses are too few."""
        if not self.seen:
            return None
        newest = self.seen[-1].captured
        rows = [((frame.fish or self.pose())[2], frame.captured) for frame in reversed(self.seen)]
        yaw, staleness = zip(*((yaw, (newest - at) / SECOND) for yaw, at in rows), strict=True)
        return float(camera_yaw.yaw_rate(np.array([yaw]), np.array([staleness]))[0])

    def has_target(self) -> bool:
        """Whether the newest pose has a target."""
        return bool(self.seen) and self.target_of(self.seen[-1]) is not None

    def outside(self) -> str:
        """The size of the pool if the set target is outside it; "" if not, or while the size is not
        known."""
        known = self.receiver.told >= 0
        return places.outside(self.target, self.receiver.room) if self.target and known else ""

    def strayed(self) -> str:
        """Where the newest poses lie, if that is outside the pool; else ""."""
        if self.receiver.far is None:
            return ""
        x, y = self.receiver.far
        return f": the camera sees fish or target at {x:.2f}, {y:.2f} m, outside the pool"

    def newest_target(self) -> tuple[float, float] | None:
        """The target that the robot swims to [m], or None if it is not known."""
        return self.target_of(self.seen[-1]) if self.seen else self.target

    def target_of(self, frame: Frame) -> tuple[float, float] | None:
        """The set target, else the one in the frame."""
        return self.target or frame.target

    def frames(self, now_ns: int) -> NDArray[np.float64]:
        """The three newest frames (3, 6) as the policy sees them, newest first: x, y, yaw, target
        x, y, age. A frame without the target has that of the newest one."""
        rows = []
        newest = self.target_of(self.seen[-1])
        for frame in islice(reversed(self.seen), FRAMES):
            target = self.target_of(frame) or newest or (0.0, 0.0)
            age = self.receiver.age(frame, now_ns)
            rows.append([*(frame.fish or ()), *target, math.nan if age is None else age])
        return np.array(rows + [rows[-1]] * (FRAMES - len(rows)))
