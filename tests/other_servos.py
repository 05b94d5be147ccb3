"""Pendulum logs of servos of other makes, by a friction model that is not the one of the fit.

The model is M6 of Rhoban's BAM (arXiv 2410.08650, its equations; the code here is ours): friction
depends on the load in each direction and on the speed, with a quadratic term. The numbers are those
that its authors identified on real servos and publish (github.com/Rhoban/bam, bam/params/*/m6.json,
Apache-2.0), and so are the four motions. Loads, delays and loop times are chosen. Now and then a
log has one reading of -pi, as one in seven of their real logs has.
"""

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tailbeat.fish.description import Fish
from tailbeat.identify.servo import as_bench
from tailbeat.identify.shaft import Bench
from tailbeat.importers.xl330 import import_xl330

Wish = tuple[float, bool]  # commanded angle [rad], torque on
GRAVITY = 9.80665  # m/s^2
STEP = 5e-4  # s
SECONDS = 6.0
READING = 1.5e-3  # s from the command to the sample, chosen
GLITCHED = 0.15  # share of logs with one reading of -pi


@dataclass(frozen=True)
class Servo:
    """A voltage-driven servo: torque constant [N m/A], resistance [ohm], armature [kg m^2], duty
    per gain and rad, highest duty, supply [V], friction as in BAM [SI], fastest setpoint [rad/s],
    delay [s], counts of a turn; the bench's gains and loads (mass [kg], arm [m])."""

    kt: float
    resistance: float
    armature: float
    duty_per_rad: float
    supply: float
    viscous: float
    stribeck: float
    motor: tuple[float, float]  # load friction of the drive: moving, more at rest
    outside: tuple[float, float]  # of the load
    squares: tuple[float, float]  # of the drive and the load
    creep: float  # rad/s
    power: float
    gains: tuple[int, ...]
    loads: tuple[tuple[float, float], ...]
    base: float = 0.0
    counts: int = 4096
    most_duty: float = 0.9625
    fastest: float = math.inf
    delay: float = 0.002
    period: float = 0.006


SERVOS = {
    "mx64": Servo(
        1.6017, 2.3164, 0.012266, 0.158, 15.0, 0.025337, 0.1227, (0.31147, 0.18774),
        (0.0, 0.014066), (0.0069085, 0.01), 2.5753, 0.8409, (4, 8, 16, 32),
        ((0.567, 0.105), (1.0, 0.15)),
    ),
    "mx106": Servo(
        2.2098, 2.0337, 0.026016, 0.158, 15.0, 0.050716, 0.12195, (0.19801, 0.1986),
        (0.022216, 0.087103), (0.01, 7.327e-5), 1.7463, 1.1428, (4, 8, 16, 32),
        ((1.0, 0.15), (2.0, 0.15)), base=1.02e-5,
    ),
    "sts3215": Servo(
        1.27532, 2.75342, 0.021564, 0.166 * 1.1617, 7.4, 0.02816, 4.257e-5, (0.044912, 1.245e-4),
        (0.24355, 0.14229), (0.0075949, 0.0034041), 0.37114, 9.93095, (8, 16, 32),
        ((0.3, 0.1), (0.5, 0.15)), base=0.053313, most_duty=0.97, fastest=5.0958, delay=0.00498,
        period=0.008,
    ),
    "xl320": Servo(
        1.00883, 31.58588, 0.001163, 0.158, 7.5, 0.0072252, 0.016306, (3.1e-6, 0.0),
        (0.15833, 0.24548), (0.0036164, 0.0047109), 2.30105, 1.70674, (16, 32),
        ((0.1, 0.1), (0.05, 0.1)), counts=1229, most_duty=1.0, period=0.008,
    ),
}  # fmt: skip


def _eased(t: float, begin: float, end: float, first: float, last: float) -> float:
    share = min(max((t - begin) / (end - begin), 0.0), 1.0)
    return first + (last - first) * share * share * (3 - 2 * share)


def _up_and_down(t: float) -> Wish:
    up = _eased(t, 0.0, 3.0, 0.0, math.pi / 2)
    return (up if t < 3 else _eased(t, 3.0, 6.0, math.pi / 2, 0.4 * math.pi)), True


