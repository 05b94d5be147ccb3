"""Fifty times a second: listen, read, decide, shape, send, log. Built from the policy's contract.

Deadlines are absolute, so the rate does not drift; a period that is missed is skipped and counted.
Whatever ends the loop, an exception included, ends with the torque off. `safety` decides what may
be done, `pilot` what the policy wants; here both meet the devices.
"""

import contextlib
import gc
import math
import socket
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.control import pilot
from tailbeat.control.band import Monitor
from tailbeat.control.policy import Policy
from tailbeat.swim import link, safety
from tailbeat.swim.imu import Imu, ImuFault, YawRate
from tailbeat.swim.link import Frame, Order, Receiver
from tailbeat.swim.safety import Health, Limits, Stand, State
from tailbeat.swim.servo import Servo, ServoFault, ServoState
from tailbeat.swim.status import Reporter

Array = NDArray[np.float64]
NEVER = -math.inf
ASK_EVERY = 0.25  # s between two questions for the laptop's clock
FRAMES = 3
CURRENT_TIME = 0.5  # s over which the servo's current is averaged
SECOND = 1_000_000_000
Row = dict[str, Any]


@dataclass(frozen=True, eq=False)
class Devices:
    """What the loop speaks to; `laptop` is where its status and questions for the clock go."""

    servo: Servo
    imu: Imu
    receiver: Receiver
    socket: socket.socket
    laptop: tuple[str, int]


