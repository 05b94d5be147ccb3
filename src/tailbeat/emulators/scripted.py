"""A scripted fish that swims in circles and a target that drifts, for the virtual camera."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.control.observation import wrapped
from tailbeat.emulators.camera import Scene
from tailbeat.emulators.camera_process import start_camera
from tailbeat.emulators.film import filming_of
from tailbeat.fish.outline import outline
from tailbeat.fish.store import load_fish
from tailbeat.link.places import POOL
from tailbeat.processes import told_to_end

Array = NDArray[np.float64]
Say = Callable[[str], None]
MARGIN = 0.15  # m, least distance of a tag's middle from a wall


@dataclass(frozen=True)
class ScriptedSwim:
    """A swim over the whole pool: a Lissajous figure with a beating head, and a target that drifts.
    Positions in metres, times in seconds."""

    seconds: float = 60.0  # of one round
    pool: tuple[float, float] = POOL

    def fish(self, time: float) -> Array:
        """x, y, yaw of the fish's tag."""
        u = 2 * np.pi * time / self.seconds
        reach = np.array(self.pool) / 2 - MARGIN
        place = reach * [np.sin(3 * u), np.sin(7 * u + 0.4)]
        along = reach * [3 * np.cos(3 * u), 7 * np.cos(7 * u + 0.4)]
        beat = 0.15 * np.sin(2 * np.pi * 2.0 * time)
        return np.append(place, np.arctan2(along[1], along[0]) + beat)

    def scene(self, time: float, line: Array | None = None) -> Scene:
        """The scene at `time` [s]; `line` is the fish's line in its tag's frame."""
        pose, later = self.fish(time), self.fish(time + 1e-3)
        change = later - pose
        change[2] = wrapped(change[2])
        length, width = self.pool
        place = [0.45 * length * np.sin(0.31 * time), 0.42 * width * np.cos(0.23 * time)]
        target = (*place, 0.3 * time % (2 * np.pi))
        return Scene(three(pose), three(change / 1e-3), placed(line, pose), three(target))


def three(numbers: Any) -> tuple[float, float, float]:
    """Three numbers of an array."""
    x, y, yaw = map(float, numbers)
    return x, y, yaw


def placed(line: Array | None, pose: Array) -> Array | None:
    """Transform a line (k, 2) [m] from the tag's frame to the world."""
    if line is None:
        return None
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return np.asarray(pose[:2] + line @ np.array([[c, s], [-s, c]]))


def fish_line(name: str = "pulley-fish") -> Array:
    """A straight fish from nose to tail (k, 2) [m], in its tag's frame."""
    fish = load_fish(name)
    straight = outline(fish, np.zeros(4 + len(fish.tail.links)))
    return np.asarray(straight - np.array(fish.tracked[:2]))


def film(
    socket: Path, fish: str, pool: tuple[float, float], seconds: float, seed: int, say: Say
) -> None:
    """Film a scripted fish in a pool [m] with a virtual camera at a socket, for `seconds` (0: until
    told to stop)."""
    scripted, drawn = ScriptedSwim(pool=pool), fish_line(fish)
    camera = start_camera(socket, filming_of(load_fish(fish), pool, seed))
    ended = told_to_end()
    say(f"filming at {camera.where}")
    began = time.monotonic()
    while not ended and not (seconds and time.monotonic() - began >= seconds):
        camera.show(scripted.scene(time.monotonic() - began, drawn))
        time.sleep(0.004)
    camera.close()
