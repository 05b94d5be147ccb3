"""All devices without hardware: plant, emulated servo and IMU on pseudo-terminals, poses.

To a robot's loop, this process is the same as a lab. The plant turns the servo's shaft and the IMU.
The station sends signed poses at sixty frames a second on its own clock: late, noisy, and sometimes
without a tag. Or a camera films the plant, and another process finds the poses.
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

from tailbeat.emulators import imu_rvc
from tailbeat.emulators.broken import DRIFT, Broken, TrackerFaults
from tailbeat.emulators.camera import Scene
from tailbeat.emulators.camera_process import CameraProcess
from tailbeat.emulators.feetech import Feetech
from tailbeat.emulators.imu import Bno055, up_of
from tailbeat.emulators.imu_rvc import Bno085
from tailbeat.emulators.line import Line, close_line, open_line
from tailbeat.emulators.servo import Dynamixel, Shaft, hears
from tailbeat.env.sensors import SensorModel
from tailbeat.files import BadInput
from tailbeat.fish.description import Fish
from tailbeat.fish.outline import outline
from tailbeat.fish.store import hardware_of
from tailbeat.identify.runs import tracked_pose
from tailbeat.link import datagrams as link
from tailbeat.link.datagrams import Frame
from tailbeat.link.places import POOL
from tailbeat.link.sender import Sender
from tailbeat.pool.plant import Surroundings, at_rest, build_plant, step_plant
from tailbeat.pool.water import Water

Array = NDArray[np.float64]
SECOND = 1_000_000_000
CLOCK_AHEAD, CLOCK_FAST = 37 * SECOND, 20e-6  # the station's clock relative to the fish's
BAUD = 1_000_000
SHOWN = 0.004  # s between two scenes for the camera
IMUS = {"bno055": Bno055, "bno085": Bno085}
LONGEST = 0.2  # s, most time stepped at once; a rig that was stopped does not catch up


@dataclass(eq=False)
class PlantShaft(Shaft):
    """The servo's shaft in the plant: setpoint in, angle and velocity out."""

    fish: Fish = field(kw_only=True)
    water: Water = field(default_factory=Water, kw_only=True)
    broken: Broken = field(default_factory=Broken, kw_only=True)

    def __post_init__(self) -> None:
        around = [Surroundings(walls=POOL)]
        self.plant = build_plant(self.fish, [self.water], around=around)
        self.state, self.gain, self.owed = (
            at_rest(self.plant),
            float(self.plant.servo["kp"][0]),
            0.0,
        )

    def advance(self, goal: float | None, dt: float) -> None:
        """Step the plant by `dt` [s]; without torque (`goal` None) the servo's gain is 0."""
        broken = self.broken
        self.plant.servo["kp"][0] = 0.0 if goal is None else self.gain
        share = (-1 if broken.reversed else 1) * broken.slipping
        self.owed += dt
        steps = int(self.owed / self.plant.dt)
        if steps:
            self.owed -= steps * self.plant.dt
            turned = np.full((1, steps), share * broken.stroke * (goal or 0.0))
            step_plant(self.plant, self.state, turned, steps)
        self.angle = float(self.state.q[0, 3]) / share
        self.velocity = float(self.state.v[0, 3]) / share

    def put(self, tag: tuple[float, float, float]) -> None:
        """Put the fish where its tag has this pose: x, y [m], yaw [rad]."""
        self.state.q[0, :3] = 0.0, 0.0, tag[2]
        ahead = self.pose[:2]
        self.state.q[0, :2] = tag[0] - ahead[0], tag[1] - ahead[1]

    def snap(self) -> None:
        """Cut the tendons: motor and tail turn freely of each other."""
        tendon = self.plant.own.tendon
        tendon["stiffness"][0] = tendon["damping"][0] = 0.0

    def hold(self) -> None:
        """Clamp the head where it is."""
        self.state.v[0, :3] = self.state.a[0, :3] = 0.0  # a clamp keeps a velocity, however small
        self.plant.each.held[0] = True

    @property
    def pose(self) -> Array:
        """Pose of the tag: x, y [m], yaw [rad]."""
        return tracked_pose(self.fish, self.state.q[0, :3])


