"""The 50 Hz loop: listen, read, decide, limit, send, log. Built from the policy's contract.

Deadlines are absolute, so the rate does not drift; a period that is missed is skipped and counted.
The loop turns torque off whenever it ends, also after an exception. `safety` decides what is
allowed, `control.runner` computes the policy's setpoint; this module connects both to the devices.
"""

import contextlib
import math
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tailbeat.control import runner
from tailbeat.control.band import Monitor
from tailbeat.control.corrections import zero
from tailbeat.control.load import Motor
from tailbeat.control.policy import Policy
from tailbeat.link.arrival import arrived
from tailbeat.link.clock import SECOND
from tailbeat.link.datagrams import Order
from tailbeat.link.status import State
from tailbeat.robot import safety
from tailbeat.robot.devices import Devices
from tailbeat.robot.plausible import Bounds
from tailbeat.robot.poses import FRAMES, Poses
from tailbeat.robot.reporter import Reporter
from tailbeat.robot.safety import Health, SafetyLimits, SafetyStatus
from tailbeat.robot.sensors import CameraYaw, Sensors
from tailbeat.robot.servo import ServoFault
from tailbeat.robot.signals import Signals
from tailbeat.robot.timing import Pace, sleep_until, without_collection
from tailbeat.robot.torque import Torque

BAND_EVERY = 10  # periods between two band checks, which take longer than a decision
Row = dict[str, Any]


