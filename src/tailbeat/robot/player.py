"""Plays one recording of commands on a servo, open loop, and keeps what shaft and camera show.

Each period it writes the command, then reads the shaft: the order that identification assumes. A
broken rule of `safety` ends it with torque off, as do the watchdog process and the operator.
"""

import contextlib
import math
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tailbeat.files import BadInput
from tailbeat.link.arrival import arrived
from tailbeat.link.datagrams import Order
from tailbeat.link.reasons import Reason
from tailbeat.recording import Recording
from tailbeat.robot import plausible, safety
from tailbeat.robot.devices import Line
from tailbeat.robot.plausible import READINGS, Bounds, Travel
from tailbeat.robot.poses import Poses
from tailbeat.robot.safety import Health, SafetyLimits
from tailbeat.robot.servo import PATIENCE, Servo, ServoFault, ServoState
from tailbeat.robot.timing import sleep_until
from tailbeat.robot.torque import Torque
from tailbeat.robot.watchdog import Watchdog

Array = NDArray[np.float64]
PERIOD = 0.02  # s, while the shaft moves to the first command and back
HALF_SECOND = 25  # periods of that time
HELD = (Reason.BUS_WATCHDOG, Reason.SERVO_WARM, Reason.SUPPLY)  # where `drive` holds, this stops
RULES = (*safety.STOPS, *(rule for rule in safety.HOLDS if rule.reason in HELD))
GAP = 0.1  # s between two poses, beyond which rows have no pose
TRYING = 2.0  # s to turn torque off
TRIES = 5  # to arm
WAITING = 10.0  # s for the first pose and the station's clock


@dataclass(eq=False)
class Player:
    """A servo, the station's poses if there are any (`line`), and what was seen last.

    `stop_asked` says who requested a stop, or "". `seen` are poses with the times of their capture
    [s] on this computer's clock.
    """

    servo: Servo
    watcher: Watchdog
    limits: SafetyLimits
    line: Line | None = None
    stop_asked: str = ""
    torque: Torque = field(default_factory=Torque)
    state: ServoState | None = None
    seen: list[tuple[float, ...]] = field(default_factory=list)
    currents: deque[float] = field(default_factory=lambda: deque(maxlen=HALF_SECOND))
    travelled: deque[Travel] = field(default_factory=lambda: deque(maxlen=READINGS))
    poses: Poses | None = None
    armed: float = 0.0  # s, monotonic

    def play(self, commands: Recording, rest: float, swim: bool) -> Recording:
        """Move to the first command, wait `rest` [s] there, play all, move back to straight, turn
        torque off. Returns what was recorded, of a `swim` with poses. Raises BadInput if a rule is
        broken."""
        command = commands.columns["command_rad"]
        self.poses = Poses(self.line.receiver, Bounds()) if self.line and swim else None
        self.seen.clear()
        try:
            self._await_poses()
            self._arm(float(command.min()), float(command.max()))
            self._move(float(command[0]), rest)
            rows, began = self._play(commands.time - commands.time[0], command)
            self._move(0.0, 0.0)
        finally:
            self.off()
        return recorded(
            commands, np.array(rows, float).reshape(-1, 3), self.seen if self.poses else None, began
        )

    def off(self) -> None:
        """Turn torque off; tries for two seconds. Raises BadInput if the servo does not confirm it:
        the watchdog process then tries on."""
        end, fault = time.monotonic() + TRYING, self.torque.switch_off(self.servo, tries=3)
        while self.torque.owing and time.monotonic() < end:
            self.watcher.beat(True)
            fault = self.torque.switch_off(self.servo, tries=3)
        if self.torque.owing:
            raise BadInput(f"{fault}; TORQUE MAY BE ON: cut the servo's power.")

    def _arm(self, low: float, high: float) -> None:
        """Turn torque on where the shaft is, with a longer deadline: nothing moves yet. The servo's
        own limits hold the commands and that angle. Raises BadInput."""
        self.servo.deadline, usual = PATIENCE, self.servo.deadline
        for left in range(TRIES - 1, -1, -1):
            try:
                here = self.servo.read().angle
                self.servo.prepare(min(low, here, 0.0), max(high, here, 0.0))
                self.watcher.beat(True)
                self.torque.switch_on(self.servo)
                break
            except ServoFault as fault:
                if not left:
                    raise BadInput(f"arming failed: {fault}; run `tailbeat doctor`.") from None
        self.servo.deadline = usual
        self.travelled.clear()
        self.state, self.armed = None, time.monotonic()

    def _move(self, angle: float, rest: float) -> None:
        """Move slowly to an angle [rad], and stay there so long [s]."""
        planned, stayed, due = self.torque.sent, 0.0, time.monotonic()
        step = self.limits.ramp * PERIOD
        while planned != angle or stayed < rest:
            stayed += PERIOD if planned == angle else 0.0
            planned = min(max(angle, planned - step), planned + step)
            self._period(planned)
            due = max(due + PERIOD, time.monotonic())
            sleep_until(due)

    def _play(self, at: Array, command: Array) -> tuple[list[tuple[float, float, float]], float]:
        """Rows of time, command and angle, and when it began [s]. A command that is late by a whole
        period is left out."""
        rows, began = list[tuple[float, float, float]](), time.monotonic()
        self.seen.clear()
        for k, angle in enumerate(command.tolist()):
            if k + 1 < len(at) and time.monotonic() > began + at[k + 1]:
                continue
            sleep_until(began + at[k])
            if self._period(angle) and self.state is not None:
                rows.append((self.state.time - began, self.torque.sent, self.state.angle))
        return rows, began

    def _period(self, angle: float) -> bool:
        """Write a command, read the shaft, test the rules; returns whether the shaft was read."""
        self._listen()
        self.torque.send(self.servo, angle)
        fresh = False
        with contextlib.suppress(ServoFault):
            self.state, fresh = self.servo.read(), True
            self.currents.append(self.state.current)
            self.travelled.append((self.state.time, self.torque.sent, self.state.angle))
        self.torque.check(self.servo, bool(self.state and self.state.alert))
        health = self.health()
        rule = safety.first_broken(RULES, health, self.limits)
        if rule is not None:
            told = safety.SafetyStatus(
                reason=rule.reason, value=rule.value(health), note=rule.note(health)
            )
            raise BadInput(f"stopped, torque is off: {told.text}.")
        return fresh

    def health(self) -> Health:
        """What is known for the safety rules. Without poses those of the camera hold."""
        now, state = time.monotonic(), self.state
        age = 0.0
        if self.poses is not None:
            known = self.poses.age(time.monotonic_ns())
            age = math.inf if known is None else known
        return Health(
            pose_age=age,
            servo_age=now - (self.armed if state is None else state.time),
            temperature=state.temperature if state else 25.0,
            voltage=state.voltage if state else self.limits.voltage_high,
            current=float(np.mean(np.abs(self.currents))) if self.currents else 0.0,
            alert=bool(state and state.alert),
            hardware=self.torque.hardware,
            torque_lost=self.torque.lost,
            watchdog=self.torque.watchdog,
            follows=plausible.shaft_follows(self.travelled, Bounds()),
            guarded=self.watcher.beat(self.torque.on),
            stop_asked=self.stop_asked,
        )

    # ---- poses ----------------------------------------------------------------------------------

    def _await_poses(self) -> None:
        """Wait for the first pose. Raises BadInput if none comes."""
        end = time.monotonic() + WAITING
        while self.poses is not None and not self.seen:
            if time.monotonic() > end:
                raise BadInput(
                    f"no pose for {WAITING:g} s; start `tailbeat station` with the camera, and"
                    f" check that it sees the fish."
                )
            self._listen()
            self.watcher.beat(False)
            time.sleep(PERIOD)

    def _listen(self) -> None:
        """Take the frames that have come, and ask for the station's clock when that is due."""
        if self.line is None:
            return
        for data, waited in arrived(self.line.socket):
            self.line.receiver.take(data, time.monotonic_ns(), waited)
        if {Order.STOP, Order.DISARM} & set(self.line.receiver.take_orders()):
            self.stop_asked = self.stop_asked or "the operator page"
        if self.poses is None:
            return
        self.poses.update(self.limits)
        now = time.monotonic()
        question = self.poses.question(now)
        if question is not None:
            with contextlib.suppress(OSError):
                self.line.socket.sendto(question, self.line.station)
        stamped = self.poses.stamped(now, time.monotonic_ns())
        if stamped is not None and (not self.seen or stamped[1] > self.seen[-1][0] + 1e-3):
            self.seen.append((stamped[1], *stamped[2]))