@dataclass(eq=False)
class Station:
    """The station's sender with a camera model that sees the plant: late, noisy, sometimes nothing.
    `tag` is the target's position, `due` [s] the time of the next frame."""

    sender: Sender
    tag: tuple[float, float]
    rng: np.random.Generator
    model: SensorModel = field(default_factory=SensorModel)
    due: float = 0.0
    stepped: float = 0.0  # s by which its clock was set ahead
    shifted: tuple[float, float, float] = (0.0, 0.0, 0.0)  # error of its tracker
    faults: TrackerFaults = field(default_factory=TrackerFaults)
    ahead: deque[tuple[float, Frame]] = field(default_factory=deque)  # time to send, frame

    def clock(self) -> int:
        """The station's own monotonic clock [ns], with an offset and a drift to the fish's."""
        set_ahead = CLOCK_AHEAD + round(self.stepped * SECOND)
        return round(time.monotonic_ns() * (1 + CLOCK_FAST)) + set_ahead

    @property
    def socket(self) -> socket.socket:
        """The socket on which it receives."""
        return self.sender.socket

    @property
    def fish(self) -> tuple[str, int]:
        """The address to which it sends."""
        return self.sender.fish

    def work(self, now: float, shaft: PlantShaft) -> None:
        """Take a frame when it is due, send frames whose latency is over, receive from the fish."""
        if now >= self.due:
            self.due = max(self.due + 1 / self.model.frame_rate, now)
            late = self.model.latency + self.model.latency_jitter * self.rng.uniform()
            self.ahead.append((now + late, self._film(shaft.pose)))
        while self.ahead and self.ahead[0][0] <= now:
            self.sender.show(self.ahead.popleft()[1])
        self.sender.work(now)

    def close(self) -> None:
        """Close the socket."""
        self.socket.close()

    def _film(self, pose: Array) -> Frame:
        model, rng = self.model, self.rng
        noise = rng.normal(size=3) * [model.position_noise, model.position_noise, model.yaw_noise]
        seen = rng.uniform() >= model.dropped
        since = max(time.monotonic() - self.faults.drifting, 0.0)
        x, y, yaw = (pose + noise + self.shifted + since * np.array(DRIFT)).tolist()
        return self._faulty((x, y, yaw), seen)

    def _faulty(self, pose: tuple[float, float, float], seen: bool) -> Frame:
        """A frame, with the faults of the tracker."""
        faults, (tx, ty) = self.faults, self.tag
        tx, ty = (np.array([tx, ty]) + faults.jumping * self.rng.uniform(-1, 1, 2)).tolist()
        if faults.mirrored:
            pose, ty = (pose[0], -pose[1], -pose[2]), -ty
        if np.isfinite(at := faults.mirrored_at):
            pose, tx = (2 * at - pose[0], *pose[1:]), 2 * at - tx
        if faults.frozen:
            pose = faults.last
        faults.last = pose
        return Frame(self.clock(), pose if seen else None, (tx, ty))


@dataclass(eq=False)
class Above:
    """A camera above the pool instead of a station: it films the plant, and another process must
    find the fish in its pictures. `tag` is the target's position."""

    camera: CameraProcess
    tag: tuple[float, float]
    due: float = 0.0

    def work(self, now: float, shaft: PlantShaft) -> None:
        """Update the scene several times per frame."""
        if now < self.due:
            return
        self.due = now + SHOWN
        q, v, (x, y, yaw) = shaft.state.q[0], shaft.state.v[0], shaft.pose.tolist()
        line = outline(shaft.fish, q)
        speed = float(v[0]), float(v[1]), float(v[2])
        self.camera.show(Scene((x, y, yaw), speed, line, (*self.tag, 0.0)))

    def close(self) -> None:
        """End the camera."""
        self.camera.close()