@dataclass(eq=False)
class Loop:
    """The robot's loop; `tick` is one period, `run` many.

    `target` [m], if set, replaces the target's tag. `put` takes a row for the log. `alive` is
    called once a period with whether torque is on; it returns whether the watchdog would turn
    torque off if the loop failed.
    """

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
    sign_test: bool = True  # before the first swim, if the policy's file says what to expect
    motor: Motor | None = None  # what the servo's current says; None: nothing

    def __post_init__(self) -> None:
        contract = self.policy.contract
        self.period, self.low, self.high = (
            contract.period,
            contract.actions.low,
            contract.actions.high,
        )
        floor, edge = contract.band
        self.sensors = Sensors(self.period, self.bounds, Monitor(edge, floor=floor))
        self.poses = Poses(self.devices.receiver, self.bounds, self.target)
        self.yaw_sensor = self.devices.imu or CameraYaw(self.poses)
        self.torque, self.reporter = Torque(), Reporter()
        turns = (self.low, self.high)
        self.signals = Signals(self.policy.expected, contract.band, turns, contract.measure)
        self.signals.tested, self.signals.motor = not self.sign_test, self.motor
        self.signals.imu = self.devices.imu is not None
        self.runner_state, self.decided_on = runner.begin(self.policy), np.zeros((FRAMES, 6))
        self.finite, self.guarded, self.ordered = True, True, False
        self.missed: deque[float] = deque()  # when periods were missed
        self.late = 0.0  # s, of this period
        self.decided_at = 0  # ns, monotonic

    def tick(self, now: float) -> None:
        """One period that begins at `now` [s], monotonic."""
        began, worked = time.monotonic(), time.thread_time()
        self.guarded = self.alive(self.torque.on)
        self._listen(now)
        self.sensors.read(self.devices.servo, self.yaw_sensor, self.torque.sent)
        if self.torque.on:
            alert = self.sensors.servo is not None and self.sensors.servo.alert
            self.torque.check(self.devices.servo, alert)
            self._compare(now)
        health = self.health(now)
        decision = self._act(health)
        if self.safety_status.state is not State.RUN:
            self.sensors.reopen(self.devices.servo, self.devices.imu, now)
        row = self._row(now, health, decision)
        row["busy_s"], row["compute_s"] = time.monotonic() - began, time.thread_time() - worked
        self.pace.busy.add(row["busy_s"])
        self.pace.compute.add(row["compute_s"])
        self.put(row)
        self._report(row)

    def _act(self, health: Health) -> runner.Decision | None:
        """Apply the safety rules, let the policy decide in RUN, and send the setpoint."""
        before = self.safety_status.state
        self.safety_status = safety.judge(self.safety_status, health, self.limits)
        if self.safety_status.state is State.TEST and self.signals.over:
            self.safety_status = safety.after_test(self.signals.verdict())
        state = self.safety_status.state
        decision = self._decide() if state is State.RUN else None
        if state is State.STOP and before is not State.STOP:
            self._torque_off()
        elif state in (State.ARMED, State.TEST, State.RUN, State.HOLD):
            self._send(decision)
        elif self.torque.owing:
            self._torque_off(tries=1)
        return decision

    def _listen(self, now: float) -> None:
        """Handle the datagrams of this period, and ask for the station's clock when it is due."""
        receiver = self.devices.receiver
        for data, waited in arrived(self.devices.socket):
            receiver.take(data, time.monotonic_ns(), waited)
        self.poses.update(self.limits)
        for order in receiver.take_orders():
            self._obey(order, now)
        question = self.poses.question(now)
        if question is not None:
            self._to_station(question)

    def _compare(self, now: float) -> None:
        """Add this period to the robot's own signals, and look at them while it swims."""
        servo, receiver = self.sensors.servo, self.devices.receiver
        if servo is None:
            return
        stamped = self.poses.stamped(now, time.monotonic_ns())
        target = self.poses.newest_target() or (math.nan, math.nan)
        shown = (servo.angle, servo.current)
        self.signals.add(now, self.torque.sent, shown, self.sensors.yaw.rate, stamped, target)
        if self.safety_status.state is State.RUN:
            self.signals.look(receiver.room if receiver.told >= 0 else None)

    def _to_station(self, datagram: bytes) -> None:
        with contextlib.suppress(OSError):  # the age of the poses shows that a network is down
            self.devices.socket.sendto(datagram, self.devices.station)

    def _report(self, row: Row) -> None:
        """Send the station a status when it is due."""
        target = self.poses.newest_target()
        said = self.reporter.report(row, self.late, self.devices.receiver, self.limits, target)
        if said is not None:
            self._to_station(said)

    def health(self, now: float) -> Health:
        """Collect what is known at `now` [s] for the safety rules."""
        servo, age = self.sensors.servo, self.poses.age(time.monotonic_ns())
        offset = self.devices.receiver.clock.offset(time.monotonic_ns())
        while self.missed and now - self.missed[0] > 1.0:
            self.missed.popleft()
        return Health(
            pose_age=math.inf if age is None else age,
            imu_age=now - self.sensors.yaw.time,
            servo_age=math.inf if servo is None else now - servo.time,
            clock_doubt=math.inf if offset is None else offset[1] / SECOND,
            target=self.poses.has_target(),
            temperature=servo.temperature if servo else 25.0,
            voltage=self.sensors.supply(),
            current=self.sensors.current(),
            alert=bool(servo and servo.alert),
            torque_lost=self.torque.on and self.torque.lost,
            watchdog=self.torque.watchdog,
            overruns=len(self.missed),
            finite=self.finite,
            logging=self.logging(),
            stop_asked=self.stop_asked,
            hardware=self.torque.hardware,
            imu_frozen=self.sensors.imu_fault == "frozen",
            follows=not self.torque.on or self.sensors.follows(),
            jumps=self.poses.jumps,
            clock_step=self.poses.clock_step,
            guarded=self.guarded,
            outside=self.poses.outside(),
            signals=self.signals.trouble,
            warning=self.signals.warned,
            strayed=self.poses.strayed(),
        )

    def _decide(self) -> runner.Decision:
        servo = self.sensors.servo
        assert servo is not None
        now = time.monotonic_ns()
        elapsed, self.decided_at = (now - self.decided_at) / SECOND, now
        self.decided_on = self.poses.frames(now)
        readings = runner.Readings(
            servo.angle, servo.velocity, self.sensors.yaw.rate, self.decided_on, elapsed
        )
        self.runner_state, decision = runner.steer(self.policy, self.runner_state, readings)
        self.finite = math.isfinite(decision.setpoint)
        return decision

    def _send(self, decision: runner.Decision | None) -> None:
        """Send the setpoint: the policy's in RUN, the sign test's in TEST, the held angle when
        armed, slowly to straight in HOLD.

        If the servo's own watchdog stopped it, HOLD first makes it accept setpoints again from
        where it is.
        """
        limits, on_hold = self.limits, self.safety_status.state is State.HOLD
        if self.torque.watchdog and on_hold:
            self.torque.release(self.devices.servo)
            return
        last = self.torque.sent
        if decision is not None:
            wanted, speed = decision.setpoint, limits.slew
        elif self.safety_status.state is State.TEST:
            wanted, speed = self.signals.setpoint(last, limits.ramp * self.period), limits.slew
        else:
            straight = zero(self.policy.contract.corrections)
            wanted, speed = straight if on_hold else last, limits.ramp
        angle = safety.shaped(wanted, last, self.low, self.high, speed, self.period)
        self.torque.send(self.devices.servo, angle)
        if decision is not None:
            self.pace.latency.add(self.poses.age(time.monotonic_ns()) or 0)

    def _obey(self, order: Order, now: float) -> None:
        """Follow an order from the station; only a robot that is DISARMED or in HOLD is armed."""
        self.ordered = True
        if order is Order.STOP:
            self.stop_asked = self.stop_asked or "the operator page"
        elif order is Order.DISARM:
            self.disarm()
        elif order is Order.SWIM:
            self.swim()
        elif self.safety_status.state in (State.DISARMED, State.HOLD):
            self.arm(now)

    def arm(self, now: float) -> SafetyStatus:
        """Turn torque on where the tail is now, if no rule of `safety` is broken."""
        self.finite, self.stop_asked = True, ""
        self.poses.clock_step, self.torque.hardware = 0.0, ""
        self.signals.forget()
        self.safety_status = safety.arm(self.safety_status, self.health(now), self.limits)
        if self.safety_status.state is State.ARMED:
            try:
                self.devices.servo.prepare(self.low, self.high)
                self.alive(True)  # the watchdog knows before torque is on
                self.torque.switch_on(self.devices.servo)
                self.signals.begin(self.torque.sent)
                self.sensors.travelled.clear()
                self.runner_state = runner.begin(self.policy)
            except ServoFault as fault:
                self._torque_off()
                self.safety_status = safety.arming_failed(str(fault))
        return self.safety_status

    def swim(self) -> SafetyStatus:
        """Let the policy swim, the first time after the sign test; only from ARMED."""
        self.safety_status = safety.run(self.safety_status, self.signals.wanted)
        return self.safety_status

    def disarm(self) -> SafetyStatus:
        """Turn torque off and return to DISARMED."""
        self._torque_off()
        self.stop_asked, self.safety_status = "", safety.disarm(self.safety_status)
        return self.safety_status

    def _torque_off(self, tries: int = 3) -> None:
        """Turn torque off; while the servo has not confirmed it, every period tries again."""
        fault = self.torque.switch_off(self.devices.servo, tries)
        if fault is not None:
            self.sensors.servo_gone = fault.kind == "gone"

    def run(self, over: Callable[[float], bool]) -> None:
        """Tick until `over` returns True; it is called every period with the time since the start
        [s]."""
        with without_collection():
            try:
                self._run(over)
            finally:
                self._torque_off()

    def _run(self, over: Callable[[float], bool]) -> None:
        start = due = time.monotonic()
        before = self.safety_status
        while not over(due - start):
            if self.safety_status is not before:  # the time for arming is not a missed period
                due += self.period * max((time.monotonic() - due) // self.period, 0.0)
            self.late = time.monotonic() - due
            self.pace.late.add(self.late)
            self.tick(due)
            self.pace.periods += 1
            due = self._next(due)
            before = self.safety_status
            sleep_until(due)

    def _next(self, due: float) -> float:
        """When the next period is due [s]; missed ones are skipped and counted."""
        due += self.period
        late = time.monotonic() - due
        if late <= 0:
            return due
        skipped = math.ceil(late / self.period)
        self.missed.extend([due] * skipped)
        self.pace.skipped += skipped
        return due + skipped * self.period

    def _row(self, now: float, health: Health, decision: runner.Decision | None) -> Row:
        """A row for the log; `tick` adds how long the period took."""
        sensors, (x, y, yaw) = self.sensors, self.poses.pose()
        if self.pace.periods % BAND_EVERY == 0:
            sensors.look_at_band()
        return {
            "time_s": now,
            "state": self.safety_status.state.value,
            "reason": self.safety_status.text,
            "cause": self.safety_status.reason.name.lower(),
            "command_rad": self.torque.sent,
            "motor_angle_rad": sensors.servo.angle if sensors.servo else math.nan,
            "motor_velocity_rad_s": sensors.servo.velocity if sensors.servo else math.nan,
            "yaw_rate_rad_s": sensors.yaw.rate,
            "x_m": x,
            "y_m": y,
            "yaw_rad": yaw,
            "pose_age_s": health.pose_age,
            "clock_doubt_s": health.clock_doubt,
            "temperature_deg_c": health.temperature,
            "voltage_v": health.voltage,
            "current_a": health.current,
            "band_share": 1 - sensors.shares.above,
            "below_band_share": sensors.shares.below,
            "late_s": self.late,
            "missed": health.overruns,
            "spikes": sensors.gate.count,
            "pose_jumps": self.poses.jumps,
            **self.signals.row(),
            "observation": decision.observation if decision else [],
            "action": decision.action if decision else [],
            "setpoint_rad": decision.setpoint if decision else math.nan,
            "decided_on": self.decided_on if decision else [],
        }
