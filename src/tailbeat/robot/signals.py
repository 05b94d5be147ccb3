"""The robot's own signals while it has torque: the sign test before a swim, monitors during it.

The statistics and their bounds are `control`'s, the table of checks is `checks`; here are the last
seconds of rows, and which check is broken. One statistic is computed in each period, so that none
is long.
"""

import math
from dataclasses import dataclass, field, fields, replace

import numpy as np
from numpy.typing import NDArray

from tailbeat.control import consistency as at
from tailbeat.control import load, sign_test
from tailbeat.control.actions import PERIOD
from tailbeat.control.consistency import Signs
from tailbeat.control.expected import Expected, ShaftState, held, turn
from tailbeat.control.load import Motor
from tailbeat.control.measure import PAPER, Measure
from tailbeat.robot.checks import CHECKS

Array = NDArray[np.float64]
Pose = tuple[float, float, float]
ROWS = round(at.LONGEST / PERIOD)
NAMES = (*(one.name for one in fields(Signs)), *load.NAMES)
NEEDS_ROOM = ("progress", "course")
INSTEAD = ("weakening",)  # which a servo's current makes needless
NEEDS_IMU = ("turning", "drifting", "recoil")
WALL = 0.3  # m of the paper's fish: nearer to a wall, the fish's way does not count
# Share of the recoil's lower bound that counts there. A wall takes from the body's answer: 0.67 of
# the bound or more was left in 18,000 windows of tours; cut tendons leave nothing (chosen).
WALLED = 0.5


@dataclass(eq=False)
class Window:
    """The last 20 s of rows, see `consistency.COLUMNS`, kept so that they are always together."""

    held: Array = field(default_factory=lambda: np.full((2 * ROWS, len(at.COLUMNS)), np.nan))
    count: int = 0

    def add(self, row: tuple[float, ...]) -> None:
        """Add the newest row; the oldest goes."""
        place = self.count % ROWS
        self.held[place] = self.held[place + ROWS] = row
        self.count += 1

    def rows(self) -> Array:
        """The rows, oldest first; not to be kept."""
        if self.count <= ROWS:
            return self.held[: self.count]
        first = self.count % ROWS
        return self.held[first : first + ROWS]


