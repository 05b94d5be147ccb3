"""Swim a fish under repeated commands of the generator, and measure how it goes on.

No policy and no sensors. All swims begin at rest in open water; the command is held for 20 ms. Many
fish swim together: in the pool's plant each has its own water, and the twin has one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tailbeat.control import actions as act
from tailbeat.control.actions import PERIOD, Generator
from tailbeat.evaluate.trial import Progress
from tailbeat.fish.description import Fish
from tailbeat.fish.rollout import Start, swim
from tailbeat.fish.twin import Twin, compile_twin
from tailbeat.identify.tag_pose import tracked_pose
from tailbeat.pool.plant import at_rest, build_plant, step_plant
from tailbeat.pool.water import Water

Array = NDArray[np.float64]
LATE = 1 / 3  # of a swim, at its end: it is measured there
CHUNK = 64  # swims in one batch: bounds the memory


@dataclass(frozen=True)
class Command:
    """A beat: frequency [Hz], amplitude of the first harmonic [rad], centre [rad]. With `rest` [s]
    above 0 the tail beats for `burst` [s], then rests about the same centre, and so on."""

    frequency: float
    amplitude: float
    centre: float
    burst: float = 0.0
    rest: float = 0.0

    @property
    def period(self) -> float:
        """Time after which the command repeats itself [s]."""
        return self.burst + self.rest if self.rest else 1 / self.frequency


@dataclass(frozen=True, eq=False)
class Steady:
    """How swims (n,) go on: speed [m/s], negative backwards, and turning rate [rad/s], positive to
    the left. NaN where the simulation was lost."""

    speed: Array
    rate: Array

    @property
    def radius(self) -> Array:
        """Radius of the circle that each swim makes [m], infinite if it goes straight."""
        with np.errstate(divide="ignore"):
            return np.asarray(np.abs(self.speed / self.rate))


@dataclass(frozen=True)
class Swimmer:
    """Where swims take place: the plant of the virtual pool with `fish`, one swim in each of its
    `waters`, or the twin of `fish` if there are no waters."""

    fish: Fish
    waters: tuple[Water, ...] = ()

    @property
    def name(self) -> str:
        """What it is called in tables and figures."""
        return "pool" if self.waters else "twin"

    @property
    def count(self) -> int:
        """Number of swims under each command."""
        return max(len(self.waters), 1)


def poses(swimmer: Swimmer, setpoints: Array, progress: Progress) -> Array:
    """Poses (waters, n, k + 1, 3) x, y [m], yaw [rad] of the tag, under setpoints (n, k) [rad].
    They are NaN for a swim that was lost."""
    jobs = [(w, i) for w in range(swimmer.count) for i in range(len(setpoints))]
    twin = None if swimmer.waters else compile_twin(swimmer.fish)
    found = np.empty((len(jobs), setpoints.shape[1] + 1, 3))
    for first in range(0, len(jobs), CHUNK):
        progress(f"swims in the {swimmer.name}", first, len(jobs))
        part = jobs[first : first + CHUNK]
        commands = setpoints[[i for _, i in part]]
        if twin is None:
            waters = [swimmer.waters[w] for w, _ in part]
            found[first : first + CHUNK] = _in_pool(swimmer.fish, waters, commands)
        else:
            found[first : first + CHUNK] = _in_twin(twin, commands)
    progress(f"swims in the {swimmer.name}", len(jobs), len(jobs))
    return tracked_pose(swimmer.fish, found).reshape(swimmer.count, len(setpoints), -1, 3)


def _in_pool(fish: Fish, waters: Sequence[Water], setpoints: Array) -> Array:
    """Poses (n, k + 1, 3) of the fish frame in the plant."""
    plant = build_plant(fish, waters)
    each = round(PERIOD / plant.dt)
    swum = step_plant(plant, at_rest(plant), np.repeat(setpoints, each, axis=1), each)
    return np.where(swum.lost[:, None, None], np.nan, swum.q[:, :, :3])


def _in_twin(twin: Twin, setpoints: Array) -> Array:
    """Poses (n, k + 1, 3) of the fish frame in the twin."""
    each = round(PERIOD / twin.model.opt.timestep)
    commands = np.repeat(setpoints, each, axis=1)
    done = swim([twin] * len(commands), [Start.at_rest()] * len(commands), list(commands), each)
    return np.stack([np.where(one.diverged, np.nan, one.qpos[:, :3]) for one in done])


def setpoints(space: Generator, commands: Sequence[Command], seconds: float) -> Array:
    """Setpoints (n, k) [rad] of the generator that follows each command for `seconds` [s]."""
    return played(space, scripted(space, commands, seconds))


def scripted(space: Generator, commands: Sequence[Command], seconds: float) -> Array:
    """Actions (n, k, 6) in [-1, 1] of each command at every control step. A generator at rest has
    frequency and amplitude 0."""
    time = np.asarray(PERIOD * np.arange(round(seconds / PERIOD)), float)
    beats = np.array([action(space, one) for one in commands])
    rests = np.array([action(space, Command(0.0, 0.0, one.centre)) for one in commands])
    beating = np.array([_beating(one, time) for one in commands])
    return np.where(beating[..., None], beats[:, None], rests[:, None])


def _beating(command: Command, time: Array) -> NDArray[np.bool_]:
    if not command.rest:
        return np.ones(len(time), bool)
    return np.asarray(np.mod(time + 1e-9, command.period) < command.burst)


def action(space: Generator, command: Command) -> Array:
    """The action (6,) that means a command's beat: frequency, centre, and b_1; a_1 and the second
    harmonic are 0."""
    half = (space.fundamental - space.floor) / 2
    found = np.zeros(6)
    found[0] = (command.frequency - space.floor) / half - 1
    found[1] = command.centre / space.offset
    found[3] = command.amplitude / space.first
    return found


def played(space: Generator, actions: Array) -> Array:
    """Setpoints (n, k) [rad] of the generator under actions (n, k, 6), from a straight tail."""
    state = act.reset(space, len(actions))
    found = np.empty(actions.shape[:2])
    for k in range(actions.shape[1]):
        state = act.step(space, state, actions[:, k], PERIOD)
        found[:, k] = act.setpoint(space, state)
    return found


def steady(pose: Array, periods: Sequence[float]) -> Steady:
    """How swims with poses (n, k + 1, 3) at every 20 ms go on, if each repeats itself after its
    period [s]. Measured over whole periods in their last third."""
    pairs = [_steady(one, period) for one, period in zip(pose, periods, strict=True)]
    speed, rate = np.array(pairs).T
    return Steady(speed, rate)


def _steady(pose: Array, period: float) -> tuple[float, float]:
    """Mean velocity in a frame that turns evenly with the fish, along the mean heading. The fish's
    recoil within a period has no part in it, and a circle keeps its true radius: in this frame the
    velocity repeats itself, and its mean is the turning rate times the path's mean radius."""
    time = PERIOD * np.arange(len(pose))
    span = max(int(LATE * time[-1] / period), 1) * period
    chosen = np.linspace(time[-1] - span, time[-1], round(span / PERIOD) + 1)
    x, y, yaw = (np.interp(chosen, time, column) for column in pose.T)
    rate = (yaw[-1] - yaw[0]) / span
    middle = (chosen[1:] + chosen[:-1]) / 2 - chosen[0]
    velocity = (np.diff(x) + 1j * np.diff(y)) / np.diff(chosen)
    mean = (velocity * np.exp(-1j * rate * middle)).mean()
    heading = np.mean(yaw - rate * (chosen - chosen[0]))
    ahead = (mean * np.exp(-1j * heading)).real
    return float(np.copysign(abs(mean), ahead)), float(rate)
