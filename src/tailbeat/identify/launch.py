"""Swims that begin with a velocity: how a recording states it, and whether the twin recovers.

A recording states `launch: surge sway yaw-rate` [m/s, m/s, rad/s] in its metadata. This is the
velocity of the fish frame at the first sample, in the fish frame. In a lab the fish is pushed, or
released from a moving carriage; the virtual pool sets the velocity.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.files import BadInput
from tailbeat.fish.description import Fish, length_of
from tailbeat.fish.rollout import Start, Swim, replay_command, swim
from tailbeat.fish.twin import Options, compile_twin
from tailbeat.identify.protocol import largest, limits
from tailbeat.recording import Recording

Array = NDArray[np.float64]
KEY = "launch"
LENGTHS = 2.0  # body lengths per second: no fish of this kind moves faster (chosen)
TURNING = 10.0  # rad/s
LAUNCHES = (0.0, 0.03, -0.03, -0.1, -0.3)  # m/s, of the check
SECONDS, JUDGED = 12.0, 2.0  # s of each swim, and the last part that is measured


def launch_of(recording: Recording, fish: Fish) -> Array | None:
    """Surge, sway [m/s] and yaw rate [rad/s] at the start (3,), None if the recording has no such
    metadata.

    Raises BadInput for text that is not three numbers, or a launch faster than the fish could move.
    """
    text = recording.meta.get(KEY)
    if text is None:
        return None
    try:
        launch = np.array([float(word) for word in text.split()])
    except ValueError:
        launch = np.empty(0)
    if launch.shape != (3,) or not np.isfinite(launch).all():
        raise BadInput(
            f"{recording.name}: {KEY} = {text!r}; give surge and sway [m/s] and yaw rate [rad/s],"
            f" such as '-0.1 0 0'."
        )
    _check_launch(recording.name, launch, length_of(fish))
    return launch


def _check_launch(name: str, launch: Array, length: float) -> None:
    fastest = LENGTHS * length
    if max(abs(launch[:2])) > fastest or abs(launch[2]) > TURNING:
        raise BadInput(
            f"{name}: {KEY} = {launch[0]:g} {launch[1]:g} {launch[2]:g} is faster than the fish"
            f" could move; allowed are {fastest:.2g} m/s (two body lengths per second) and"
            f" {TURNING:g} rad/s. Check the units."
        )


# ---- does the twin recover? ---------------------------------------------------------------------


@dataclass(frozen=True)
class Launched:
    """One swim of the check: beat `frequency` [Hz] and `stroke` [rad] of the motor (None: a crank
    that turns), initial velocity `launch` along the heading [m/s], and final `speed` [m/s], NaN if
    the twin diverged."""

    frequency: float
    stroke: float | None
    launch: float
    speed: float


def gaits(fish: Fish, recorded: Sequence[float] = ()) -> list[tuple[float, float | None]]:
    """Six steady beats (frequency [Hz], stroke [rad], None for a crank) over the `recorded`
    frequencies [Hz], of which NaN does not count; without any, over the fish's band from a quarter
    of its upper edge."""
    known = [rate for rate in recorded if np.isfinite(rate)]
    beats = np.clip(known or [max(fish.band[0], fish.band[1] / 4), fish.band[1]], *fish.band)
    chosen = np.geomspace(beats.min(), beats.max(), 6)
    if fish.motor.range is None:
        return [(float(rate), None) for rate in chosen]
    limit = limits(fish)
    return [(float(rate), 0.7 * largest(limit, float(rate))) for rate in chosen]


def check_launches(
    fish: Fish, gaits: Sequence[tuple[float, float | None]], launches: Sequence[float] = LAUNCHES
) -> list[Launched]:
    """Swim every gait (frequency [Hz], stroke [rad] or None) from every launch velocity [m/s], with
    the motor replayed."""
    twin = compile_twin(fish, Options(replayed=True))
    step = twin.model.opt.timestep
    time = np.arange(0, SECONDS, step)
    cases = [(gait, launch) for gait in gaits for launch in launches]
    angles = [_angle(time, *gait) for gait, _ in cases]
    starts = [
        Start(np.zeros(3), np.array([launch, 0, 0]), angle[0], (angle[1] - angle[0]) / step)
        for (_, launch), angle in zip(cases, angles, strict=True)
    ]
    commands = [replay_command(twin, angle) for angle in angles]
    done = swim([twin] * len(cases), starts, commands, max(round(0.02 / step), 1))
    return [
        Launched(*gait, launch, _last_speed(one))
        for (gait, launch), one in zip(cases, done, strict=True)
    ]


def _angle(time: Array, frequency: float, stroke: float | None) -> Array:
    phase = 2 * np.pi * frequency * time
    return phase if stroke is None else stroke * np.sin(phase)


def _last_speed(done: Swim) -> float:
    """Mean velocity along the mean heading over the last seconds; NaN if it diverged."""
    if done.diverged:
        return float("nan")
    last = done.time >= done.time[-1] - JUDGED
    pose = done.qpos[last, :3]
    way, yaw = pose[-1, :2] - pose[0, :2], pose[:, 2].mean()
    return float(way @ [np.cos(yaw), np.sin(yaw)] / np.ptp(done.time[last]))


def stuck(checks: Sequence[Launched], least: float = 0.0) -> list[Launched]:
    """The swims whose final speed is not above `least` [m/s], with the diverged ones."""
    return [one for one in checks if not one.speed > least]


def tables(fish: Fish) -> dict[str, list[dict[str, Any]]]:
    """The check over the fish's band, as rows."""
    return {"launches": [asdict(one) for one in check_launches(fish, gaits(fish))]}