@dataclass(eq=False)
class Signals:
    """What the robot's own signals say; `begin` at every arming, `add` in every period.

    `expected` is the policy's, or None: then nothing is tested. `broken` counts for each check, by
    its text, in how many looks in a row it was. `imu`: the yaw rate is an IMU's, not the camera's
    own, which agrees with the camera always. `tested`: the sign test was passed, or is skipped.
    `motor`: None if the servo's current says nothing of its torque; else what it says is used in
    place of the stroke's weakening, which a servo at its torque's limit hides.
    """

    expected: Expected | None
    band: tuple[float, float]
    range: tuple[float, float]
    measure: Measure = PAPER
    imu: bool = True
    tested: bool = False
    motor: Motor | None = None
    window: Window = field(default_factory=Window)
    shaft: ShaftState | None = None
    turned: float = 0.0  # rad, the yaw rate's integral
    yaw: float = math.nan  # rad, the camera's, continued over the turn
    frame: tuple[float, float] = (-1.0, math.nan)  # capture on the station's clock, on the robot's
    looks: int = 0
    signs: dict[str, float] = field(default_factory=dict)
    broken: dict[str, int] = field(default_factory=dict)
    played: int = -1  # setpoints of the sign test that were sent; -1: it has not begun
    last: float = math.nan  # s, time of the newest row
    warned: str = ""  # the warning in force, as it was first said
    shown: tuple[float, float] = (0.0, math.nan)  # rad, A, of the newest row
    rate: float = 0.0  # rad/s, its yaw rate

    def __post_init__(self) -> None:
        self.plan = sign_test.program(self.band, *self.range)

    @property
    def wanted(self) -> bool:
        """Whether the robot must do the sign test before it swims."""
        return self.expected is not None and not self.tested

    def forget(self) -> None:
        """Drop what the monitors found in the last swim: it must not keep the robot from arming."""
        self.signs, self.broken, self.warned = {}, {}, ""

    def begin(self, angle: float) -> None:
        """Torque is on, and the shaft is held at an angle [rad]."""
        if self.expected is not None:
            self.shaft = held(self.expected.shaft, angle)
        self.forget()
        self.window = Window()
        self.played, self.looks, self.turned, self.yaw = -1, 0, 0.0, math.nan
        self.last, self.shown = math.nan, (angle, math.nan)

    def add(
        self,
        time: float,
        sent: float,
        shown: tuple[float, float],
        rate: float,
        frame: tuple[float, float, Pose] | None,
        target: tuple[float, float],
    ) -> None:
        """Add a period: its time [s], setpoint [rad], what the servo has `shown` (its angle [rad],
        its current [A]), yaw rate [rad/s], the newest camera frame (its capture on the station's
        clock, on the robot's [s], the pose) and the target [m]."""
        if self.expected is None or self.shaft is None:
            return
        pose = self._newest(frame)
        before, self.last = self.last, time
        missed = round((time - before) / PERIOD) - 1 if math.isfinite(before) else 0
        missed = min(max(missed, 0), ROWS)
        for share in (np.arange(missed + 1) + 1.0) / (missed + 1):  # periods that were missed too
            at_time = before + share * (time - before) if missed else time
            self._step(at_time, sent, (float(share), *shown, rate), (*pose, *target))
        self.shown, self.rate = shown, rate

    def _step(
        self,
        time: float,
        sent: float,
        read: tuple[float, float, float, float],
        seen: tuple[float, ...],
    ) -> None:
        """One period: the modelled shaft, the integrated yaw rate, a row. `read`: the share of the
        way to the newest reading, its motor angle, current and yaw rate."""
        assert self.expected is not None and self.shaft is not None
        share, *shown, rate = read
        self.shaft = turn(self.expected.shaft, self.shaft, sent)
        self.turned += PERIOD * (rate + self.rate) / 2
        angle, current = (a + share * (b - a) for a, b in zip(self.shown, shown, strict=True))
        turning = self.rate + share * (rate - self.rate)
        row = (time, angle, self.shaft.angle, turning, self.turned, *seen, sent, current)
        self.window.add(row)

    def _newest(self, frame: tuple[float, float, Pose] | None) -> tuple[float, float, float, float]:
        """Capture time, x, y and continued yaw of the newest frame; NaN without one."""
        if frame is None:
            return math.nan, math.nan, math.nan, math.nan
        captured, seen, (x, y, yaw) = frame
        if captured != self.frame[0]:
            self.frame = (captured, seen)
        return self.frame[1], x, y, self._continued(yaw)

    def _continued(self, yaw: float) -> float:
        """The yaw without its jumps of a whole turn."""
        if math.isfinite(self.yaw):
            yaw = self.yaw + math.remainder(yaw - self.yaw, math.tau)
        self.yaw = yaw
        return yaw

    # ---- monitors -------------------------------------------------------------------------------

    def look(self, room: tuple[float, float] | None) -> None:
        """Compute one statistic; call it in every period of a swim. `room`: the pool [m]."""
        if self.expected is None or self.shaft is None:
            return
        name = NAMES[self.looks % len(NAMES)]
        self.looks += 1
        rows = self.window.rows()
        if len(rows) * PERIOD < at.SPAN:
            return
        value = self._sign(name, rows)
        limits, walled = self.expected.limits, self._by_a_wall(rows, room)
        if walled:
            low = limits.recoil_low
            limits = replace(limits, recoil_low=min(WALLED * low, low), recoil_high=math.inf)
        if (name in NEEDS_ROOM and walled) or (name in NEEDS_IMU and not self.imu):
            value = math.nan
        self.signs[name] = value
        for one in CHECKS:
            if one.sign == name:
                wrong = one.broken(value, limits, self.measure)
                if math.isfinite(value):  # a pause of the beats proves nothing
                    self.broken[one.text] = self.broken.get(one.text, 0) + 1 if wrong else 0
        self.warned = (self.warned or self._said(False)) if self._said(False) else ""

    def _sign(self, name: str, rows: Array) -> float:
        assert self.expected is not None
        if name in load.NAMES:
            shaft = self.expected.shaft
            return load.sign(name, rows, shaft, self.motor) if self.motor else math.nan
        if name in INSTEAD and self.motor:
            return math.nan
        return at.sign(name, rows, self.expected, at.LEAST_SPEED * self.measure.speed)

    @property
    def trouble(self) -> str:
        """Why the robot must hold, or ""."""
        return self._said(True)

    def _by_a_wall(self, rows: Array, room: tuple[float, float] | None) -> bool:
        """Whether the fish was beside a wall within the window."""
        if room is None:
            return False
        recent = at.since(rows, at.SPAN)
        place = np.abs(recent[:, at.X : at.Y + 1]).max(axis=0)
        return bool((place > np.array(room) / 2 - WALL * self.measure.size).any())

    def _said(self, holds: bool) -> str:
        """What the first broken check says, of those that hold the robot or of those that warn."""
        for one in CHECKS:
            if one.holds is holds and self.broken.get(one.text, 0) >= one.times:
                return one.text.format(x=self.signs[one.sign])
        return ""

    def row(self) -> dict[str, float]:
        """The statistics for the log."""
        return {f"signal_{name}": self.signs.get(name, math.nan) for name in NAMES}

    # ---- the sign test --------------------------------------------------------------------------

    def setpoint(self, last: float, step: float) -> float:
        """The next setpoint of the sign test [rad]: first to straight by `step` [rad] a period,
        then the program."""
        if self.played < 0:
            away = self.plan.setpoints[0] - last
            if abs(away) > step:
                return last + math.copysign(step, away)
            self.window, self.turned = Window(), 0.0
        self.played += 1
        return float(self.plan.setpoints[min(self.played, len(self.plan.setpoints) - 1)])

    @property
    def over(self) -> bool:
        """Whether the whole program was played, and its last setpoint has been answered."""
        return self.played >= len(self.plan.setpoints)

    def verdict(self) -> str:
        """What the sign test found wrong, or ""; a robot that passed need not repeat it."""
        assert self.expected is not None
        count = len(self.plan.setpoints)
        rows = self.window.rows()[-count:]
        if len(rows) < count:
            return "too few readings; arm again"
        found = sign_test.answers(self.plan, rows, self.expected, self.motor)
        if not self.imu:
            found = replace(found, imu=found.camera)
        said = sign_test.verdict(found)
        self.tested = not said
        return said
