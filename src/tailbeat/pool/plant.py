"""The pool: many fish in many waters, each stepped by `dynamics.step`; deterministic.

What the twin, the trainer and the controller may have of it is what a recorder writes. State is
data: copy it, store it, go on from it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from tailbeat.files import BadInput
from tailbeat.fish.description import Fish, Servo
from tailbeat.pool.chain import Chain, build_chain, fin_factors, servo_row
from tailbeat.pool.dynamics import pose, step, tendon_lengths
from tailbeat.pool.section import STATES
from tailbeat.pool.water import Water, rows

Array = NDArray[np.float64]
LONGEST_DELAY = 0.2  # s, of a servo's description
STATE = ("q", "v", "a", "fins", "history")  # arrays of a state, one row a fish


@dataclass(frozen=True)
class Surroundings:
    """What is around one fish: pool walls (length, width) [m] or None for open water; `modes`
    (m, 5) of the background flow (see `dynamics.current`); `pokes` (k, 5): time, duration [s],
    force x, y [N], torque [N m] on the head; `held` clamps the head."""

    walls: tuple[float, float] | None = None
    modes: tuple[tuple[float, ...], ...] = ()
    pokes: tuple[tuple[float, ...], ...] = ()
    held: bool = False


def stirred(seed: int, size: float = 0.03, count: int = 6, scale: float = 1.0) -> Surroundings:
    """Stirred water: `count` slow waves of random direction, rms speed `size` [m/s] in all, wave
    length about `scale` [m]. Free of divergence; the same seed is the same water."""
    rng = np.random.default_rng(seed)
    modes = []
    for _ in range(count):
        direction, length = rng.uniform(0, 2 * np.pi), scale * rng.uniform(0.7, 2.0)
        wave = 2 * np.pi / length
        speed = size * np.sqrt(2 / count)
        rate, phase = 2 * np.pi / rng.uniform(8.0, 20.0), rng.uniform(0, 2 * np.pi)
        modes.append((speed, wave * np.cos(direction), wave * np.sin(direction), rate, phase))
    return Surroundings(modes=tuple(modes))


@dataclass(eq=False)
class State:
    """n fish: `q`, `v` and last accelerations `a` (n, nv), fin states (n, f, 6), held-back commands
    (n, h) with the newest at index `newest`, and the steps taken. `step_plant` moves it on in
    place.
    """

    q: Array
    v: Array
    a: Array
    fins: Array
    history: Array
    newest: int
    steps: int

    def part(self, chosen: NDArray[np.int64]) -> "State":
        """A copy of some fish."""
        arrays = {name: getattr(self, name)[chosen] for name in STATE}
        return replace(self, **arrays)

    def copy(self) -> "State":
        """A state to go on from later."""
        arrays = {name: getattr(self, name).copy() for name in STATE}
        return replace(self, **arrays)


@dataclass(frozen=True, eq=False)
class Plant:
    """n fish of one description: waters, servo rows (n, 7), surroundings, step dt [s]."""

    chain: Chain
    water: tuple[Water, ...]
    servo: Array
    around: tuple[Surroundings, ...]
    dt: float

    @cached_property
    def arrays(self) -> tuple:
        """What the compiled code takes; see `Chain`."""
        c = self.chain
        factors = np.array([fin_factors(chord, height) for _, chord, height in c.fin])
        base = (c.origin, c.mass, c.centre, c.inertia, c.strip_body, c.strip, c.fin_body, c.fin)
        springs = (c.stiffness, c.damping, c.guide_body, c.guide, c.motor, factors, c.tendon)
        return (*base, *springs, self.neutral, self._ends)

    @cached_property
    def each(self) -> tuple[Array, ...]:
        """What differs from fish to fish: water rows, servo rows, flow modes, half walls, pokes,
        held heads."""
        half = [(w[0] / 2, w[1] / 2) if (w := a.walls) else (0.0, 0.0) for a in self.around]
        return (
            rows(self.water),
            self.servo,
            _filled([a.modes for a in self.around], 5),
            np.array(half),
            _filled([a.pokes for a in self.around], 5),
            np.array([a.held for a in self.around]),
        )

    def part(self, chosen: NDArray[np.int64]) -> "Plant":
        """Some of the fish, in their own water and surroundings."""
        water, around = ([values[i] for i in chosen] for values in (self.water, self.around))
        return replace(self, water=tuple(water), around=tuple(around), servo=self.servo[chosen])

    @cached_property
    def neutral(self) -> Array:
        """Tendon lengths (2,) of the straight fish."""
        c = self.chain
        place, spin = np.zeros((len(c.origin), 8)), np.zeros(len(c.origin))
        q, lengths = np.zeros(c.nv), np.zeros(2)
        pose(q, q, c.origin, place, spin)
        partial = (c.origin, *[c.mass] * 9, c.guide_body, c.guide, c.motor)
        tendon_lengths(q, partial, place, lengths, np.zeros((2, c.nv)))
        return lengths

    @cached_property
    def _ends(self) -> Array:
        """x of the nose on the head and of the fin's rear edge on the last body."""
        head = self.chain.strip[self.chain.strip_body == 0]
        fin = self.chain.fin[-1]
        return np.array([(head[:, 0] + head[:, 1] / 2).max(), fin[0] - fin[1] / 2])


