"""From a policy's action to the servo's setpoint: generator, direct, or direct behind a filter; for
a motor that turns without end, its speed over the turn.

Four frozen records say what an action means and go into the policy's contract. `reset` and `step`
work on any number of fish; the state between two steps is plain arrays. Actions are in [-1, 1];
others are clipped to it.

Trajectory generator (paper): theta = theta_c + sum_{k=1,2} [a_k cos k phi + b_k sin k phi],
phi' = omega, u = (omega, theta_c, a_1, b_1, a_2, b_2), u' = (u* - u) / tau.

Turning (ours, for a crank): theta' = omega (1 + a cos(theta - psi)), u = (omega, a cos psi, a sin
psi), u' = (u* - u) / tau. Half of each turn is faster than the other, so the strokes to one side
are stronger.
"""

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from tailbeat.files import BadInput
from tailbeat.fish.period import PERIOD

Array = NDArray[np.float64]
TURN = 2 * np.pi


@dataclass(frozen=True)
class Generator:
    """Scales and ceilings of the trajectory generator.

    The paper prints `tau` and the ceiling of 4 Hz. It does not print `offset`, `first` and
    `second`: these are chosen.
    """

    low: float
    """Lowest angle of the servo [rad]. The setpoint is clipped to it."""
    high: float
    """Highest angle of the servo [rad]. The setpoint is clipped to it."""
    ceiling: float = 4.0
    """Highest frequency [Hz] of what `binds` names."""
    binds: Literal["fundamental", "signal"] = "fundamental"
    """What the ceiling limits. With `fundamental` (the paper) the second harmonic reaches twice the
    ceiling. With `signal` the fundamental stays below half of it."""
    offset: float = 1.2
    """Largest mean angle, theta_c [rad]."""
    first: float = 1.0
    """Largest size of the first harmonic's a_1 and b_1 [rad]."""
    second: float = 0.4
    """Largest size of the second harmonic's a_2 and b_2 [rad]."""
    tau: float = 0.1
    """Time constant with which the generator follows the action [s]."""
    floor: float = 0.0
    """Fundamental of the action -1 [Hz]. With 0 the generator can stop. A contract without this
    field means 0."""
    kind: Literal["generator"] = "generator"
    """Name of the action space."""

    @property
    def fundamental(self) -> float:
        """Highest fundamental [Hz]."""
        return self.ceiling if self.binds == "fundamental" else self.ceiling / 2


@dataclass(frozen=True)
class Direct:
    """The action is the motor's angle, -1 to 1 over `low` to `high` [rad]."""

    low: float
    """Lowest angle of the servo [rad]."""
    high: float
    """Highest angle of the servo [rad]."""
    kind: Literal["direct"] = "direct"
    """Name of the action space."""


@dataclass(frozen=True)
class Filtered:
    """Direct action behind a first-order lag."""

    low: float
    """Lowest angle of the servo [rad]."""
    high: float
    """Highest angle of the servo [rad]."""
    tau: float = 0.04
    """Time constant of the lag [s]. 40 ms puts its corner at 4 Hz (chosen)."""
    kind: Literal["filtered"] = "filtered"
    """Name of the action space."""


@dataclass(frozen=True)
class Turning:
    """A motor that turns without end: its speed, and how that varies within the turn."""

    ceiling: float
    """Highest mean of the speed over the phases [Hz]: that of the action 1."""
    floor: float = 0.0
    """Mean of the speed over the phases of the action -1 [Hz]. With 0 the motor can stop."""
    depth: float = 0.8
    """Largest share by which the speed varies about that mean, below 1, so that the motor never
    turns back (chosen)."""
    tau: float = 0.1
    """Time constant with which the motor follows the action [s] (the generator's)."""
    kind: Literal["turning"] = "turning"
    """Name of the action space."""

    @property
    def low(self) -> float:
        """Lowest angle of the motor [rad]: none."""
        return -math.inf

    @property
    def high(self) -> float:
        """Highest angle of the motor [rad]: none."""
        return math.inf

    @property
    def fundamental(self) -> float:
        """Highest turns a second [Hz]."""
        return self.ceiling


ActionSpace = Generator | Direct | Filtered | Turning
HALF = (0.5 / PERIOD, " Hz")  # of the control's rate: above it no action is a frequency
MOST = {"ceiling": HALF, "floor": HALF, "tau": (10.0, " s")}  # with their units
WIDEST, QUICKEST = (100.0, ""), 1e-3  # of all other numbers; s, of a time constant
RANGE = math.radians(80)  # the paper's servo turns so far to either side