def recorded(
    commands: Recording,
    rows: Array,
    seen: Sequence[tuple[float, ...]] | None,
    began: float,
) -> Recording:
    """A recording of `rows` (n, 3) of time, command and angle, with the poses `seen` (m, 4) at
    those times, None without a camera. Rows that no two near poses enclose are left out."""
    time_, command, angle = rows.T
    shaft = "angle_rad" if seen is None else "motor_angle_rad"
    columns = {"command_rad": command, shaft: angle}
    kept = np.ones(len(time_), bool)
    if seen is not None:
        poses = np.array(seen, float).reshape(-1, 4)
        at = poses[:, 0] - began
        place = np.column_stack([poses[:, 1:3], np.unwrap(poses[:, 3])])
        kept = _enclosed(time_, at)
        names = ("x_m", "y_m", "yaw_rad")
        columns |= {
            name: np.interp(time_, at, one) for name, one in zip(names, place.T, strict=True)
        }
    in_force = np.searchsorted(commands.time - commands.time[0], time_[kept], side="right") - 1
    labels = {name: words[in_force] for name, words in commands.labels.items()}
    # the asked launch is not the one that the fish had
    meta = {name: text for name, text in commands.meta.items() if name != "launch"}
    return Recording(
        commands.name, time_[kept], {k: v[kept] for k, v in columns.items()}, meta, labels
    )


def _enclosed(time_: Array, at: Array) -> NDArray[np.bool_]:
    """Which times lie between two poses that are at most `GAP` apart."""
    if len(at) < 2:
        return np.zeros(len(time_), bool)
    after = np.searchsorted(at, time_)
    inside = (after > 0) & (after < len(at))
    after = np.clip(after, 1, len(at) - 1)
    return inside & (at[after] - at[after - 1] <= GAP)
