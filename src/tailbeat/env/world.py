"""n fish and their targets, stepped at 50 Hz. One fish is n = 1.

Every fish has its own random generator: results are bit-identical alone or in a batch, at any
number of threads. The interfaces of gymnasium and SB3 are in `vector_env.py`.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.control import actions as act
from tailbeat.control.actions import PERIOD
from tailbeat.control.observation import COMMANDS, Samples, observe
from tailbeat.env import reward, sensors
from tailbeat.env.randomize import Randomisation
from tailbeat.env.reward import Terms
from tailbeat.env.simulator import Flags, Simulator, TwinSimulator
from tailbeat.env.task import Scene, Settings, check_settings
from tailbeat.files import BadInput
from tailbeat.fish.description import Fish
from tailbeat.identify.runs import tracked_pose

Array = NDArray[np.float64]
PUSH_STEPS = 10  # control steps that a pulse lasts
# Over the fish's reach: smallest radius of a moving target's bend, as tight as the fish turns, and
# what counts as beside it; fraction of the second half that it must stay there (all chosen).
TIGHTEST, BESIDE, KEPT = 0.6, 0.4, 0.8


@dataclass(frozen=True)
class Outcome:
    """Results of one control step of n fish: observation (n, 24) and its frames (n, 3, 6), reward
    and its terms (n,), ends (n,)."""

    observation: NDArray[np.float32]
    frames: Array
    reward: Array
    terms: Terms
    terminated: Flags
    truncated: Flags
    reached: Flags


def seeds_from(seed: int | None, count: int) -> list[int]:
    """One seed per fish, from one seed."""
    return [int(s) for s in np.random.SeedSequence(seed).generate_state(count, np.uint64)]


class World:
    """A batch of fish and their state between steps. `reset` some fish, `step` all."""

    def __init__(
        self,
        fish: Fish,
        settings: Settings,
        seeds: list[int],
        threads: int = 0,
        simulator: Simulator | None = None,
        scene: Scene | None = None,
    ) -> None:
        self.fish, self.settings, self.scene = fish, settings, scene
        self.space = check_settings(fish, settings)
        self.count, self.task = len(seeds), settings.task
        self.steps_per_episode = round(settings.task.seconds / PERIOD)
        self.simulator: Any = simulator or TwinSimulator(fish, self.count, threads, settings.draws)
        self.rngs = [np.random.default_rng(seed) for seed in seeds]
        self.seen = sensors.empty(self.count, self.steps_per_episode)
        self.pushes = np.zeros((self.count, self.steps_per_episode, 2), dtype=np.float32)
        self.age = np.zeros(self.count, dtype=np.int64)
        self.along = np.zeros(self.count, dtype=np.int64)  # index of the present target of a scene
        self.target, self.drift = np.zeros((self.count, 2)), np.zeros((self.count, 2))
        self.turn, self.goes_on = np.zeros(self.count), np.zeros(self.count, bool)
        self.near = np.zeros(self.count)  # steps of the second half spent near the target
        self.pose = np.zeros((self.count, 3))
        self.state = act.reset(self.space, self.count)
        self.commands = np.zeros((self.count, COMMANDS, 2))
        self.every = np.arange(self.count)
        self.frames = np.zeros((self.count, 3, 6))
        self.walls = np.array(settings.task.walls or (np.inf, np.inf)) / 2

    def reseed(self, seeds: list[int]) -> None:
        """Set new generators, used from the next reset on."""
        self.rngs = [np.random.default_rng(seed) for seed in seeds]

    def change(self, settings: Settings) -> None:
        """Change sensors, physics and targets from each fish's next reset on (the noise at once).
        Actions and the length of an episode stay. Raises BadInput."""
        check_settings(self.fish, settings)
        if round(settings.task.seconds / PERIOD) != self.steps_per_episode:
            raise BadInput(
                f"task: {settings.task.seconds:g} s; a world's episode length cannot change."
            )
        self.settings, self.task = settings, settings.task
        self.walls = np.array(settings.task.walls or (np.inf, np.inf)) / 2

    # ---- beginning ------------------------------------------------------------------------------

    def reset(self, which: Flags | None = None) -> NDArray[np.float32]:
        """Start new episodes for the fish in `which` (all by default); observation (n, 24)."""
        chosen = np.flatnonzero(np.ones(self.count, bool) if which is None else which)
        if chosen.size:
            self.simulator.rest(chosen)
            self.age[chosen] = self.along[chosen] = 0
            for fish in chosen:
                self._begin(int(fish), self.rngs[fish])
            self.simulator.ready(chosen)
            self._clear(chosen)
        return self._observe(self._first_readings())

    def _begin(self, fish: int, rng: np.random.Generator) -> None:
        """Draw one fish's episode: physics, target, pushes, sensor noise."""
        settings = self.settings
        self.simulator.draw(fish, settings.physics, rng)
        start = np.zeros(3) if self.scene is None else self.scene.start[fish]
        self.pose[fish] = tracked_pose(self.fish, start)
        self.target[fish] = self._draw_target(rng)
        if self.scene is not None:
            self.target[fish] = self.scene.target[fish, 0]
            self.simulator.qpos[fish, :3] = start
            self.simulator.qvel[fish, :3] = self.scene.velocity[fish]
        self._draw_motion(fish, rng)
        self.pushes[fish] = _pulses(settings.physics, self.steps_per_episode, rng)
        sensors.begin(settings.sensors, self.seen, fish, self.pose[fish], self.target[fish], rng)

    def _draw_motion(self, fish: int, rng: np.random.Generator) -> None:
        """Draw whether and how a target moves: [m] and [rad] per control step."""
        task, direction = self.task, rng.uniform(0, 2 * np.pi)
        step, self.near[fish] = task.target_speed * PERIOD, 0.0
        self.turn[fish], self.goes_on[fish] = 0.0, False
        if task.following:
            self.goes_on[fish] = rng.uniform() < task.following
            step *= rng.uniform() * self.goes_on[fish]
            tightest = TIGHTEST * self.settings.measure.reach
            self.turn[fish] = rng.uniform(-1, 1) * step / tightest
        self.drift[fish] = step * np.cos(direction), step * np.sin(direction)

    def _draw_target(self, rng: np.random.Generator) -> Array:
        """Draw a target by distance and bearing from the tag, inside the walls if there are any."""
        start = tracked_pose(self.fish, np.zeros(3))[:2]
        while True:
            distance = rng.uniform(self.task.nearest, self.task.farthest)
            bearing = self.task.arc * rng.uniform(-1, 1)
            place = start + distance * np.array([np.cos(bearing), np.sin(bearing)])
            walls = self.task.walls
            if walls is None or np.all(np.abs(place) < np.array(walls) / 2):
                return place

    def _clear(self, chosen: NDArray[np.int64]) -> None:
        fresh = act.reset(self.space, self.count)
        u, phase = self.state.u.copy(), self.state.phase.copy()
        u[chosen], phase[chosen] = fresh.u[chosen], fresh.phase[chosen]
        self.state = act.ActionState(u, phase)
        self.commands[chosen] = act.command(self.space, fresh)[chosen][:, None]

    def _first_readings(self) -> sensors.Readings:
        """Readings before the first step: the motor's state, the frames that have arrived."""
        simulator = self.simulator
        motor = simulator.qpos[:, simulator.motor].copy(), simulator.qvel[:, simulator.motor].copy()
        frames = sensors.newest(self.seen, np.asarray(self.age * PERIOD, dtype=np.float64))
        return sensors.Readings(*motor, simulator.qvel[:, 2].copy(), frames)

    # ---- stepping -------------------------------------------------------------------------------

    def step(self, action: Array) -> Outcome:
        """Step every fish by one control period under actions (n, size). Ended fish need a
        `reset`."""
        before, action = self.pose, np.asarray(action, float)
        self.state = act.step(self.space, self.state, action, PERIOD)
        age, simulator = np.minimum(self.age, self.steps_per_episode - 1), self.simulator
        lost = simulator.advance(act.setpoint(self.space, self.state), self.pushes[self.every, age])
        self.pose = tracked_pose(self.fish, simulator.qpos[:, :3])
        self._move_targets()
        self.commands[:, 1:] = self.commands[:, :-1]
        self.commands[:, 0] = act.command(self.space, self.state)
        motor = simulator.qpos[:, simulator.motor], simulator.qvel[:, simulator.motor]
        motion = sensors.Motion(before, self.pose, self.target, *motor, simulator.qvel[:, 2])
        readings = sensors.sense(self.settings.sensors, self.seen, age, motion)
        self.age = self.age + 1
        return self._judge(action, self._observe(readings), lost)

    def _move_targets(self) -> None:
        if self.scene is not None:
            away = np.hypot(*(self.target - self.pose[:, :2]).T)
            self.along = self.along + (away < self.scene.lead)
            self.target = self.scene.at(self.along)
            return
        self.target = self.target + self.drift
        c, s, (x, y) = np.cos(self.turn), np.sin(self.turn), self.drift.T
        self.drift = np.stack([c * x - s * y, s * x + c * y], axis=1)

    def _observe(self, readings: sensors.Readings) -> NDArray[np.float32]:
        self.frames = readings.frames
        return observe(
            Samples(
                readings.motor_angle,
                readings.motor_velocity,
                readings.yaw_rate,
                self.state.phase,
                self.commands,
                readings.frames,
            ),
            self.settings.measure,
        )

    def _judge(self, action: Array, seen: NDArray[np.float32], lost: Flags) -> Outcome:
        """Reward and ends, from the exact distance (paper: only the reward uses it).

        A diverged fish counts as `limit` away. Out of range counts as a truncation, not as an end.
        Every step costs its distance, so a policy would otherwise learn to leave the range.
        """
        weights, task = self.settings.reward, self.task
        away = np.where(lost, task.limit, np.hypot(*(self.target - self.pose[:, :2]).T))
        arrived = (away < task.arrival) & ~lost & ~self.goes_on
        apart = away / self.settings.measure.reach
        distance, bonus = reward.of_target(weights, apart, arrived, self.goes_on)
        terms = Terms(distance, reward.of_action(weights, action), bonus)
        if lost.any():
            seen = np.where(lost[:, None], np.float32(0), seen)
        over, ended = self.age >= self.steps_per_episode, arrived | lost
        truncated = (over | self._out_of_range()) & ~ended
        reached = arrived | self._kept(-distance < BESIDE * weights.distance) & over
        return Outcome(seen, self.frames, terms.total(), terms, ended, truncated, reached)

    def _out_of_range(self) -> Flags:
        place = self.pose[:, :2]
        outside = (np.abs(place) > self.walls).any(axis=1)
        return np.asarray((np.hypot(*place.T) > self.task.limit) | outside)

    def _kept(self, beside: Flags) -> Flags:
        """Which moving targets have been followed so far, in the episode's second half."""
        half = self.steps_per_episode / 2
        self.near = self.near + (beside & self.goes_on & (self.age > half))
        return np.asarray(self.near >= KEPT * half)


def _pulses(ranges: Randomisation, steps: int, rng: np.random.Generator) -> Array:
    """Force pulses (steps, 2) [N] on the head."""
    begins = rng.uniform(size=steps) < ranges.push_share
    force = np.zeros((steps, 2))
    for first in np.flatnonzero(begins):
        force[first : first + PUSH_STEPS] = ranges.push * rng.normal(size=2)
    return force
