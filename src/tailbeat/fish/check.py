"""A marine engineer's first check of a description: does it float, can its servo bend its tail, at
which beat does the tail ring, how does it swim and turn, and does its step hold?

Everything is computed from the compiled twin. Speeds and turns are only as good as the coefficients
in the description.
"""

import math
from dataclasses import dataclass

import numpy as np

from tailbeat.fish.buoyancy import Buoyancy, buoyancy, float_warnings, water_warnings
from tailbeat.fish.convergence import ALLOWED, Deviation, deviation
from tailbeat.fish.description import Fish
from tailbeat.fish.linkage import at_shaft, free_bends
from tailbeat.fish.quick_swims import Quick, quick_swims, swim_warnings

NEARLY = 0.95  # of the angle at which a hinge's guides meet, chosen; the pulley fish has 0.86
LEAST_BEND = math.radians(10)  # at the shaft, in the band's lower half


@dataclass(frozen=True)
class Tail:
    """The tail seen from the shaft: stiffness [N m/rad], inertia in air and in water [kg m^2], and
    the beat at which each takes over from the stiffness [Hz]."""

    stiffness: float
    inertia_air: float
    inertia_water: float
    resonance_air: float
    resonance_water: float


@dataclass(frozen=True)
class Strength:
    """What the servo can do at all: its torque at standstill [N m], its speed without load [rad/s]
    (inf without damping), and how far it holds the tail bent [rad]."""

    stall: float
    no_load: float
    bend: float


@dataclass(frozen=True)
class Reach:
    """The largest stroke that the servo makes at a beat [Hz], in water and at its force limit
    [rad], and what limits it: range, gain or torque."""

    frequency: float
    stroke: float
    limit: str


@dataclass(frozen=True)
class Check:
    """All of it, and what is wrong in plain words."""

    buoyancy: Buoyancy
    tail: Tail | None
    servo: Strength | None
    reach: tuple[Reach, ...]
    swims: tuple[Quick, ...]
    step: Deviation
    warnings: tuple[str, ...]


def check(fish: Fish, length: float) -> Check:
    """Check a fish of a `length` [m]. A crank's tail and reach are left out: it has no range."""
    found = buoyancy(fish)
    tail = None if fish.motor.range is None else tail_of(fish)
    reach = () if tail is None else reaches(fish, tail)
    servo = None if tail is None else strength(fish, tail)
    swims = quick_swims(fish, length)
    step = deviation(fish)
    said = (
        *float_warnings(found, length),
        *_servo_warnings(fish, reach),
        *_hinge_warnings(fish, servo),
        *water_warnings(fish, found.mass),
        *swim_warnings(swims, length),
        *_step_warnings(step),
    )
    return Check(found, tail, servo, reach, swims, step, said)


# ---- tail and servo -----------------------------------------------------------------------------


def tail_of(fish: Fish) -> Tail:
    """Stiffness and inertia at the shaft when the tail bends as under a slow pull (Rayleigh)."""
    air, water = (at_shaft(fish, added) for added in (0.0, max(fish.added_inertia, 1.0)))
    rings = [math.sqrt(one.stiffness / one.inertia) / (2 * math.pi) for one in (air, water)]
    return Tail(air.stiffness, air.inertia, water.inertia, rings[0], rings[1])


def strength(fish: Fish, tail: Tail) -> Strength:
    """What the servo does slowly: friction takes its part of the torque, the tail's spring or the
    range ends the bend. Damping (of a geared motor its back EMF) ends the speed."""
    servo = fish.servos[fish.servo]
    low, high = fish.motor.range or (-math.pi, math.pi)
    torque = max(servo.force_limit - servo.friction, 0.0)
    speed = torque / servo.damping if servo.damping else math.inf
    return Strength(torque, speed, min(torque / tail.stiffness, (high - low) / 2))


def reaches(fish: Fish, tail: Tail) -> tuple[Reach, ...]:
    """The servo's largest stroke at four beats over the band, by its linear model: the smallest of
    what the range, the position gain and the force limit allow. At the force limit the torque is a
    square wave, whose fundamental is 4/pi times as large."""
    low, top = fish.band
    return tuple(_reach(fish, tail, f) for f in np.geomspace(max(low, 0.1), top, 4).tolist())


def _reach(fish: Fish, tail: Tail, frequency: float) -> Reach:
    """See `reaches`; the load is the tail with the servo's own inertia and damping."""
    servo, omega = fish.servos[fish.servo], 2 * math.pi * frequency
    low, high = fish.motor.range or (-math.pi, math.pi)
    half = (high - low) / 2
    inertia = tail.inertia_water + servo.armature
    damping = servo.damping + tail.stiffness * fish.tail.damping_time
    load = complex(tail.stiffness - inertia * omega**2, damping * omega)
    closed = abs(load + servo.kp + 1j * omega * servo.kv)
    strokes = {
        "range": half,
        "gain": servo.kp * half / closed,
        "torque": 4 / math.pi * servo.force_limit / abs(load),  # a saturated servo switches
    }
    limit = min(strokes, key=lambda name: strokes[name])
    return Reach(frequency, strokes[limit], limit)


def highest_beat(fish: Fish, tail: Tail, stroke: float, top: float) -> float:
    """The highest beat up to `top` [Hz] at which the servo still makes a `stroke` [rad]."""
    beats = np.linspace(top, top / 50, 50).tolist()
    good = (beat for beat in beats if _reach(fish, tail, beat).stroke >= stroke)
    return next(good, beats[-1])


# ---- what is wrong ------------------------------------------------------------------------------


def _servo_warnings(fish: Fish, reach: tuple[Reach, ...]) -> list[str]:
    weak = [one for one in reach[: len(reach) // 2] if one.stroke < LEAST_BEND]
    if not weak:
        return []
    first = weak[0]
    return [
        f"servo {fish.servo} bends the tail by {math.degrees(first.stroke):.2g} deg at"
        f" {first.frequency:.2g} Hz (limit: {first.limit}); choose a stronger servo, a softer tail"
        f" or a lower band"
    ]


def _hinge_warnings(fish: Fish, servo: Strength | None) -> list[str]:
    """A fish whose hinge bends until its guides meet swims jerkily, or diverges."""
    if servo is None:
        return []
    bent, free = at_shaft(fish).bend * servo.bend, free_bends(fish)
    worst = int(np.argmax(bent / free))
    if bent[worst] < NEARLY * free[worst]:
        return []
    bend, meet = math.degrees(bent[worst]), math.degrees(free[worst])
    return [
        f"hinge {worst + 1} of {len(free)} bends by {bend:.0f} deg at full stroke, and its tendon's"
        f" guides meet at {meet:.0f} deg; set the guides beside it further apart, or narrow the"
        f" motor's range"
    ]


def _step_warnings(step: Deviation) -> list[str]:
    if step.error < ALLOWED:
        return []
    size = "diverges" if math.isinf(step.error) else f"errs by {100 * step.error:.0f} % of the way"
    return [
        f"the step of {1e3 * step.simulation.step:g} ms with {step.simulation.integrator} {size} at"
        f" full stroke; allowed are {100 * ALLOWED:.0f} %: take a shorter one, if it errs less"
    ]
