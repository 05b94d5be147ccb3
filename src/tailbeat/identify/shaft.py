"""Simulate one shaft on a test bench: a position servo with a known load, many at once.

It is the servo that `fish/twin.py` compiles, on one degree of freedom, so that a fit of a dozen
recordings takes a minute: torque = clip(kp (command(t - delay) - angle) - kv speed, limit), shaft
damping outside the clip, Coulomb friction. A test compares it with the compiled twin.

One effect on a test bench cannot be compiled for the engine: the friction of gears grows with the
torque that they carry, and is larger at rest. `load_friction` and `stiction` are fractions of that
torque, which is the mean of drive and load (after Rhoban's BAM models, arXiv 2410.08650). The mean,
and how stiction falls with speed, are ours: of the forms tried they predicted left-out gains best.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from tailbeat.identify.glitches import Glitch

Array = NDArray[np.float64]
STEP = 1e-3  # s
SERVO = (
    "kp kv armature damping friction force_limit delay damping_off load_friction stiction".split()
)
LOAD = "stiffness damping inertia friction weight bend".split()
CREEP = 0.2  # rad/s at which stiction has fallen to half, chosen


@dataclass(frozen=True)
class Load:
    """The load, seen at the shaft; `kind` is tail, pendulum or nothing.

    A tail has `stiffness` [N m/rad], `damping` [N m s/rad], `inertia` [kg m^2], `friction` [N m]
    and `bend` [1/rad^2], by which share it is stiffer at 1 rad. A pendulum has `inertia` m l^2 and
    `weight` m g l [N m], and hangs down at angle 0. Nothing has zeros.
    """

    kind: str = "nothing"
    stiffness: float = 0.0
    damping: float = 0.0
    inertia: float = 0.0
    friction: float = 0.0
    weight: float = 0.0
    bend: float = 0.0


@dataclass(frozen=True, eq=False)
class Bench:
    """One recording of a driven shaft: `time` (k,) [s] from 0, `command` and `angle` (k,) [rad].

    `enabled` (k,) is 1 where the servo's torque was on. `gain` is the gain register's value or
    None. The angle is NaN where a glitch was left out, never at the first sample; `glitches` lists
    them.
    """

    name: str
    time: Array
    command: Array
    angle: Array
    enabled: Array
    load: Load
    gain: float | None = None
    glitches: tuple[Glitch, ...] = ()

    @property
    def good(self) -> NDArray[np.bool_]:
        """Which samples of the angle are not glitches (k,)."""
        return np.isfinite(self.angle)


class Played(NamedTuple):
    """Samples (k,) of a shaft's drive: time [s], command [rad], and whether the servo's torque is
    on."""

    time: Array
    command: Array
    enabled: NDArray[np.bool_]


def free_run(servo: Mapping[str, Array], benches: Sequence[Bench]) -> list[Array]:
    """Shaft angles (n, k) [rad] of every bench for n servos, simulated from the recorded start.

    `servo` maps the names in `SERVO` (damping_off: shaft damping with torque off) to (n,) or, if
    benches differ, (n, benches), in SI. A command holds from its own sample to the next. Angles are
    NaN after a simulation became unstable at the fixed step.
    """
    lanes = np.stack([_lanes(servo[name], len(benches)) for name in SERVO], axis=-1)
    load = np.array([[getattr(b.load, name) for name in LOAD] for b in benches])
    start = np.array([[b.angle[0], _first_speed(b)] for b in benches])
    time, command, enabled = (
        np.concatenate([getattr(b, n) for b in benches]) for n in ("time", "command", "enabled")
    )
    edges = np.cumsum([0, *(b.time.size for b in benches)])
    angle = np.full((len(lanes), time.size), np.nan)
    _run(lanes, load, start, Played(time, command, enabled > 0.5), edges, angle)
    return np.split(angle, edges[1:-1], axis=1)


def _lanes(value: Array, benches: int) -> Array:
    column = value[:, None] if value.ndim == 1 else value
    return np.broadcast_to(column, (len(value), benches))


def _first_speed(bench: Bench) -> float:
    """Slope of the first 50 ms [rad/s]."""
    early = (bench.time <= bench.time[0] + 0.05) & bench.good
    if early.sum() < 3:
        return 0.0
    return float(np.polyfit(bench.time[early], bench.angle[early], 1)[0])


def mean_held(time: Array, command: Array, edges: Array) -> Array:
    """Mean over each interval of `edges` (k + 1,) of a command held from sample to sample (k,)."""
    ends = np.append(time, edges[-1] + 1.0)
    integral = np.concatenate([[0.0], np.cumsum(command * np.diff(ends))])
    return np.asarray(np.diff(np.interp(edges, ends, integral)) / np.diff(edges))


@njit(parallel=True, cache=True)
def _run(lanes, load, start, played, edges, angle):  # type: ignore[no-untyped-def]
    """Every servo on every bench, one lane each."""
    benches = len(load)
    for lane in prange(len(lanes) * benches):
        i, b = lane // benches, lane % benches
        part = slice(edges[b], edges[b + 1])
        own = Played(played.time[part], played.command[part], played.enabled[part])
        _shaft(lanes[i, b], load[b], start[b], own, angle[i, part])


@njit(cache=True)
def _shaft(servo, load, start, played, angle):  # type: ignore[no-untyped-def]
    """One lane: leapfrog. Friction can stop the shaft exactly.

    A speed belongs to the middle of its step, so a step's torque is the mean from the middle of the
    step before to its own middle, and damping acts on the mean of the two speeds. A mean of torques
    and not the torque of a mean command: that would reach the force limit too early by a part of a
    step. It changes smoothly with the delay.
    """
    kp, kv, armature, on_damping, friction, limit, delay, off_damping = servo[:8]
    load_rub, stiction = servo[8:]
    stiffness, damping, load_inertia, load_friction, weight, bend = load
    time, command, enabled = played
    q, v = start
    angle[0] = q
    place, switch, sample = 0, 0, 1
    for step in range(int(np.ceil(time[-1] / STEP))):
        while switch + 1 < time.size and time[switch + 1] <= step * STEP:
            switch += 1
        torque, slope, drag = 0.0, 0.0, off_damping + damping
        if enabled[switch]:
            drag = on_damping + damping
        begun, late = (step - 0.5) * STEP - delay, (step + 0.5) * STEP - delay
        while begun < late:
            to = min(time[place + 1], late) if place + 1 < time.size else late
            part, wanted = max(to - begun, 0.0) / STEP, kp * (command[place] - q) - kv * v
            if enabled[switch]:
                torque += part * min(max(wanted, -limit), limit)
                slope += part * kv if abs(wanted) < limit else 0.0
            begun = max(to, begun)
            place += begun < late
        pull = stiffness * q * (1 + bend * q * q) + (weight * np.sin(q) if weight > 0 else 0.0)
        reach = armature + load_inertia + STEP * (drag / 2 + slope)
        rub = friction + load_friction
        if load_rub > 0 or stiction > 0:
            share = load_rub + stiction / (1 + (v / CREEP) ** 2)
            rub += share * 0.5 * (abs(torque) + abs(pull))
        v += STEP / reach * (torque - pull - drag * v)
        v -= min(max(v, -STEP * rub / reach), STEP * rub / reach)
        before, q = q, q + STEP * v
        if not abs(q) < 1e6:
            return
        while sample < time.size and time[sample] <= (step + 1) * STEP:
            share = time[sample] / STEP - step
            angle[sample] = before * (1 - share) + q * share
            sample += 1