def _sin_sin(t: float) -> Wish:
    return math.sin(t) * math.pi / 2 + 0.5 * math.sin(5 * t) * math.sin(2 * t), True


MOTIONS: dict[str, Callable[[float], Wish]] = {
    "lift_and_drop": lambda t: (_eased(t, 0.0, 2.0, 0.0, -math.pi / 2), t < 2),
    "sin_time_square": lambda t: (math.sin(t * t), True),
    "up_and_down": _up_and_down,
    "sin_sin": _sin_sin,
}


def friction(servo: Servo, drive: float, load: float, speed: float) -> float:
    """Largest friction [N m] at torques of drive and load [N m] and a speed [rad/s], M6."""
    slow = math.exp(-(abs(speed / servo.creep) ** servo.power))
    found = servo.base + slow * servo.stribeck + servo.viscous * abs(speed)
    for part, weight in ((0, 1.0), (1, slow)):
        found += weight * abs(load * servo.outside[part] - drive * servo.motor[part])
    if drive * load <= 0:
        squares = servo.squares[1] * load**2, servo.squares[0] * drive**2
        found += slow * (squares[0] if abs(load) < abs(drive) else squares[1])
    return found


def pendulum_log(name: str, motion: str, gain: int, load: tuple[float, float], seed: int) -> Any:
    """A raw log in the JSON format of Rhoban/bam."""
    servo, rng = SERVOS[name], np.random.default_rng(seed)
    asked = [0.0]
    while asked[-1] < SECONDS:
        asked.append(asked[-1] + servo.period * (1 + 0.15 * rng.random()))
    wishes = [MOTIONS[motion](t) for t in asked]
    angle, speed = _swung(servo, gain, load, asked, wishes)
    count = 2 * math.pi / servo.counts
    entries = [
        {"position": round(q / count) * count, "speed": v, "load": 0, "input_volts": servo.supply,
         "temp": 30, "timestamp": t + READING, "goal_position": goal, "torque_enable": on}
        for t, (goal, on), q, v in zip(asked, wishes, angle, speed, strict=True)
    ]  # fmt: skip
    if rng.random() < GLITCHED:
        entries[int(rng.integers(5, len(entries) - 5))]["position"] = -math.pi
    about = {"mass": load[0], "length": load[1], "kp": gain, "vin": servo.supply, "motor": name}
    return {**about, "trajectory": motion, "entries": entries}


def bench_of(log: dict[str, Any], folder: Path, fish: Fish) -> Bench:
    """The log as the fit gets it: written into a folder and imported."""
    file = folder / f"{log['trajectory']}-{log['kp']}-{log['mass']}.json"
    file.write_text(json.dumps(log))
    return as_bench(import_xl330(file), fish)


def _swung(
    servo: Servo, gain: int, load: tuple[float, float], asked: list[float], wishes: list[Wish]
) -> tuple[list[float], list[float]]:
    """Angles and speeds when each sample is read."""
    mass, arm = load
    inertia, weight = mass * arm**2 + servo.armature, mass * GRAVITY * arm
    q = v = goal = 0.0
    angles: list[float] = []
    speeds: list[float] = []
    heard = 0
    for step in range(int((asked[-1] + READING) / STEP) + 2):
        now = step * STEP
        while heard + 1 < len(asked) and asked[heard + 1] + servo.delay <= now:
            heard += 1
        wanted, on = wishes[heard]
        goal += min(max(wanted - goal, -servo.fastest * STEP), servo.fastest * STEP)
        duty = min(max((goal - q) * gain * servo.duty_per_rad, -servo.most_duty), servo.most_duty)
        drive = servo.kt / servo.resistance * (servo.supply * duty - servo.kt * v) if on else 0.0
        pull = -weight * math.sin(q)
        stop = inertia / STEP * v + drive + pull
        rub = min(abs(stop), friction(servo, drive, pull, v))
        v += STEP / inertia * (drive + pull - math.copysign(rub, stop))
        q += STEP * v
        while len(angles) < len(asked) and asked[len(angles)] + READING <= now + STEP:
            angles.append(q)
            speeds.append(v)
    return angles, speeds
