"""All devices without hardware: plant, emulated servo and IMU on pseudo-terminals, poses.

To a robot's loop, this process is the same as a lab. The plant turns the servo's shaft and the IMU.
The station sends signed poses at sixty frames a second on its own clock: late, noisy, and sometimes
without a tag. Or a camera films the plant, and another process finds the poses.
"""

import os
import select
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tailbeat.emulators import imu_rvc
from tailbeat.emulators.camera_process import CameraProcess
from tailbeat.emulators.feetech import Feetech
from tailbeat.emulators.imu import Bno055, up_of
from tailbeat.emulators.imu_rvc import Bno085
from tailbeat.emulators.line import Line, close_line, open_line
from tailbeat.emulators.mistakes import Mistakes
from tailbeat.emulators.plant_shaft import PlantShaft
from tailbeat.emulators.servo import Dynamixel, hears
from tailbeat.emulators.watchers import Above, Station
from tailbeat.files import BadInput
from tailbeat.fish.description import Fish
from tailbeat.fish.store import hardware_of
from tailbeat.link import datagrams as link
from tailbeat.link.places import POOL
from tailbeat.link.sender import Sender
from tailbeat.pool.mess import AS_DESCRIBED, Lab

Array = NDArray[np.float64]
BAUD = 1_000_000
IMUS = {"bno055": Bno055, "bno085": Bno085}
LONGEST = 0.2  # s, most time stepped at once; a rig that was stopped does not catch up


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
    lab: Lab = AS_DESCRIBED,
    pool: tuple[float, float] = POOL,
) -> Rig:
    """Open a rig whose station sends to a robot's address; the fish starts in the middle of a pool
    of this length and width [m]. `imu` is one of `IMUS`, `lab` what is wrong with it. Raises
    BadInput."""
    shaft = PlantShaft(fish=fish, pool=pool, mistakes=Mistakes(lab, seed))
    made = link.bind("127.0.0.1", 0)
    station = Station(Sender(key, made, robot, pool=pool), target, np.random.default_rng(seed))
    station.sender.clock = station.clock
    sensor = imu_of(fish, imu)
    return Rig(shaft, _servo_of(fish, shaft), sensor, (open_line(), open_line()), station)


def open_filmed_rig(
    fish: Fish,
    camera: CameraProcess,
    target: tuple[float, float],
    seed: int = 0,
    imu: str = "bno055",
    lab: Lab = AS_DESCRIBED,
    pool: tuple[float, float] = POOL,
) -> Rig:
    """Open a rig that gives pictures instead of poses. Raises BadInput."""
    shaft = PlantShaft(fish=fish, pool=pool, mistakes=Mistakes(lab, seed))
    sensor = imu_of(fish, imu)
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
        turned, turning = rig.shaft.mistakes.gyro(now - rig.began)
        heading, turns = rig.imu_up * yaw + drifted + turned, rig.imu_up * rate + rig.imu_bias
        rig.imu.turn(heading, turns + turning)
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