def generator(
    low: float,
    high: float,
    ceiling: float,
    binds: Literal["fundamental", "signal"] = "fundamental",
    floor: float = 0.0,
) -> Generator:
    """The generator of a servo that turns from `low` to `high` [rad], up to `ceiling` [Hz]: the
    sizes of its waves are the paper's fish's, in proportion to the range."""
    share, usual = (high - low) / 2 / RANGE, Generator(low, high)
    waves = {name: share * getattr(usual, name) for name in ("offset", "first", "second")}
    return replace(usual, ceiling=ceiling, binds=binds, floor=floor, **waves)


@dataclass(frozen=True)
class ActionState:
    """State between two steps: `u` (n, 6) of a generator (frequency [rad/s], the rest [rad]),
    (n, 3) of a turning motor (speed [rad/s], shares), else setpoints (n, 1) [rad]; and `phase` (n,)
    [rad]: the generator's in [0, 2 pi), the turning motor's angle since the start."""

    u: Array
    phase: Array


def size(space: ActionSpace) -> int:
    """Numbers in an action."""
    return {Generator: 6, Turning: 3}.get(type(space), 1)


def check_space(space: ActionSpace) -> None:
    """Raises BadInput for limits that contradict each other or are out of range."""
    for name, value in vars(space).items():
        most, unit = MOST.get(name, WIDEST)
        if name not in ("kind", "binds") and not -most <= value <= most:  # also of a NaN
            raise BadInput(f"actions: {name} = {value!r:.40}{unit}; give at most {most:g}{unit}.")
    if not space.low < space.high:
        raise BadInput(
            f"actions: range {space.low:g} to {space.high:g} rad; give a low below the high."
        )
    if not isinstance(space, Direct) and space.tau < QUICKEST:
        raise BadInput(f"actions: tau = {space.tau:g} s; give {QUICKEST:g} s or more.")
    if isinstance(space, Turning) and not 0 <= space.depth < 1:
        raise BadInput(f"actions: depth = {space.depth:g}; give 0 or more, and less than 1.")
    if isinstance(space, Generator) and space.binds not in ("fundamental", "signal"):
        raise BadInput(f"actions: binds = {space.binds!r:.40}; give fundamental or signal.")
    if isinstance(space, Generator | Turning):
        if not space.ceiling > 0:
            raise BadInput(f"actions: ceiling = {space.ceiling:g} Hz; give a frequency above 0.")
        if isinstance(space, Generator) and min(space.offset, space.first, space.second) < 0:
            raise BadInput("actions: offset, first and second are sizes; give 0 or more.")
        if not 0 <= space.floor < space.fundamental:
            raise BadInput(
                f"actions: floor = {space.floor:g} Hz; give 0 or more, and less than the highest"
                f" fundamental, {space.fundamental:g} Hz."
            )


def check_band(space: ActionSpace, edge: float) -> None:
    """Raises BadInput for a generator, or a turning motor, whose fundamental can exceed a band's
    upper edge [Hz]. Its floor may be below the lower edge."""
    if isinstance(space, Generator | Turning) and space.fundamental > edge * (1 + 1e-9):
        raise BadInput(
            f"actions: the generator's fundamental reaches {space.fundamental:g} Hz and the"
            f" identified band ends at {edge:g} Hz; lower the ceiling, or identify the fish up to"
            f" a higher frequency."
        )


def reset(space: ActionSpace, count: int) -> ActionState:
    """State of `count` fish with a straight tail at rest: the setpoint is 0, or the range's nearest
    angle. A generator starts at 0 Hz and rises to its floor within a few `tau`."""
    if isinstance(space, Generator | Turning):
        return ActionState(np.zeros((count, size(space))), np.zeros(count))
    rest = np.clip(0.0, space.low, space.high)
    return ActionState(np.full((count, 1), rest), np.zeros(count))


