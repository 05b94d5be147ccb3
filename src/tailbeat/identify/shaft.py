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
LOAD = "stiffness damping inertia friction weight".split()
CREEP = 0.2  # rad/s at which stiction has fallen to half, chosen


@dataclass(frozen=True)
class Load:
    """The load, seen at the shaft; `kind` is tail, pendulum or nothing.

    A tail has `stiffness` [N m/rad], `damping` [N m s/rad], `inertia` [kg m^2] and `friction` [N
    m]. A pendulum has `inertia` m l^2 and `weight` m g l [N m], and hangs down at angle 0. Nothing
    has zeros.
    """

    kind: str = "nothing"
    stiffness: float = 0.0
    damping: float = 0.0
    inertia: float = 0.0
    friction: float = 0.0
    weight: float = 0.0


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
    """Samples (k,) of a shaft's drive: time [s], command [rad], the command's running integral
    [rad s], and whether the servo's torque is on."""

    time: Array
    command: Array
    integral: Array
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
    integral = np.concatenate([_integral(b) for b in benches])
    edges = np.cumsum([0, *(b.time.size for b in benches)])
    angle = np.full((len(lanes), time.size), np.nan)
    _run(lanes, load, start, Played(time, command, integral, enabled > 0.5), edges, angle)
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


def _integral(bench: Bench) -> Array:
    """Running integral of the held command at its samples [rad s]. With it, the mean command over a
    step changes smoothly with the delay; a look-up would change in steps."""
    return np.concatenate([[0.0], np.cumsum(bench.command[:-1] * np.diff(bench.time))])


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
        own = Played(
            played.time[part], played.command[part], played.integral[part], played.enabled[part]
        )
        _shaft(lanes[i, b], load[b], start[b], own, angle[i, part])


@njit(cache=True)
def _shaft(servo, load, start, played, angle):  # type: ignore[no-untyped-def]
    """One lane: semi-implicit Euler with implicit damping. Friction can stop the shaft exactly."""
    kp, kv, armature, on_damping, friction, limit, delay, off_damping = servo[:8]
    load_rub, stiction = servo[8:]
    stiffness, damping, load_inertia, load_friction, weight = load
    time, command, integral, enabled = played
    q, v = start
    angle[0] = q
    held, place, switch, sample = -delay * command[0], 0, 0, 1
    for step in range(int(np.ceil(time[-1] / STEP))):
        late = (step + 1) * STEP - delay
        while place + 1 < time.size and time[place + 1] <= late:
            place += 1
        now = integral[place] + command[place] * (late - time[place])
        while switch + 1 < time.size and time[switch + 1] <= step * STEP:
            switch += 1
        torque, slope, drag = 0.0, 0.0, off_damping + damping
        if enabled[switch]:
            wanted = kp * ((now - held) / STEP - q) - kv * v
            torque, drag = min(max(wanted, -limit), limit), on_damping + damping
            slope = kv if torque == wanted else 0.0
        held = now
        pull = stiffness * q + (weight * np.sin(q) if weight > 0 else 0.0)
        reach = armature + load_inertia + STEP * (drag + slope)
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
