"""The whole bench without hardware: plant, emulated servo and IMU on pseudo-terminals, poses sent.

One process that a robot's loop cannot tell from a lab: the plant turns the servo's shaft and the
IMU, and the laptop's end sends signed poses at sixty frames a second, late, noisy and now and then
without a tag, on a clock of its own. Poses come from the plant, not yet from rendered pictures.
"""

import os
import select
import socket
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tailbeat.fish.description import Fish
from tailbeat.identify.runs import tracked_pose
from tailbeat.learn.sensors import SensorModel
from tailbeat.pool.imu import Bno055
from tailbeat.pool.plant import LENGTH, WIDTH, Surroundings, at_rest, build_plant, step_plant
from tailbeat.pool.servo import Dynamixel, Line, Shaft, close_line, hears, open_line
from tailbeat.pool.water import Water
from tailbeat.swim import link
from tailbeat.swim.link import Frame

Array = NDArray[np.float64]
SECOND = 1_000_000_000
CLOCK_AHEAD, CLOCK_FAST = 37 * SECOND, 20e-6  # the laptop's clock against the fish's
BAUD = 1_000_000
LONGEST = 0.2  # s that the plant is stepped at once; a rig that was stopped does not catch up


@dataclass(eq=False)
class PlantShaft(Shaft):
    """The servo's shaft in the plant: what it is asked for goes in, where it is comes out."""

    fish: Fish = field(kw_only=True)
    water: Water = field(default_factory=Water, kw_only=True)

    def __post_init__(self) -> None:
        around = [Surroundings(walls=(LENGTH, WIDTH))]
        self.plant = build_plant(self.fish, [self.water], around=around)
        self.state, self.gain, self.owed = at_rest(self.plant), float(self.plant.servo[0, 0]), 0.0

    def advance(self, goal: float | None, dt: float) -> None:
        """Without torque the servo pulls at nothing."""
        self.plant.servo[0, 0] = 0.0 if goal is None else self.gain
        self.owed += dt
        steps = int(self.owed / self.plant.dt)
        if steps:
            self.owed -= steps * self.plant.dt
            step_plant(self.plant, self.state, np.full((1, steps), goal or 0.0), steps)
        self.angle, self.velocity = float(self.state.q[0, 3]), float(self.state.v[0, 3])

    @property
    def pose(self) -> Array:
        """Of the tag: x, y [m], yaw [rad]."""
        return tracked_pose(self.fish, self.state.q[0, :3])


@dataclass(eq=False)
class Laptop:
    """The sender's end: frames of a camera, and answers to questions for its clock."""

    key: bytes
    socket: socket.socket
    fish: tuple[str, int]
    target: tuple[float, float]
    rng: np.random.Generator
    model: SensorModel = field(default_factory=SensorModel)
    run: int = 1
    nonce: int | None = None
    sequence: int = 0
    due: float = 0.0
    stepped: float = 0.0  # s that its clock was set ahead
    shifted: tuple[float, float, float] = (0.0, 0.0, 0.0)  # what its tracker is wrong by
    taken: deque[Frame] = field(default_factory=lambda: deque(maxlen=link.FRAMES))
    ahead: deque[tuple[float, bytes]] = field(default_factory=deque)  # when to send what

    def clock(self, now: float) -> int:
        """Its own monotonic clock [ns] at a time [s] of this machine's."""
        return round(now * (1 + CLOCK_FAST) * SECOND) + CLOCK_AHEAD + round(self.stepped * SECOND)

    def work(self, now: float, pose: Array) -> None:
        """Answer, take a frame when it is time, send what has travelled long enough."""
        for data, sender in link.drain(self.socket):
            self._answer(data, sender, now)
        if now >= self.due:
            self.due = max(self.due + 1 / self.model.frame_rate, now)
            self._film(now, pose)
        while self.ahead and self.ahead[0][0] <= now:
            self.socket.sendto(self.ahead.popleft()[1], self.fish)

    def _answer(self, data: bytes, sender: tuple[str, int], now: float) -> None:
        told = link.tell_datagram(self.key, self.run, data, self.clock(now), self.clock(now))
        if told is not None:
            self.nonce = link.HEAD.unpack_from(data)[2]
            self.socket.sendto(told, sender)

    def _film(self, now: float, pose: Array) -> None:
        model, rng = self.model, self.rng
        noise = rng.normal(size=3) * [model.position_noise, model.position_noise, model.yaw_noise]
        seen = rng.uniform() >= model.dropped
        x, y, yaw = (pose + noise + self.shifted).tolist()
        self.taken.append(Frame(self.clock(now), (x, y, yaw) if seen else None, self.target))
        if self.nonce is None:
            return
        self.sequence += 1
        packet = link.pose_datagram(self.key, self.run, self.nonce, self.sequence, list(self.taken))
        late = model.latency + model.latency_jitter * rng.uniform()
        self.ahead.append((now + late, packet))


@dataclass(eq=False)
class Rig:
    """Everything together; see `open_rig` and `serve`."""

    shaft: PlantShaft
    servo: Dynamixel
    imu: Bno055
    lines: tuple[Line, Line]  # of servo and IMU
    laptop: Laptop
    began: float = field(default_factory=time.monotonic)

    @property
    def ports(self) -> tuple[str, str]:
        """What a driver opens: servo, IMU."""
        return self.lines[0].path, self.lines[1].path


def open_rig(
    fish: Fish, key: bytes, robot: tuple[str, int], target: tuple[float, float], seed: int = 0
) -> Rig:
    """A rig whose laptop sends to a robot's address; the fish starts in the pool's middle."""
    shaft = PlantShaft(fish=fish)
    made = link.bind("127.0.0.1", 0)
    laptop = Laptop(key, made, robot, target, np.random.default_rng(seed))
    return Rig(shaft, Dynamixel(shaft=shaft), Bno055(), (open_line(), open_line()), laptop)


def serve(rig: Rig, stop: Callable[[], bool]) -> None:
    """In real time, until `stop` says so."""
    masters = {rig.lines[0].master: _servo, rig.lines[1].master: _imu}
    awaited: list[int | socket.socket] = [*masters, rig.laptop.socket]
    while not stop():
        ready, _, _ = select.select(awaited, [], [], 0.001)
        now = time.monotonic()
        rig.servo.now = max(rig.servo.now, now - rig.began - LONGEST)
        rig.servo.advance(now - rig.began)
        rig.imu.rates = (0.0, 0.0, float(rig.shaft.state.v[0, 2]))
        rig.laptop.work(now, rig.shaft.pose)
        for master, answer in masters.items():
            if master in ready:
                answer(rig, master)


def _servo(rig: Rig, master: int) -> None:
    data = os.read(master, 1024)
    reply = rig.servo.answer(data) if hears(rig.servo, rig.lines[0]) else b""
    time.sleep(10 * (len(data) + len(reply)) / BAUD)
    os.write(master, reply)


def _imu(rig: Rig, master: int) -> None:
    data = os.read(master, 256)
    os.write(master, rig.imu.answer(data))  # its wire time would hold up the servo's


def close_rig(rig: Rig) -> None:
    """Pull every cable."""
    for line in rig.lines:
        close_line(line)
    rig.laptop.socket.close()