@dataclass(eq=False)
class Rig:
    """Everything together; see `open_rig` and `serve`."""

    shaft: PlantShaft
    servo: Dynamixel | Feetech
    imu: Bno055 | Bno085
    lines: tuple[Line, Line]  # of servo and IMU
    watch: Station | Above
    began: float = field(default_factory=time.monotonic)
    imu_up: int = 1  # -1: it is mounted upside down
    imu_bias: float = 0.0  # rad/s
    imu_biased: float = 0.0  # s, since when

    @property
    def ports(self) -> tuple[str, str]:
        """Ports of servo and IMU for the drivers."""
        return self.lines[0].path, self.lines[1].path

    @property
    def station(self) -> Station:
        """The station; a filmed rig has none."""
        assert isinstance(self.watch, Station)
        return self.watch


def open_rig(
    fish: Fish,
    key: bytes,
    robot: tuple[str, int],
    target: tuple[float, float],
    seed: int = 0,
    imu: str = "bno055",
) -> Rig:
    """Open a rig whose station sends to a robot's address; the fish starts in the pool's middle.
    `imu` is one of `IMUS`. Raises BadInput."""
    shaft = PlantShaft(fish=fish)
    made = link.bind("127.0.0.1", 0)
    station = Station(Sender(key, made, robot), target, np.random.default_rng(seed))
    station.sender.clock = station.clock
    sensor = imu_of(fish, imu)
    return Rig(shaft, _servo_of(fish, shaft), sensor, (open_line(), open_line()), station)


def open_filmed_rig(
    fish: Fish, camera: CameraProcess, target: tuple[float, float], imu: str = "bno055"
) -> Rig:
    """Open a rig that gives pictures instead of poses. Raises BadInput."""
    shaft, sensor = PlantShaft(fish=fish), imu_of(fish, imu)
    above = Above(camera, target)
    return Rig(shaft, _servo_of(fish, shaft), sensor, (open_line(), open_line()), above)


def imu_of(fish: Fish, kind: str) -> Bno055 | Bno085:
    """The fish's IMU, mounted as its file says. Raises BadInput."""
    if kind not in IMUS:
        raise BadInput(f"--imu {kind}: allowed for emulated devices are {', '.join(IMUS)}.")
    return IMUS[kind](up=up_of(hardware_of(fish)))


def _servo_of(fish: Fish, shaft: PlantShaft) -> Dynamixel | Feetech:
    """The fish's servo, as its hardware says."""
    hardware = hardware_of(fish)
    family = Feetech if hardware.family.startswith("feetech") else Dynamixel
    return family(shaft=shaft, hardware=hardware)


def serve(rig: Rig, stop: Callable[[], bool]) -> None:
    """Serve in real time until `stop` returns True; it is called about a thousand times a
    second."""
    masters = {rig.lines[0].master: _servo, rig.lines[1].master: _imu}
    awaited: list[int | socket.socket] = [*masters]
    if isinstance(rig.watch, Station):
        awaited.append(rig.watch.socket)
    while not stop():
        ready, _, _ = select.select(awaited, [], [], 0.001)
        now = time.monotonic()
        rig.servo.now = max(rig.servo.now, now - rig.began - LONGEST)
        rig.servo.advance(now - rig.began)
        yaw, rate = float(rig.shaft.state.q[0, 2]), float(rig.shaft.state.v[0, 2])
        drifted = rig.imu_bias * max(now - rig.imu_biased, 0.0) if rig.imu_bias else 0.0
        rig.imu.turn(rig.imu_up * yaw + drifted, rig.imu_up * rate + rig.imu_bias)
        imu_rvc.send(rig.lines[1], rig.imu.speak(now))
        rig.watch.work(now, rig.shaft)
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
    os.write(master, rig.imu.answer(data))  # waiting for its wire would delay the servo


def close_rig(rig: Rig) -> None:
    """Close all lines."""
    for line in rig.lines:
        close_line(line)
    rig.watch.close()
