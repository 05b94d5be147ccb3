"""Fifty times a second: listen, read, decide, shape, send, log. Built from the policy's contract.

Deadlines are absolute, so the rate does not drift; a period that is missed is skipped and counted.
Whatever ends the loop, an exception included, ends with the torque off. `safety` decides what may
be done, `runner` what the policy wants; here both meet the devices.
"""

import contextlib
import gc
import math
import socket
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.control import runner as runner
from tailbeat.control.band import Monitor, Shares
from tailbeat.control.policy import Policy
from tailbeat.link import datagrams as link
from tailbeat.link.datagrams import Frame, Order, Receiver
from tailbeat.link.reasons import Reason
from tailbeat.link.status import State
from tailbeat.robot import plausible, safety
from tailbeat.robot.imu import Imu, ImuFault, YawRate
from tailbeat.robot.plausible import Bounds, Gate
from tailbeat.robot.reporter import Reporter
from tailbeat.robot.safety import Health, SafetyLimits, SafetyStatus
from tailbeat.robot.servo import Servo, ServoFault, ServoState
from tailbeat.robot.timing import Pace, sleep_until

Array = NDArray[np.float64]
NEVER = -math.inf
NOTHING_MOVES = Shares(math.nan, math.nan, math.nan)
ASK_EVERY = 0.25  # s between two questions for the laptop's clock
FRAMES = 3
CURRENT_TIME = 0.5  # s over which the servo's current is averaged
FOLLOWING = 0.5  # s within which a shaft that is asked to move must have moved
CHECK_EVERY = 2  # periods between two looks at the servo's torque and watchdog, in turn
BAND_EVERY = 10  # periods between two looks at the band, which take longer than a decision
REOPEN_EVERY = 0.5  # s between two tries to open a port whose cable was out
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
    pool that stands in for the target's tag. `put` takes a row for the log. `alive` hears
    once a period whether torque is on, and says whether anyone would let go if the loop died."""

    policy: Policy
    devices: Devices
    put: Callable[[Row], None]
    limits: SafetyLimits = field(default_factory=SafetyLimits)
    logging: Callable[[], bool] = lambda: True
    safety_status: SafetyStatus = field(default_factory=SafetyStatus)
    target: tuple[float, float] | None = None
    stop_asked: str = ""
    bounds: Bounds = field(default_factory=Bounds)
    alive: Callable[[bool], bool] = lambda torque: True
    pace: Pace = field(default_factory=Pace)

    def __post_init__(self) -> None:
        space = self.policy.contract.actions
        self.period, self.low, self.high = self.policy.contract.period, space.low, space.high
        self.runner_state = runner.begin(self.policy)
        floor, edge = self.policy.contract.band
        self.monitor = Monitor(edge, floor=floor)
        self.servo: ServoState | None = None
        self.yaw = YawRate(NEVER, 0.0)
        self.seen: deque[Frame] = deque(maxlen=FRAMES)  # newest last, the fish in all of them
        self.missed: deque[float] = deque()  # when periods were missed
        self.currents: deque[float] = deque(maxlen=round(CURRENT_TIME / self.period))
        self.sent, self.finite, self.watchdog, self.torque = 0.0, True, False, False
        self.asked, self.questions = NEVER, 0
        self.reporter, self.ordered = Reporter(), False
        self.gate, self.imu_said, self.guarded = Gate(), "", True
        self.jumps, self.jumped_at, self.clock_step, self.compared = 0, 0, 0.0, -1
        following = round(FOLLOWING / self.period)
        self.travelled: deque[tuple[float, float]] = deque(maxlen=following)  # asked, seen
        self.owing, self.reopened, self.gone = False, NEVER, {"servo": False, "imu": False}
        self.lost, self.hardware, self.turn, self.late = False, "", 0, 0.0
        self.shares = NOTHING_MOVES
        self.decided_on = np.zeros((FRAMES, 6))

    # ---- one period -----------------------------------------------------------------------------

    def tick(self, now: float) -> None:
        """One period that begins at `now` [s], monotonic."""
        began, worked = time.monotonic(), time.thread_time()
        self.guarded = self.alive(self.torque)
        self._listen(now)
        self._read()
        if self.torque:
            self._look_after()
        health = self.health(now)
        before = self.safety_status
        self.safety_status = safety.judge(self.safety_status, health, self.limits)
        decision = self._decide() if self.safety_status.state is State.RUN else None
        if self.safety_status.state is State.STOP and before.state is not State.STOP:
            self._torque_off()
        elif self.safety_status.state in (State.ARMED, State.RUN, State.HOLD):
            self._send(decision)
        elif self.owing:
            self._torque_off(tries=1)
        if self.safety_status.state is not State.RUN:
            self._mend(now)
        row = self._row(now, health, decision)
        row["busy_s"], row["compute_s"] = time.monotonic() - began, time.thread_time() - worked
        self.pace.busy.add(row["busy_s"])
        self.pace.compute.add(row["compute_s"])
        self.put(row)
        self._report(row, self.late)

    def _listen(self, now: float) -> None:
        """Datagrams of this period, and a question for the laptop's clock now and then."""
        receiver = self.devices.receiver
        for data, _ in link.drain(self.devices.socket):
            receiver.take(data, time.monotonic_ns())
        self._compare_clocks()
        for frame in reversed(receiver.frames):
            if frame.fish is not None and (
                not self.seen or frame.captured > self.seen[-1].captured
            ):
                self._take(frame)
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

    def _take(self, frame: Frame) -> None:
        """A newer frame, if the fish can have come there; one that is old anyway is replaced."""
        if self.seen and not plausible.pose_follows(self.seen[-1], frame, self.bounds):
            self.jumps += frame.captured > self.jumped_at
            self.jumped_at = max(frame.captured, self.jumped_at)
            return
        self.jumps = 0
        self.seen.append(frame)

    def _compare_clocks(self) -> None:
        """Where the laptop's clock stepped: only the echo since counts, and the frames' stamps are
        put on the new clock unless they are on it already."""
        receiver = self.devices.receiver
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
        receiver.frames.clear()  # else frames of a clock set back would be refused as old
        now = time.monotonic_ns()
        for _ in range(len(self.seen)):
            frame = self.seen.popleft()
            age = receiver.age(frame, now) or 0.0
            shifted = replace(frame, captured=max(frame.captured + step, 0))
            on_it = -self.limits.clock_doubt < age < self.limits.pose_hold
            self.seen.append(frame if on_it else shifted)

    def _read(self) -> None:
        try:
            self.servo = self.devices.servo.read()
            self.gone["servo"] = False
            self.currents.append(self.servo.current)
            self.monitor.add(self.servo.time, self.servo.angle)
            self.travelled.append((self.sent, self.servo.angle))
        except ServoFault as fault:  # silence shows in its age
            self.gone["servo"] = fault.kind == "gone"
        try:
            self._believe(self.devices.imu.read())
            self.gone["imu"], self.imu_said = False, ""
        except ImuFault as fault:
            self.gone["imu"], self.imu_said = fault.kind == "gone", fault.kind

    def _believe(self, yaw: YawRate | None) -> None:
        if yaw is None:
            return
        self.gate, believed = plausible.gated(self.gate, yaw.rate, self.bounds)
        if believed:
            self.yaw = yaw

    def _look_after(self) -> None:
        """Whether the servo still holds torque, and whether its watchdog stopped it: one question
        in every second period, so that the bus stays free. Silence shows in its age."""
        self.turn += 1
        servo, due = self.devices.servo, self.turn % CHECK_EVERY == 0
        try:
            if self.servo is not None and self.servo.alert and not self.hardware:
                self.hardware = ", ".join(servo.hardware_errors())
            elif due and self.turn // CHECK_EVERY % 2:
                self.lost = not servo.is_on()
            elif due:
                self.watchdog = self.watchdog or servo.stopped_itself()
        except ServoFault:
            pass

    def _mend(self, now: float) -> None:
        """A port whose cable was out is opened again, never while the policy swims."""
        broken = self.gone["servo"] or self.gone["imu"] or self.imu_said == "frozen"
        if not broken or now - self.reopened < REOPEN_EVERY:
            return
        self.reopened = now
        try:
            if self.gone["servo"]:
                self.devices.servo.reopen()
            else:
                self.devices.imu.reopen()
        except (ServoFault, ImuFault):
            pass  # again in a moment

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
            torque_lost=self.torque and self.lost,
            watchdog=self.watchdog,
            overruns=len(self.missed),
            finite=self.finite,
            logging=self.logging(),
            stop_asked=self.stop_asked,
            hardware=self.hardware,
            imu_frozen=self.imu_said == "frozen",
            follows=not self.torque or self._follows(),
            jumps=self.jumps,
            clock_step=self.clock_step,
            guarded=self.guarded,
        )

    def _follows(self) -> bool:
        whole = len(self.travelled) == self.travelled.maxlen
        asked, seen = zip(*self.travelled, strict=True) if whole else ((), ())
        return plausible.shaft_follows(asked, seen, self.bounds)

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

    def _decide(self) -> runner.Decision:
        assert self.servo is not None
        self.decided_on = self.frames(time.monotonic_ns())
        readings = runner.Readings(
            self.servo.angle, self.servo.velocity, self.yaw.rate, self.decided_on
        )
        self.runner_state, decision = runner.steer(self.policy, self.runner_state, readings)
        self.finite = math.isfinite(decision.setpoint)
        return decision

    def _send(self, decision: runner.Decision | None) -> None:
        """The policy's setpoint; held while armed, straight and slowly on hold. A servo that its
        own watchdog stopped is, on hold, brought back from where it stands."""
        limits = self.limits
        if decision is not None:
            wanted, speed = decision.setpoint, limits.slew
        else:
            wanted = 0.0 if self.safety_status.state is State.HOLD else self.sent
            speed = limits.ramp
        angle = safety.shaped(wanted, self.sent, self.low, self.high, speed, self.period)
        try:
            if self.watchdog and self.safety_status.state is State.HOLD:
                self.sent = self.devices.servo.release()
                self.watchdog = False
                return
            self.sent = self.devices.servo.write(angle)
        except ServoFault as fault:
            self.watchdog = self.watchdog or fault.kind == "watchdog"
        if decision is not None:
            self.pace.latency.add(
                self.devices.receiver.age(self.seen[-1], time.monotonic_ns()) or 0
            )

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
        elif self.safety_status.state in (State.DISARMED, State.HOLD):
            self.arm(now)

    def arm(self, now: float) -> SafetyStatus:
        """Torque on where the tail stands, if nothing speaks against it."""
        self.finite, self.stop_asked, self.clock_step, self.hardware = True, "", 0.0, ""
        self.safety_status = safety.arm(self.safety_status, self.health(now), self.limits)
        if self.safety_status.state is State.ARMED:
            try:
                self.devices.servo.prepare(self.low, self.high)
                self.alive(True)  # the watchdog knows before torque is on
                self.sent = self.devices.servo.arm()
                self.torque, self.watchdog, self.lost = True, False, False
                self.travelled.clear()
                self.runner_state = runner.begin(self.policy)
            except ServoFault as fault:
                self._torque_off()
                self.safety_status = SafetyStatus(
                    State.DISARMED, Reason.ARMING_FAILED, note=str(fault)
                )
        return self.safety_status

    def swim(self) -> SafetyStatus:
        """Let the policy have it, out of ARMED alone."""
        self.safety_status = safety.run(self.safety_status)
        return self.safety_status

    def disarm(self) -> SafetyStatus:
        """Torque off, back to the beginning."""
        self._torque_off()
        self.stop_asked, self.safety_status = "", safety.disarm(self.safety_status)
        return self.safety_status

    def _torque_off(self, tries: int = 3) -> None:
        """Torque off; `owing` until the servo confirmed it, and tried again every period."""
        self.torque, self.owing = False, True
        for _ in range(tries):
            try:
                self.devices.servo.torque_off()
                self.owing = False
                return
            except ServoFault as fault:
                self.gone["servo"] = fault.kind == "gone"

    # ---- many periods ---------------------------------------------------------------------------

    def run(self, over: Callable[[float], bool]) -> None:
        """Tick until `over` (asked with the time since the start, each period) says so."""
        gc.collect()
        gc.freeze()
        gc.disable()  # a collection takes longer than a period may
        start = due = time.monotonic()
        stood = self.safety_status
        try:
            while not over(due - start):
                if self.safety_status is not stood:  # arming took time, and is no miss
                    due += self.period * max((time.monotonic() - due) // self.period, 0.0)
                self.late = time.monotonic() - due
                self.pace.late.add(self.late)
                self.tick(due)
                self.pace.periods += 1
                due += self.period
                late = time.monotonic() - due
                if late > 0:
                    skipped = math.ceil(late / self.period)
                    self.missed.extend([due] * skipped)
                    self.pace.skipped += skipped
                    due += skipped * self.period
                stood = self.safety_status
                sleep_until(due)
        finally:
            self._torque_off()
            gc.enable()

    def _row(self, now: float, health: Health, decision: runner.Decision | None) -> Row:
        """For the log; `tick` adds how long it took."""
        servo, frame = self.servo, self.seen[-1] if self.seen else None
        x, y, yaw = (frame.fish if frame and frame.fish else None) or (math.nan,) * 3
        if self.pace.periods % BAND_EVERY == 0:
            self.shares = self.monitor.shares() or NOTHING_MOVES
        return {
            "time_s": now,
            "state": self.safety_status.state.value,
            "reason": self.safety_status.text,
            "cause": self.safety_status.reason.name.lower(),
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
            "band_share": 1 - self.shares.above,
            "below_band_share": self.shares.below,
            "late_s": self.late,
            "missed": health.overruns,
            "spikes": self.gate.count,
            "pose_jumps": self.jumps,
            "observation": decision.observation if decision else [],
            "action": decision.action if decision else [],
            "setpoint_rad": decision.setpoint if decision else math.nan,
            "decided_on": self.decided_on if decision else [],
        }