def step(space: ActionSpace, state: ActionState, action: Array, dt: float) -> ActionState:
    """The state after `dt` [s] of a constant action (n, size); `setpoint` reads the motor angle.
    Raises BadInput for another shape or a number that is not finite."""
    if action.shape != (len(state.phase), size(space)):
        raise BadInput(
            f"action of shape {action.shape}; {space.kind} takes {(len(state.phase), size(space))}."
        )
    if not np.isfinite(action).all():
        raise BadInput(f"action {action[~np.isfinite(action)][0]}; give finite numbers.")
    bounded = bound(action, -1.0, 1.0)
    if isinstance(space, Generator):
        return _generate(space, state, bounded, dt)
    if isinstance(space, Turning):
        return _turn(space, state, bounded, dt)
    target = space.low + (bounded + 1) / 2 * (space.high - space.low)
    if isinstance(space, Direct):
        return replace(state, u=target)
    return replace(state, u=target + (state.u - target) * np.exp(-dt / space.tau))


def bound(values: Array, low: float, high: float) -> Array:
    """`np.clip` of any shape without its checks, in a third of its time for few values."""
    return np.minimum(np.maximum(values, low), high)


def targets(space: Generator, action: Array) -> Array:
    """u* (n, 6) of actions (n, 6) in [-1, 1]: frequency, from the floor to the highest fundamental
    [rad/s]; the rest [rad]."""
    half = np.pi * (space.fundamental - space.floor)
    wanted = action * [half, space.offset, space.first, space.first, space.second, space.second]
    wanted[:, 0] += np.pi * (space.fundamental + space.floor)
    return np.asarray(wanted)


def _generate(space: Generator, state: ActionState, action: Array, dt: float) -> ActionState:
    """The exact solution of u' = (u* - u) / tau and phi' = omega over `dt`."""
    goal = targets(space, action)
    keep = np.exp(-dt / space.tau)
    turned = goal[:, 0] * dt + (state.u[:, 0] - goal[:, 0]) * space.tau * (1 - keep)
    return ActionState(goal + (state.u - goal) * keep, np.mod(state.phase + turned, TURN))


def _turn(space: Turning, state: ActionState, action: Array, dt: float) -> ActionState:
    """u' = (u* - u) / tau exactly; the motor's angle by the classical Runge-Kutta step, whose error
    over 20 ms is below 1e-4 rad at 3 Hz (a test)."""
    goal, keep = _turning_goal(space, action), math.exp(-dt / space.tau)
    ends = goal + (state.u - goal) * keep
    middle = goal + (state.u - goal) * math.sqrt(keep)
    one = _speed(state.u, state.phase)
    two = _speed(middle, state.phase + dt / 2 * one)
    three = _speed(middle, state.phase + dt / 2 * two)
    four = _speed(ends, state.phase + dt * three)
    return ActionState(ends, state.phase + dt / 6 * (one + 2 * two + 2 * three + four))


def _turning_goal(space: Turning, action: Array) -> Array:
    """u* (n, 3) of actions: speed, from the floor to the ceiling [rad/s]; two shares whose size is
    at most the depth."""
    speed = np.pi * (space.floor + space.ceiling + (space.ceiling - space.floor) * action[:, 0])
    shares = space.depth * action[:, 1:]
    longest = np.maximum(np.hypot(*action[:, 1:].T), 1.0)
    return np.column_stack([speed, shares / longest[:, None]])


def _speed(u: Array, angle: Array) -> Array:
    """Speed (n,) [rad/s] of a motor at an angle (n,) [rad]."""
    return np.asarray(u[:, 0] * (1 + u[:, 1] * np.cos(angle) + u[:, 2] * np.sin(angle)))


def setpoint(space: ActionSpace, state: ActionState) -> Array:
    """Motor setpoint (n,) [rad] of a state, clipped to the servo's range. A positive angle bends
    the tail tip to the left. A turning motor's grows with every turn."""
    if isinstance(space, Turning):
        return state.phase.copy()
    if not isinstance(space, Generator):
        return bound(state.u[:, 0], space.low, space.high)
    _, centre, a1, b1, a2, b2 = state.u.T
    first, second = state.phase, 2 * state.phase
    waves = a1 * np.cos(first) + b1 * np.sin(first) + a2 * np.cos(second) + b2 * np.sin(second)
    return bound(centre + waves, space.low, space.high)


def command(space: ActionSpace, state: ActionState) -> Array:
    """The command that the observation holds (n, 2): frequency [rad/s] and centre [rad]. Of direct
    and filtered actions it is 0 and the setpoint; of a turning motor its speed and the first
    share."""
    if isinstance(space, Generator | Turning):
        return state.u[:, :2].copy()
    return np.concatenate([np.zeros_like(state.u), state.u], axis=1)
