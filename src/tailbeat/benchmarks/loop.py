"""Punctuality of the robot's loop on this machine, with emulated devices."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tailbeat.emulators.own_devices import own_devices
from tailbeat.link.status import State
from tailbeat.processes import temporary
from tailbeat.robot.log import read_rows
from tailbeat.robot.results import DriveResult
from tailbeat.robot.session import DriveConfig, drive

MINUTE = 60.0


@dataclass(frozen=True)
class LatencyResult:
    """The drive's result, and how often it went to HOLD and was armed again. `drift_ms`: how much
    later the last tenth of its periods began than the first tenth [ms], median."""

    drive: DriveResult
    armed_anew: int
    drift_ms: float


def latency(
    policy: str, fish: str, minutes: float, seed: int, say: Callable[[str], None]
) -> LatencyResult:
    """Drive emulated devices for `minutes` and time the loop. After a HOLD it is armed again and
    counted."""
    holds = [0]

    def each(own: Any) -> None:
        if own.safety_status.state is State.HOLD:
            holds[0] += own.arm(time.monotonic()).state is State.ARMED

    with temporary() as folder:
        log = Path(folder) / "latency.mcap"
        with own_devices(fish, seed) as (ports, key):
            config = DriveConfig(policy, ports, key, log, seconds=MINUTE * minutes, fish=fish)
            told = drive(config, say, each)
        rows = read_rows(log)
    late = 1e3 * np.array([row["late_s"] for row in rows])
    tenth = max(late.size // 10, 1)
    drift = float(np.median(late[-tenth:]) - np.median(late[:tenth]))
    return LatencyResult(told, holds[0], drift)
