"""Command recordings that the test bench plays for tail, servo and pool.

All commands stay inside the motor's range and below a shaft speed; they begin and end at rest.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tailbeat.files import BadInput
from tailbeat.fish.description import Fish
from tailbeat.fish.period import PERIOD
from tailbeat.recording import Recording

Array = NDArray[np.float64]
RATE = 1 / PERIOD  # Hz: the robot's own loop
SHARE = 0.9  # fraction of the motor's range that is used
HELD_OUT_SERVO = ("servo-mixed", "servo-beat")
USUAL_SPEED = 4.0  # rad/s
EVERY = 3  # every third swim is held out of an identification


@dataclass(frozen=True)
class ServoLimits:
    """Limits of the commands: largest `angle` about `centre` [rad], and shaft `speed` [rad/s]."""

    angle: float
    centre: float
    speed: float


def limits(fish: Fish, speed: float | None = None) -> ServoLimits:
    """The fish's limits. `speed` [rad/s] is by default what the described servo can do.

    Raises BadInput for a motor without a range (a crank, which turns without end) and for a speed
    that is not above 0.
    """
    if fish.motor.range is None:
        raise BadInput(
            f"{fish.name}: a {fish.motor.kind} without motor.range cannot swing to both sides; give"
            f" its range of angles, or record free swims at constant motor speeds."
        )
    if speed is not None and not speed > 0:
        raise BadInput(f"--speed {speed:g}: give a shaft speed above 0 [rad/s].")
    low, high = fish.motor.range
    fast = shaft_speed(fish) if speed is None else speed
    return ServoLimits(SHARE * (high - low) / 2, (high + low) / 2, fast)


def shaft_speed(fish: Fish) -> float:
    """A shaft speed [rad/s] that the described servo reaches under load.

    4 rad/s, as for an X430 (no-load 5.5 rad/s at 12 V); 60 % of the no-load speed of a faster
    servo, and 84 % at most of a slower one's. The shares are chosen.
    """
    servo = fish.servos[fish.servo]
    drag = servo.damping + servo.kv
    if drag == 0:
        return USUAL_SPEED
    no_load = servo.force_limit / drag
    return min(max(USUAL_SPEED, 0.6 * no_load), 0.84 * no_load)


def largest(limit: ServoLimits, frequency: float) -> float:
    """Largest stroke [rad] of a sine of `frequency` [Hz] that respects both limits."""
    return min(limit.angle, limit.speed / (2 * np.pi * frequency))


def tail_sweep(
    fish: Fish,
    limit: ServoLimits,
    frequencies: Sequence[float] = (),
    strokes: int = 4,
    beats: int = 10,
) -> Recording:
    """Sines at `frequencies` [Hz] (default: four over the fish's band), each at several strokes of
    `beats` beats, with rests between.

    The smallest stroke is a third of the largest: Im H falls with the stroke, and this shows
    Coulomb friction. The labels are in `condition`.
    """
    chosen = frequencies or np.geomspace(fish.band[0], fish.band[1], 4)
    parts = [("rest", np.zeros(int(RATE)))]
    for frequency in chosen:
        for stroke in np.linspace(1 / 3, 1, strokes) * largest(limit, frequency):
            label = f"{frequency:.2f} Hz {np.degrees(stroke):.0f} deg"
            parts += [(label, _sine(frequency, stroke, beats)), ("rest", np.zeros(int(RATE)))]
    return _joined("tail-sweep", parts, limit, "tail sweep: shaft driven, torque measured, in air")


def tail_static(limit: ServoLimits, period: float = 30.0, cycles: int = 3) -> Recording:
    """A slow triangle of `cycles`, each of `period` [s]. It shows the hysteresis loop; its slope is
    not the stiffness."""
    quarters = np.concatenate([[0.0], np.tile([1.0, -1.0], cycles), [0.0]])
    times = np.concatenate([[0.0], 0.25 + 0.5 * np.arange(2 * cycles), [float(cycles)]]) * period
    triangle = np.interp(np.arange(0, times[-1], 1 / RATE), times, 0.6 * limit.angle * quarters)
    return _joined("tail-static", [("static", triangle)], limit, "slow pull, in air")


def present_name(name: str) -> str:
    """A recording's present name: names of servo recordings began with `motor-` before."""
    return f"servo-{name.removeprefix('motor-')}" if name.startswith("motor-") else name


def servo_commands(fish: Fish, limit: ServoLimits) -> dict[str, Recording]:
    """Chirp, steps, a slow triangle, and two commands for validation, by name.

    Steps reach the force limit. The chirp exceeds the servo's bandwidth (gain, armature, delay).
    The triangle shows friction. A sum of sines and a beat are for validation.
    """
    top = fish.band[1]
    time = np.arange(0, 20, 1 / RATE)
    rate = np.geomspace(0.2, 1.5 * top, time.size)
    stroke = np.minimum(0.6 * limit.angle, 1.5 * limit.speed / (2 * np.pi * rate))
    chirp = stroke * np.sin(2 * np.pi * np.cumsum(rate) / RATE)
    levels = limit.angle * np.array([0.3, -0.3, 0.8, -0.8, 0.1, -0.1, 0.9, 0.0])
    steps = np.repeat(levels, int(0.8 * RATE))
    ramp = np.interp(time, [0, 5, 15, 20], 0.8 * limit.angle * np.array([0, 1, -1, 0]))
    middle = np.sqrt(fish.band[0] * top)
    sines = [np.sin(2 * np.pi * f * time + f) for f in (0.3 * middle, 0.7 * middle, 1.6 * middle)]
    mixed = 0.5 * largest(limit, 1.6 * middle) * np.sum(sines, axis=0)
    beat = _sine(middle, largest(limit, middle), 12)
    commands = {"chirp": chirp, "steps": steps, "triangle": ramp, "mixed": mixed, "beat": beat}
    rest = np.zeros(int(RATE / 2))
    return {
        f"servo-{name}": _joined(
            f"servo-{name}", [("rest", rest), (name, command), ("rest", rest)], limit, "servo bench"
        )
        for name, command in commands.items()
    }


def fluid_runs(fish: Fish, limit: ServoLimits, seconds: float = 12.0) -> dict[str, Recording]:
    """Twelve open-loop swims of `seconds` [s] over the band, from rest, at three strokes, some of
    them turning (paper: twelve runs, 1-4 Hz)."""
    runs = {}
    for number, frequency in enumerate(np.geomspace(fish.band[0], fish.band[1], 12)):
        turn = 0.2 * limit.angle * ((0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0)[number % 8])
        share = (1.0, 0.7, 0.85)[number % 3]
        stroke = share * min(largest(limit, frequency), limit.angle - abs(turn))
        swim = _sine(frequency, stroke, max(int(seconds * frequency), 4))
        ramp = np.minimum(np.arange(swim.size) / RATE * frequency, 1.0)
        name = f"fluid-{number + 1:02d}"
        parts = [("rest", np.zeros(int(2 * RATE))), ("swim", swim + turn * ramp)]
        runs[name] = _joined(name, parts, limit, f"free swim at {frequency:.2f} Hz, from rest")
    return runs


def _sine(frequency: float, stroke: float, beats: int) -> Array:
    """Whole beats that grow and fade over one beat, so that the torque has no step at the ends."""
    time = np.arange(0, beats / frequency, 1 / RATE)
    fade = np.minimum(np.minimum(time, time[-1] - time) * frequency, 1.0)
    return np.asarray(stroke * fade * np.sin(2 * np.pi * frequency * time))


def _joined(
    name: str, parts: Sequence[tuple[str, Array]], limit: ServoLimits, purpose: str
) -> Recording:
    command = np.concatenate([values for _, values in parts])
    labels = np.concatenate([np.full(len(values), label) for label, values in parts])
    inside = np.clip(command, -limit.angle, limit.angle) + limit.centre
    meta = {"purpose": purpose, "rate_hz": f"{RATE:g}", "play": "command_rad at time_s, in order"}
    columns = {"command_rad": inside}
    return Recording(name, np.arange(command.size) / RATE, columns, meta, {"condition": labels})
