"""What sees the emulated fish from above: a station that sends poses, or a camera that films."""

import socket
import time
from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tailbeat.emulators.broken import DRIFT, TrackerFaults
from tailbeat.emulators.camera import Scene
from tailbeat.emulators.camera_process import CameraProcess
from tailbeat.emulators.plant_shaft import PlantShaft
from tailbeat.env.sensors import SensorModel
from tailbeat.fish.outline import outline
from tailbeat.link.datagrams import Frame
from tailbeat.link.sender import Sender

Array = NDArray[np.float64]
SECOND = 1_000_000_000
CLOCK_AHEAD, CLOCK_FAST = 37 * SECOND, 20e-6  # the station's clock relative to the fish's
SHOWN = 0.004  # s between two scenes for the camera


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
            late += shaft.mistakes.lab.errors.late
            self.ahead.append((now + late, self._film(shaft, now)))
        while self.ahead and self.ahead[0][0] <= now:
            self.sender.show(self.ahead.popleft()[1])
        self.sender.work(now)

    def close(self) -> None:
        """Close the socket."""
        self.socket.close()

    def _film(self, shaft: PlantShaft, now: float) -> Frame:
        model, rng, mistakes = self.model, self.rng, shaft.mistakes
        pose = mistakes.filmed(shaft.pose)
        noise = rng.normal(size=3) * [model.position_noise, model.position_noise, model.yaw_noise]
        seen = rng.uniform() >= model.dropped and not mistakes.hidden(now - shaft.began)
        since = max(time.monotonic() - self.faults.drifting, 0.0)
        x, y, yaw = (pose + noise + self.shifted + since * np.array(DRIFT)).tolist()
        return self._faulty((x, y, yaw), mistakes.seen(self.tag), seen)

    def _faulty(
        self, pose: tuple[float, float, float], target: tuple[float, float], seen: bool
    ) -> Frame:
        """A frame, with the faults of the tracker."""
        faults, (tx, ty) = self.faults, target
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
    ahead: deque[tuple[float, Scene]] = field(default_factory=deque)  # time to show, scene

    def work(self, now: float, shaft: PlantShaft) -> None:
        """Update the scene several times per frame; a late camera's later."""
        if now < self.due:
            return
        self.due = now + SHOWN
        late = shaft.mistakes.lab.errors.late
        self.ahead.append((now + late, self._scene(shaft, now - shaft.began)))
        while self.ahead and self.ahead[0][0] <= now:
            self.camera.show(self.ahead.popleft()[1])

    def _scene(self, shaft: PlantShaft, seconds: float) -> Scene:
        """What the camera films: the tag as it is glued; while frames are lost, no tag of the
        fish."""
        q, v, mistakes = shaft.state.q[0], shaft.state.v[0], shaft.mistakes
        x, y, yaw = mistakes.tag(shaft.pose).tolist()
        speed = float(v[0]), float(v[1]), float(v[2])
        fish = None if mistakes.hidden(seconds) else (x, y, yaw)
        return Scene(fish, speed, outline(shaft.fish, q), (*self.tag, 0.0))

    def close(self) -> None:
        """End the camera."""
        self.camera.close()
