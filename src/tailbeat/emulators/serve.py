"""Serve emulated devices in real time until told to stop."""

import gc
import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tailbeat.emulators import rig as bench
from tailbeat.emulators.camera_process import start_camera
from tailbeat.emulators.film import filming_of
from tailbeat.files import BadInput
from tailbeat.fish.store import load_fish
from tailbeat.link.addresses import address
from tailbeat.link.datagrams import read_key
from tailbeat.link.places import POOL, place, pose
from tailbeat.operator.client import announce, open_page, turn
from tailbeat.pool.mess import Lab, lab_at
from tailbeat.processes import told_to_end
from tailbeat.robot import timing

Say = Callable[[str], None]


@dataclass(frozen=True)
class Emulated:
    """Emulated devices: of which `fish`, with the target at `target`, drawn from `seed`, with which
    `imu`. The tag starts at `start`, x,y,heading [m, m, deg]; default: the pool's middle. `mess`:
    what the lab gets wrong. `pool`: its length and width [m]."""

    fish: str
    target: str
    seed: int
    imu: str = "bno055"
    start: str = ""
    mess: str = "clean"
    pool: tuple[float, float] = POOL

    @property
    def lab(self) -> Lab:
        """What is wrong with it, drawn from the seed. Raises BadInput."""
        return lab_at(self.mess, self.seed)


def rig(devices: Emulated, key: Path, robot: str, page: str, say: Say) -> None:
    """Serve emulated devices until told to stop; `say` gets the ports as one line of JSON. Raises
    BadInput."""
    there, aim = address(robot, "--robot"), place(devices.target, pool=devices.pool)
    start = _start(devices)
    described, secret = load_fish(devices.fish), read_key(key)
    client = open_page(page, devices.pool)
    made = bench.open_rig(
        described, secret, there, aim, devices.seed, devices.imu, devices.lab, devices.pool
    )
    if start is not None:
        made.shaft.put(start)
    ended = told_to_end()
    _hurry(made)
    host, port = made.station.socket.getsockname()
    ports = {"servo": made.ports[0], "imu": made.ports[1], "station": f"{host}:{port}"}
    say(json.dumps({**ports, "page": announce(client) if client else []}))

    def over() -> bool:
        if client is not None:
            turn(client, made.station.sender, described, time.monotonic())
        return bool(ended)

    try:
        bench.serve(made, over)
    finally:
        bench.close_rig(made)
        if client is not None:
            client.close()


def filmed_rig(devices: Emulated, camera: Path, say: Say) -> None:
    """Serve emulated devices with a camera at a socket instead of poses, until told to stop; `say`
    gets the ports as one line of JSON. Raises BadInput."""
    described, aim = load_fish(devices.fish), place(devices.target, pool=devices.pool)
    start, lab = _start(devices), devices.lab
    bench.imu_of(described, devices.imu)  # refused before the camera starts
    eye = start_camera(camera, filming_of(described, devices.pool, devices.seed))
    try:
        made = bench.open_filmed_rig(
            described, eye, aim, devices.seed, devices.imu, lab, devices.pool
        )
        if start is not None:
            made.shaft.put(start)
        ended = told_to_end()
        _hurry(made)
    except BadInput:
        eye.close()  # else its socket stays
        raise
    say(json.dumps({"servo": made.ports[0], "imu": made.ports[1], "camera": eye.where}))
    try:
        bench.serve(made, lambda: bool(ended))
    finally:
        bench.close_rig(made)


def _start(devices: Emulated) -> tuple[float, float, float] | None:
    """Where the tag starts, if it was given. Raises BadInput."""
    return pose(devices.start, pool=devices.pool) if devices.start else None


def _hurry(made: Any) -> None:
    """Compile in advance and switch garbage collection off, because both would delay the bus: late
    emulated devices look like a late servo."""
    timing.claim(timing.BESIDE)
    made.shaft.advance(0.0, 0.01)
    _ = made.shaft.pose
    gc.freeze()
    gc.disable()
