"""Recordings made by a twin with known coefficients, as a lab would record them."""

import numpy as np

from tailbeat.fish.description import Fish
from tailbeat.fish.rollout import Start, replay_command, swim
from tailbeat.fish.twin import Options, compile_twin
from tailbeat.identify.tag_pose import tracked_pose
from tailbeat.recording import Recording


def record(fish: Fish, name: str, frequency: float, amplitude: float, **options) -> Recording:
    """A swim from rest on a slowly swept sine of the motor angle, filmed at 60 fps.

    `noise` is the standard deviation of position [m] (of heading, three times that in rad);
    `offset` [rad] bends the swim into a turn; `seconds` is its length.
    """
    seconds = options.get("seconds", 5.0)
    clock = clock_of(fish, seconds)
    phase = 2 * np.pi * frequency * clock * (1 + 0.15 * clock / seconds)
    ramp = np.square(np.minimum(1.0, clock * frequency))
    angle = ramp * (options.get("offset", 0.0) + amplitude * np.sin(phase))
    return filmed(fish, name, angle, **options)


def clock_of(fish: Fish, seconds: float) -> np.ndarray:
    """Times [s] of the motor angles that `filmed` needs for a swim of so many seconds."""
    return np.arange(0, seconds + 0.1, fish.simulation.step)


def filmed(fish: Fish, name: str, angle: np.ndarray, **options) -> Recording:
    """A swim from rest on given motor angles [rad] at `clock_of`; options as in `record`."""
    seconds, noise = options.get("seconds", 5.0), options.get("noise", 0.0)
    twin = compile_twin(fish, Options(replayed=True))
    done = swim([twin], [Start.at_rest()], [replay_command(twin, angle)], 1)[0]
    pose = tracked_pose(fish, done.qpos[:, :3])
    film = np.arange(0, seconds, 1 / 60)
    rng = np.random.default_rng(options.get("seed", 0))

    def seen(values: np.ndarray, spread: float) -> np.ndarray:
        return np.interp(film, done.time, values) + rng.normal(0, spread, film.size)

    columns = {
        "motor_angle_rad": seen(done.qpos[:, twin.motor], 0.0),
        "x_m": seen(pose[:, 0], noise),
        "y_m": seen(pose[:, 1], noise),
        "yaw_rad": seen(pose[:, 2], 3 * noise),
    }
    return Recording(name, film, columns)