def build_plant(
    fish: Fish,
    water: Sequence[Water] = (Water(),),
    servo: Servo | Sequence[Servo] | None = None,
    around: Sequence[Surroundings] = (Surroundings(),),
    dt: float = 0.002,
) -> Plant:
    """A pool of n fish, n the longest of the lists; shorter ones of length 1 are repeated.

    `servo` is the description's own by default. Raises BadInput for a description that the plant
    cannot carry, or a step too long for its stiffness.
    """
    chain = build_chain(fish)
    chosen = servo or fish.servos[fish.servo]
    servos = [chosen] if isinstance(chosen, Servo) else chosen
    count = max(len(water), len(servos), len(around))
    if {len(water), len(servos), len(around)} - {1, count}:
        raise BadInput(
            f"{fish.name}: {len(water)} waters, {len(servos)} servos, {len(around)} surroundings;"
            f" give one of each, or as many as there are fish."
        )
    servo_rows = np.array([servo_row(s, fish.tail.friction) for s in servos])
    _check_step(fish, servo_rows, dt)
    everyone = np.broadcast_to(servo_rows, (count, servo_rows.shape[1])).copy()
    waters, places = (tuple(water) * count)[:count], (tuple(around) * count)[:count]
    return Plant(chain, waters, everyone, places, dt)


def _check_step(fish: Fish, servo: Array, dt: float) -> None:
    """Springs are implicit, so the step is bounded by what must be resolved: the servo's loop."""
    inertia = servo[:, 2] + 1e-3  # what a tail adds at the least
    fastest = np.sqrt(servo[:, 0] / inertia).max()
    largest = float(min(0.01, 2.0 / fastest))
    if not 0 < dt <= largest:
        raise BadInput(
            f"{fish.name}: step {1e3 * dt:g} ms; allowed is up to {1e3 * largest:.2g} ms for a"
            f" servo of kp {servo[:, 0].max():g} N m/rad."
        )


def at_rest(plant: Plant, start: Array | None = None) -> State:
    """Still fish with straight tails; `start` (n, 3) x, y [m], yaw [rad]."""
    n, nv = len(plant.water), plant.chain.nv
    q, v = np.zeros((n, nv)), np.zeros((n, nv))
    if start is not None:
        q[:, :3] = start
    fins = np.zeros((n, len(plant.chain.fin), STATES))
    fins[:, :, 3] = 1.0  # attached
    slots = int(np.ceil(LONGEST_DELAY / plant.dt)) + 2
    return State(q, v, 0 * v, fins, np.zeros((n, slots)), 0, 0)


@dataclass(frozen=True, eq=False)
class Swum:
    """What the fish did: time (k,) s, q and v (n, k, nv), actuator torque (n, k) N m; sample 0 is
    the start. `lost` (n,) marks fish whose numbers left the finite."""

    time: Array
    q: Array
    v: Array
    torque: Array
    lost: NDArray[np.bool_]


def step_plant(plant: Plant, state: State, commands: Array, every: int = 1) -> Swum:
    """Step every fish through its commands (n, steps) rad, moving `state` on in place.

    Sample j is the state after j * every steps. The command is the setpoint in force during each
    step; the servo gets it its delay later.
    """
    n, steps = commands.shape
    samples = steps // every + 1
    q = np.empty((n, samples, plant.chain.nv))
    v, torque = np.empty_like(q), np.zeros((n, samples))
    water, servo, modes, half, pokes, held = plant.each
    _advance(
        state.q,
        state.v,
        state.a,
        state.fins,
        state.history,
        state.newest,
        np.ascontiguousarray(commands, dtype=float),
        every,
        state.steps,
        plant.dt,
        plant.arrays,
        water,
        servo,
        modes,
        half,
        pokes,
        held,
        (q, v, torque),
    )
    state.newest = (state.newest + steps) % state.history.shape[1]
    time = plant.dt * (state.steps + every * np.arange(samples))
    state.steps += steps
    lost = np.logical_not(np.isfinite(q).all(axis=(1, 2)))
    return Swum(time, q, v, torque, np.asarray(lost))


def _filled(lists: Sequence[Sequence[Sequence[float]]], width: int) -> Array:
    """Ragged rows as (n, longest, width), filled with ones of size zero."""
    longest = max(map(len, lists))
    found = np.zeros((len(lists), longest, width))
    found[:, :, 1] = 1.0  # a wave number or a duration: no division by zero
    for i, items in enumerate(lists):
        if items:
            found[i, : len(items)] = items
    return found


@njit(parallel=True, cache=True)
def _advance(  # type: ignore[no-untyped-def]
    q, v, a, fins, history, newest, commands, every, start, dt, chain, p, servo, modes, half, pokes,
    held, out,
):  # fmt: skip
    """All fish through all their steps, one lane each."""
    nv, bodies, slots = q.shape[1], len(chain[0]), history.shape[1]
    for i in prange(len(q)):
        work = (
            np.empty((nv, nv)),
            np.empty((nv, nv)),
            np.empty((nv, nv)),
            np.empty(nv),
            np.empty(nv),
            np.empty((bodies, 8)),
            np.empty(bodies),
            np.empty(2),
            np.empty((2, nv)),
            np.empty((fins.shape[1], 3)),
            np.empty(nv),
            np.empty(nv),
        )
        poke = np.zeros(3)
        place = newest
        out[0][i, 0], out[1][i, 0] = q[i], v[i]
        late = servo[i, 6] / dt
        whole = int(late)
        for k in range(commands.shape[1]):
            place = (place + 1) % slots
            history[i, place] = commands[i, k]
            first = history[i, (place - whole) % slots]
            second = history[i, (place - whole - 1) % slots]
            command = first + (late - whole) * (second - first)
            time = (start + k) * dt
            poke[:] = 0.0
            for row in pokes[i]:
                if row[0] <= time < row[0] + row[1]:
                    poke += row[2:]
            torque = step(
                q[i], v[i], a[i], fins[i], command, time, dt, chain, p[i], servo[i], modes[i],
                half[i], poke, held[i], work,
            )  # fmt: skip
            if (k + 1) % every == 0:
                j = (k + 1) // every
                out[0][i, j], out[1][i, j], out[2][i, j] = q[i], v[i], torque