@dataclass(eq=False)
class Loop:
    """The robot's loop; `tick` is one period, `run` many. `target` [m], if set, is a place in the
    pool that stands in for the target's tag. `put` takes a row for the log."""

    policy: Policy
    devices: Devices
    put: Callable[[Row], None]
    limits: Limits = field(default_factory=Limits)
    logging: Callable[[], bool] = lambda: True
    stand: Stand = field(default_factory=Stand)
    target: tuple[float, float] | None = None
    stop_asked: str = ""

    def __post_init__(self) -> None:
        space = self.policy.contract.actions
        self.period, self.low, self.high = self.policy.contract.period, space.low, space.high
        self.course = pilot.begin(self.policy)
        self.monitor = Monitor(self.policy.contract.band[1])
        self.servo: ServoState | None = None
        self.yaw = YawRate(NEVER, 0.0)
        self.seen: deque[Frame] = deque(maxlen=FRAMES)  # newest last, the fish in all of them
        self.missed: deque[float] = deque()  # when periods were missed
        self.currents: deque[float] = deque(maxlen=round(CURRENT_TIME / self.period))
        self.sent, self.finite, self.watchdog, self.torque = 0.0, True, False, False
        self.asked, self.questions = NEVER, 0
        self.reporter, self.ordered = Reporter(), False
        self.decided_on = np.zeros((FRAMES, 6))

    # ---- one period -----------------------------------------------------------------------------

    def tick(self, now: float) -> None:
        """One period that begins at `now` [s], monotonic."""
        began = time.monotonic()
        self._listen(now)
        self._read()
        health = self.health(now)
        before = self.stand
        self.stand = safety.judge(self.stand, health, self.limits)
        decision = self._decide() if self.stand.state is State.RUN else None
        if self.stand.state is State.STOP and before.state is not State.STOP:
            self._let_go()
        elif self.stand.state in (State.ARMED, State.RUN, State.HOLD):
            self._send(decision)
        row = self._row(now, health, decision, time.monotonic() - began)
        self.put(row)
        self._report(row, began - now)

    def _listen(self, now: float) -> None:
        """Datagrams of this period, and a question for the laptop's clock now and then."""
        receiver = self.devices.receiver
        for data, _ in link.drain(self.devices.socket):
            receiver.take(data, time.monotonic_ns())
        for frame in reversed(receiver.frames):
            if frame.fish is not None and (
                not self.seen or frame.captured > self.seen[-1].captured
            ):
                self.seen.append(frame)
        for order in receiver.take_orders():
            self._obey(order, now)
        if now - self.asked >= ASK_EVERY:
            self.asked, self.questions = now, self.questions + 1
            question = link.ask_datagram(
                receiver.key, receiver.nonce, self.questions, time.monotonic_ns()
            )
            self._to_laptop(question)

    def _to_laptop(self, datagram: bytes) -> None:
        with contextlib.suppress(OSError):  # a network that is down shows in the poses' age
            self.devices.socket.sendto(datagram, self.devices.laptop)

    def _report(self, row: Row, late: float) -> None:
        """Tell the laptop how it is, where that is due; `late` [s] is how late the row began."""
        target = self._target_of(self.seen[-1]) if self.seen else self.target
        said = self.reporter.report(row, late, self.devices.receiver, self.limits, target)
        if said is not None:
            self._to_laptop(said)

    def _read(self) -> None:
        try:
            self.servo = self.devices.servo.read()
            self.currents.append(self.servo.current)
            self.monitor.add(self.servo.time, self.servo.angle)
        except ServoFault:
            pass  # silence shows in its age
        try:
            self.yaw = self.devices.imu.read() or self.yaw
        except ImuFault:
            pass

    def health(self, now: float) -> Health:
        """What is known at this moment."""
        receiver, servo = self.devices.receiver, self.servo
        offset = receiver.clock.offset(time.monotonic_ns())
        age = receiver.age(self.seen[-1], time.monotonic_ns()) if self.seen else None
        while self.missed and now - self.missed[0] > 1.0:
            self.missed.popleft()
        return Health(
            pose_age=math.inf if age is None else age,
            imu_age=now - self.yaw.time,
            servo_age=math.inf if servo is None else now - servo.time,
            clock_doubt=math.inf if offset is None else offset[1] / SECOND,
            target=bool(self.seen) and self._target_of(self.seen[-1]) is not None,
            temperature=servo.temperature if servo else 25.0,
            voltage=servo.voltage if servo else 12.0,
            current=float(np.mean(np.abs(self.currents))) if self.currents else 0.0,
            alert=bool(servo and servo.alert),
            torque_lost=self.torque and self._torque_lost(),
            watchdog=self.watchdog,
            overruns=len(self.missed),
            finite=self.finite,
            logging=self.logging(),
            stop_asked=self.stop_asked,
        )

    def _torque_lost(self) -> bool:
        """Whether the servo let go by itself; asked for while it should hold."""
        try:
            return not self.devices.servo.is_on()
        except ServoFault:
            return False  # silence shows in its age

    def _target_of(self, frame: Frame) -> tuple[float, float] | None:
        return self.target or frame.target

    # ---- deciding and sending -------------------------------------------------------------------

    def frames(self, now_ns: int) -> Array:
        """The three newest frames (3, 6) as the policy sees them, newest first; a frame without the
        target has that of the newest one."""
        rows = []
        newest = self._target_of(self.seen[-1])
        for frame in reversed(self.seen):
            target = self._target_of(frame) or newest or (0.0, 0.0)
            age = self.devices.receiver.age(frame, now_ns)
            rows.append([*(frame.fish or ()), *target, math.nan if age is None else age])
        return np.array(rows + [rows[-1]] * (FRAMES - len(rows)))

    def _decide(self) -> pilot.Decision:
        assert self.servo is not None
        self.decided_on = self.frames(time.monotonic_ns())
        readings = pilot.Readings(
            self.servo.angle, self.servo.velocity, self.yaw.rate, self.decided_on
        )
        self.course, decision = pilot.steer(self.policy, self.course, readings)
        self.finite = math.isfinite(decision.setpoint)
        return decision

    def _send(self, decision: pilot.Decision | None) -> None:
        """The policy's setpoint; held while armed, straight and slowly on hold."""
        limits = self.limits
        if decision is not None:
            wanted, speed = decision.setpoint, limits.slew
        else:
            wanted = 0.0 if self.stand.state is State.HOLD else self.sent
            speed = limits.ramp
        angle = safety.shaped(wanted, self.sent, self.low, self.high, speed, self.period)
        try:
            self.sent = self.devices.servo.write(angle)
        except ServoFault as fault:
            self.watchdog = self.watchdog or fault.kind == "watchdog"

    # ---- what an operator does ------------------------------------------------------------------

    def _obey(self, order: Order, now: float) -> None:
        """An order from the laptop; arming is for a fish that does nothing."""
        self.ordered = True
        if order is Order.STOP:
            self.stop_asked = self.stop_asked or "the console"
        elif order is Order.DISARM:
            self.disarm()
        elif order is Order.SWIM:
            self.swim()
        elif self.stand.state in (State.DISARMED, State.HOLD):
            self.arm(now)

    def arm(self, now: float) -> Stand:
        """Torque on where the tail stands, if nothing speaks against it."""
        self.finite, self.stop_asked = True, ""
        self.stand = safety.arm(self.stand, self.health(now), self.limits)
        if self.stand.state is State.ARMED:
            try:
                self.devices.servo.prepare(self.low, self.high)
                self.sent = self.devices.servo.arm()
                self.torque, self.watchdog = True, False
                self.course = pilot.begin(self.policy)
            except ServoFault as fault:
                self._let_go()
                self.stand = Stand(State.DISARMED, f"arming failed: {fault}")
        return self.stand

    def swim(self) -> Stand:
        """Let the policy have it, out of ARMED alone."""
        self.stand = safety.run(self.stand)
        return self.stand

    def disarm(self) -> Stand:
        """Torque off, back to the beginning."""
        self._let_go()
        self.stop_asked, self.stand = "", safety.disarm(self.stand)
        return self.stand

    def _let_go(self) -> None:
        self.torque = False
        for _ in range(3):
            try:
                self.devices.servo.torque_off()
                return
            except ServoFault:
                continue  # in the end its own watchdog stops it

    # ---- many periods ---------------------------------------------------------------------------

    def run(self, over: Callable[[float], bool]) -> None:
        """Tick until `over` (asked with the time since the start, each period) says so."""
        gc.collect()
        gc.freeze()
        gc.disable()  # a collection takes longer than a period may
        start = due = time.monotonic()
        try:
            while not over(due - start):
                self.tick(due)
                due += self.period
                late = time.monotonic() - due
                if late > 0:
                    skipped = math.ceil(late / self.period)
                    self.missed.extend([due] * skipped)
                    due += skipped * self.period
                time.sleep(max(due - time.monotonic(), 0.0))
        finally:
            self._let_go()
            gc.enable()

    def _row(self, now: float, health: Health, decision: pilot.Decision | None, busy: float) -> Row:
        servo, frame = self.servo, self.seen[-1] if self.seen else None
        x, y, yaw = (frame.fish if frame and frame.fish else None) or (math.nan,) * 3
        share = self.monitor.share()
        return {
            "time_s": now,
            "state": self.stand.state.value,
            "reason": self.stand.reason,
            "command_rad": self.sent,
            "motor_angle_rad": servo.angle if servo else math.nan,
            "motor_velocity_rad_s": servo.velocity if servo else math.nan,
            "yaw_rate_rad_s": self.yaw.rate,
            "x_m": x,
            "y_m": y,
            "yaw_rad": yaw,
            "pose_age_s": health.pose_age,
            "clock_doubt_s": health.clock_doubt,
            "temperature_deg_c": health.temperature,
            "voltage_v": health.voltage,
            "current_a": health.current,
            "band_share": math.nan if share is None else share,
            "busy_s": busy,
            "missed": health.overruns,
            "observation": decision.observation if decision else [],
            "action": decision.action if decision else [],
            "setpoint_rad": decision.setpoint if decision else math.nan,
            "decided_on": self.decided_on if decision else [],
        }
