"""The virtual pool's plant: many fish, each in its own water, stepped by `dynamics.step`.

Deterministic. Twin, trainer and controller get only what a recorder writes. A `State` can be
copied, stored and continued.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from tailbeat.files import BadInput
from tailbeat.fish.description import Fish, Servo
from tailbeat.pool.chain import Chain, build_chain, dofs, servo_rows
from tailbeat.pool.compiled import compiled, compiled_parallel
from tailbeat.pool.dynamics import POKE, TETHER, Around, Moving, scratch, step
from tailbeat.pool.hydrodynamics import MODE
from tailbeat.pool.section import UNDISTURBED
from tailbeat.pool.water import Water, rows
from tailbeat.pool.wear import Wear, alone, worn, worn_servos
from tailbeat.pool.wear import rows as wear_rows

Array = NDArray[np.float64]
Rows = NDArray[np.void]
LONGEST_DELAY = 0.2  # s, longest delay of a servo's description


@dataclass(frozen=True)
class Surroundings:
    """What is around one fish: pool walls (length, width) [m] or None for open water; `modes`
    (m, 5) of the background flow (see `hydrodynamics.MODE`); `pokes` (k, 5): time, duration [s],
    force x, y [N], torque [N m] on the head; `held` clamps the head; `tether`: its pull x, y [N] on
    the head in the world, and its drag [N s^2/m^2]."""

    walls: tuple[float, float] | None = None
    modes: tuple[tuple[float, ...], ...] = ()
    pokes: tuple[tuple[float, ...], ...] = ()
    held: bool = False
    tether: tuple[float, float, float] = (0.0, 0.0, 0.0)


def stirred(seed: int, size: float = 0.03, count: int = 6, scale: float = 1.0) -> Surroundings:
    """Stirred water: `count` slow waves of random direction, rms speed `size` [m/s] together, wave
    length about `scale` [m]. Free of divergence; the same seed gives the same water."""
    rng = np.random.default_rng(seed)
    modes = []
    for _ in range(count):
        direction, length = rng.uniform(0, 2 * np.pi), scale * rng.uniform(0.7, 2.0)
        wave = 2 * np.pi / length
        speed = size * np.sqrt(2 / count)
        rate, phase = 2 * np.pi / rng.uniform(8.0, 20.0), rng.uniform(0, 2 * np.pi)
        modes.append((speed, wave * np.cos(direction), wave * np.sin(direction), rate, phase))
    return Surroundings(modes=tuple(modes))


class State(NamedTuple):
    """State of n fish; `step_plant` changes it in place.

    `q`, `v` and last accelerations `a` (n, nv), the fins' wakes (n, f), delayed commands `history`
    (n, h). `clock` (2,) is the same for all fish: the index of the newest command in `history`, and
    the steps taken.
    """

    q: Array
    v: Array
    a: Array
    wakes: Rows
    history: Array
    clock: NDArray[np.int64]

    def part(self, chosen: NDArray[np.int64]) -> "State":
        """A copy of the state of the fish with these indices."""
        *each, clock = self
        return State._make([*(values[chosen] for values in each), clock.copy()])

    def put(self, chosen: NDArray[np.int64], part: "State") -> None:
        """Replace the state of the fish with these indices."""
        for values, new in zip(self[:-1], part[:-1], strict=True):
            values[chosen] = new
        self.clock[:] = part.clock

    def copy(self) -> "State":
        """A copy, to continue from later."""
        return State._make(values.copy() for values in self)


@dataclass(frozen=True, eq=False)
class Plant:
    """n fish of one description: waters, rows (n,) of `chain.SERVO`, surroundings, step dt [s],
    wear."""

    chain: Chain
    water: tuple[Water, ...]
    servo: Rows
    around: tuple[Surroundings, ...]
    dt: float
    wear: tuple[Wear, ...]

    @cached_property
    def own(self) -> Chain:
        """The chains of all fish, every array with a leading axis n."""
        return worn(self.chain, wear_rows(self.wear))

    @cached_property
    def each(self) -> Around:
        """What differs between fish, one row each."""
        half = [(w[0] / 2, w[1] / 2) if (w := a.walls) else (0.0, 0.0) for a in self.around]
        return Around(
            rows(self.water),
            self.servo,
            _filled([a.modes for a in self.around], MODE, "kx"),
            np.array(half),
            _filled([a.pokes for a in self.around], POKE, "duration"),
            np.array([a.held for a in self.around]),
            np.array([a.tether for a in self.around], TETHER),
        )

    def part(self, chosen: NDArray[np.int64]) -> "Plant":
        """Some of the fish, in their own water and surroundings."""
        water, around = ([values[i] for i in chosen] for values in (self.water, self.around))
        wear, servo = tuple(self.wear[i] for i in chosen), self.servo[chosen]
        part = replace(self, water=tuple(water), around=tuple(around), servo=servo, wear=wear)
        part.__dict__["own"] = Chain._make(np.asarray(values)[chosen] for values in self.own)
        return part


def build_plant(
    fish: Fish,
    water: Sequence[Water] = (Water(),),
    servo: Servo | Sequence[Servo] | None = None,
    around: Sequence[Surroundings] = (Surroundings(),),
    dt: float = 0.002,
    wear: Sequence[Wear] = (Wear(),),
) -> Plant:
    """Build a pool of n fish; n is the length of the longest list, and lists of length 1 are
    repeated.

    `servo` is the description's own by default. Raises BadInput for a description without a fin,
    lists of other lengths, or a step `dt` [s] that is too long for the servo.
    """
    chain = build_chain(fish)
    chosen = servo or fish.servos[fish.servo]
    servos = [chosen] if isinstance(chosen, Servo) else chosen
    lengths = len(water), len(servos), len(around), len(wear)
    count = max(lengths)
    if set(lengths) - {1, count}:
        raise BadInput(
            f"{fish.name}: {len(water)} waters, {len(servos)} servos, {len(around)} surroundings,"
            f" wear of {len(wear)}; give one of each, or as many as there are fish."
        )
    rows = np.broadcast_to(servo_rows(servos, fish.tail.friction), count)
    found = worn_servos(rows, np.broadcast_to(wear_rows(wear), count))
    _check_servos(fish, found, dt)
    waters, places = (tuple(water) * count)[:count], (tuple(around) * count)[:count]
    return Plant(chain, waters, found, places, dt, (tuple(wear) * count)[:count])


def _check_servos(fish: Fish, servo: Rows, dt: float) -> None:
    """Check the step and the delays. Springs are implicit, so only the servo's loop limits the
    step."""
    longest = float(servo["delay"].max())
    if longest > LONGEST_DELAY:
        raise BadInput(
            f"{fish.name}: a servo's delay of {1e3 * longest:.4g} ms with its wear; at most"
            f" {1e3 * LONGEST_DELAY:g} ms is allowed."
        )
    inertia = servo["armature"] + 1e-3  # the least inertia that a tail adds
    fastest = np.sqrt(servo["kp"] / inertia).max()
    largest = float(min(0.01, 2.0 / fastest))
    if not 0 < dt <= largest:
        raise BadInput(
            f"{fish.name}: step {1e3 * dt:g} ms; at most {1e3 * largest:.2g} ms is allowed for a"
            f" servo of kp {servo['kp'].max():g} N m/rad."
        )


def at_rest(plant: Plant, start: Array | None = None) -> State:
    """Still fish with straight tails; `start` (n, 3) x, y [m], yaw [rad]."""
    n, nv = len(plant.water), dofs(plant.chain)
    q, v = np.zeros((n, nv)), np.zeros((n, nv))
    if start is not None:
        q[:, :3] = start
    wakes = np.full((n, len(plant.chain.fins)), UNDISTURBED)
    slots = int(np.ceil(LONGEST_DELAY / plant.dt)) + 2
    return State(q, v, 0 * v, wakes, np.zeros((n, slots)), np.zeros(2, np.int64))


@dataclass(frozen=True, eq=False)
class Swum:
    """What the fish did: time (k,) [s], q and v (n, k, nv), actuator torque (n, k) [N m]. Sample 0
    is the start. `lost` (n,) marks fish with numbers that are not finite."""

    time: Array
    q: Array
    v: Array
    torque: Array
    lost: NDArray[np.bool_]


def step_plant(plant: Plant, state: State, commands: Array, every: int = 1) -> Swum:
    """Step every fish through its commands (n, steps) [rad], changing `state` in place.

    Sample j is the state after j * every steps. The command is the setpoint during each step; the
    servo gets it after its delay.
    """
    n, steps = commands.shape
    samples = steps // every + 1
    q = np.empty((n, samples, state.q.shape[1]))
    v, torque = np.empty_like(q), np.zeros((n, samples))
    played = _Played(np.ascontiguousarray(commands, dtype=float), every, plant.dt)
    words = state, played, plant.own, plant.each, _Samples(q, v, torque)
    if n == 1:
        _swim(0, *words)  # a pool of threads would wait for a busy machine, 35 ms a step
    else:
        _advance(*words)
    newest, taken = state.clock.tolist()
    state.clock[:] = (newest + steps) % state.history.shape[1], taken + steps
    time = plant.dt * (taken + every * np.arange(samples))
    lost = np.logical_not(np.isfinite(q).all(axis=(1, 2)))
    return Swum(time, q, v, torque, np.asarray(lost))


def _filled(lists: Sequence[Sequence[Sequence[float]]], kind: np.dtype[np.void], one: str) -> Rows:
    """Lists of different lengths as an array (n, longest) of `kind`, filled up with rows of zeros
    whose column `one` is 1."""
    found = np.zeros((len(lists), max(map(len, lists))), kind)
    found[one] = 1.0  # a wave number: no division by zero
    for i, items in enumerate(lists):
        found[i, : len(items)] = [tuple(item) for item in items]
    return found


class _Played(NamedTuple):
    """Commands (n, steps) [rad], how many steps make a sample, the step [s]."""

    commands: Array
    every: int
    dt: float


class _Samples(NamedTuple):
    """What is written: q, v (n, k, nv) and torque (n, k)."""

    q: Array
    v: Array
    torque: Array


@compiled_parallel
def _advance(state, played, chain, each, out):  # type: ignore[no-untyped-def]
    """All fish through all their steps, one lane each."""
    for i in prange(len(state.q)):
        _swim(i, state, played, chain, each, out)


@compiled
def _swim(i, state, played, chains, each, out):  # type: ignore[no-untyped-def]
    """Step fish i through all its steps; the servo gets each command after its delay."""
    dt, every, slots = played.dt, played.every, state.history.shape[1]
    chain, servo = alone(i, chains), each.servo[i]
    fish = Moving(state.q[i], state.v[i], state.a[i], state.wakes[i])
    around = Around(
        each.water[i],
        servo,
        each.modes[i],
        each.walls[i],
        each.pokes[i],
        each.held[i],
        each.tether[i],
    )
    work = scratch(len(fish.q), len(chain.bodies), len(chain.fins))
    history, (place, taken) = state.history[i], state.clock
    out.q[i, 0], out.v[i, 0] = fish.q, fish.v
    late = servo.delay / dt
    whole = int(late)
    for k in range(played.commands.shape[1]):
        place = (place + 1) % slots
        history[place] = played.commands[i, k]
        first = history[(place - whole) % slots]
        second = history[(place - whole - 1) % slots]
        command = first + (late - whole) * (second - first)
        torque = step(fish, command, (taken + k) * dt, dt, chain, around, work)
        if (k + 1) % every == 0:
            j = (k + 1) // every
            out.q[i, j], out.v[i, j], out.torque[i, j] = fish.q, fish.v, torque
