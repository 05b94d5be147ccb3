"""n fish and their targets, stepped at 50 Hz. One fish is n = 1.

Every fish has its own random generator: results are bit-identical alone or in a batch, at any
number of threads. The interfaces of gymnasium and SB3 are in `vector_env.py`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tailbeat.control import actions as act
from tailbeat.control import averages, motion
from tailbeat.control.actions import PERIOD
from tailbeat.control.corrections import zero
from tailbeat.control.observation import COMMANDS, Samples, observe
from tailbeat.env import errors, randomize, reward, sensors, target_paths
from tailbeat.env.errors import Errors
from tailbeat.env.reward import Terms
from tailbeat.env.simulator import Flags, Simulator, TwinSimulator
from tailbeat.env.task import Scene, Settings, check_settings
from tailbeat.files import BadInput
from tailbeat.fish.description import Fish
from tailbeat.identify.tag_pose import tracked_pose

Array = NDArray[np.float64]
EVERY = slice(None)
# A fish has followed if it was beside its target, this far over its reach, for a fraction of the
# steps that count; none do for some seconds after a target appears (chosen).
BESIDE, KEPT, SETTLING = 0.4, 0.8, 8.0
JUMP = 0.1  # m in one step: a new target


@dataclass(frozen=True)
class Outcome:
    """Results of one control step of n fish: observation (n, k) and its frames (n, 3, 6),
    reward and its terms (n,), ends (n,)."""

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
        wrong: Sequence[Errors] = (),
    ) -> None:
        self.fish, self.settings, self.scene = fish, settings, scene
        self.space = check_settings(fish, settings)
        self.count, self.task = len(seeds), settings.task
        self.steps_per_episode = round(settings.task.seconds / PERIOD)
        self.simulator: Any = simulator or TwinSimulator(fish, self.count, threads, settings.draws)
        self.rngs = [np.random.default_rng(seed) for seed in seeds]
        self.seen = sensors.empty(self.count, self.steps_per_episode)
        self.wrong, self.fixed = errors.rows(wrong or [errors.NONE] * self.count), bool(wrong)
        self.right = not self.fixed and settings.errors is None  # nobody has anything wrong
        self.pushes = np.zeros((self.count, self.steps_per_episode, 2), dtype=np.float32)
        self.age, self.along = np.zeros((2, self.count), dtype=np.int64)  # steps; target of a scene
        self.target, self.pull = np.zeros((2, self.count, 2))  # m; N, steady part of the pushes
        self.paths = np.zeros((self.count, self.steps_per_episode + 1, 2))  # of moving targets
        self.here, self.counted, self.near = np.zeros((3, self.count))  # steps at a target
        self.pose = np.zeros((self.count, 3))
        self.went = np.zeros((self.count, 2, 2))  # how tag and target moved in the last step [m]
        self.state = act.reset(self.space, self.count)
        self.commands = np.zeros((self.count, COMMANDS, 2))
        self.every = np.arange(self.count)
        self.frames = np.zeros((self.count, 3, 6))  # as the policy gets them
        self.read = self._first_readings()  # the newest, before corrections
        self.motion = motion.begin(sensors.motion_filter(), self.frames)
        self.averages = averages.begin(self.count)
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
        self.right = not self.fixed and settings.errors is None
        self.walls = np.array(settings.task.walls or (np.inf, np.inf)) / 2

    # ---- beginning ------------------------------------------------------------------------------

    def reset(self, which: Flags | None = None) -> NDArray[np.float32]:
        """Start new episodes for the fish in `which` (all by default); observation (n, k)."""
        chosen = np.flatnonzero(np.ones(self.count, bool) if which is None else which)
        if chosen.size:
            self.simulator.rest(chosen)
            self.age[chosen] = self.along[chosen] = 0
            for fish in chosen:
                self._begin(int(fish), self.rngs[fish])
            self.simulator.ready(chosen)
            self._clear(chosen)
        self.read = self._first_readings()
        readings = sensors.corrected(self.settings.corrections, self.read)
        if chosen.size and self.settings.motion is not None:
            first = motion.begin(self.settings.motion, readings.frames)
            for held, new in zip(self.motion, first, strict=True):
                held[chosen] = new[chosen]
        self.averages[chosen] = 0.0
        return self._observe(readings)

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
        self._draw_path(fish, rng)
        self.pushes[fish] = randomize.pulses(settings.physics, self.steps_per_episode, rng)
        if settings.hard is not None:
            self.pull[fish] = self.simulator.harden(fish, settings.hard, rng)
            self.pushes[fish] += self.pull[fish]
        if settings.errors is not None:
            self.wrong[fish] = errors.rows([errors.draw(settings.errors, rng)])[0]
        elif not self.fixed:
            self.wrong[fish] = 0.0
        only = slice(fish, fish + 1)
        pose, target = self._filmed(self.pose, only)[0], self._seen(self.target, only)[0]
        sensors.begin(settings.sensors, self.seen, fish, pose, target, rng)
        if not self.right:
            errors.begin(self.wrong[fish], self.seen, fish, rng)

    def _draw_path(self, fish: int, rng: np.random.Generator) -> None:
        """Draw where a target goes, from its first position."""
        task, reach = self.task, self.settings.measure.reach
        self.here[fish] = self.counted[fish] = self.near[fish] = 0.0
        if not task.follow:
            rng.uniform()  # earlier versions drew here; a seed gives the same noise as in them
            return
        begin, steps = self.target[fish], self.steps_per_episode
        self.paths[fish] = target_paths.draw(begin, steps, task.target_speed, reach, rng)

    def _draw_target(self, rng: np.random.Generator) -> Array:
        """Draw a target by distance and bearing from the tag, inside the walls if there are any."""
        start = tracked_pose(self.fish, np.zeros(3))[:2]
        while True:
            distance = rng.uniform(self.task.nearest, self.task.farthest)
            side, least = rng.uniform(-1, 1), self.task.least_arc
            bearing = np.copysign(least + (self.task.arc - least) * abs(side), side)
            place = start + distance * np.array([np.cos(bearing), np.sin(bearing)])
            walls = self.task.walls
            if walls is None or np.all(np.abs(place) < np.array(walls) / 2):
                return place

    def _filmed(self, pose: Array, which: slice = EVERY) -> Array:
        return pose[which] if self.right else errors.filmed(self.wrong[which], pose[which])

    def _seen(self, place: Array, which: slice = EVERY) -> Array:
        return place[which] if self.right else errors.seen(self.wrong[which], place[which])

    def _clear(self, chosen: NDArray[np.int64]) -> None:
        fresh = act.reset(self.space, self.count)
        u, phase = self.state.u.copy(), self.state.phase.copy()
        u[chosen], phase[chosen] = fresh.u[chosen], fresh.phase[chosen]
        self.state = act.ActionState(u, phase)
        self.commands[chosen] = act.command(self.space, fresh)[chosen][:, None]

    def _first_readings(self) -> sensors.Readings:
        """Readings before the first step: the motor's state, the frames that have arrived."""
        simulator = self.simulator
        motor = self._encoder(), simulator.qvel[:, simulator.motor].copy()
        frames = sensors.newest(self.seen, np.asarray(self.age * PERIOD, dtype=np.float64))
        return sensors.Readings(*motor, simulator.qvel[:, 2].copy(), frames)

    # ---- stepping -------------------------------------------------------------------------------

    def step(self, action: Array) -> Outcome:
        """Step every fish by one control period under actions (n, size). Ended fish need a
        `reset`."""
        before, action = self.pose, np.asarray(action, float)
        self.state = act.step(self.space, self.state, action, PERIOD)
        age, simulator = np.minimum(self.age, self.steps_per_episode - 1), self.simulator
        setpoint = act.setpoint(self.space, self.state)
        sent = setpoint + zero(self.settings.corrections)
        wanted = sent if self.right else sent + self.wrong["horn"]
        lost = simulator.advance(wanted, self.pushes[self.every, age])
        self.pose = tracked_pose(self.fish, simulator.qpos[:, :3])
        was = self._move_targets()
        self.went = np.stack([(self.pose - before)[:, :2], self.target - was], axis=1)
        self.commands[:, 1:] = self.commands[:, :-1]
        self.commands[:, 0] = act.command(self.space, self.state)
        moved = self._moved(before, was)
        self.read = sensors.sense(self.settings.sensors, self.seen, age, moved)
        readings = sensors.corrected(self.settings.corrections, self.read)
        if self.settings.motion is not None:
            self.motion = motion.update(self.settings.motion, self.motion, readings.frames, PERIOD)
        self.age = self.age + 1
        return self._judge(action, self._observe(readings, PERIOD), lost)

    def _moved(self, before: Array, was: Array) -> sensors.Motion:
        """What the sensors see of this step, with what the lab has wrong."""
        simulator = self.simulator
        poses = self._filmed(before), self._filmed(self.pose)
        targets = self._seen(was), self._seen(self.target)
        velocity = simulator.qvel[:, simulator.motor]
        return sensors.Motion(*poses, *targets, self._encoder(), velocity, simulator.qvel[:, 2])

    def _encoder(self) -> Array:
        """Shaft angles (n,) [rad] as the servos count them."""
        angle = np.array(self.simulator.qpos[:, self.simulator.motor])
        return angle if self.right else angle - self.wrong["horn"] + self.wrong["encoder"]

    def _move_targets(self) -> Array:
        """Move the targets. Returns where they were (n, 2) [m]; one that jumped was never between
        its old and its new place, so it is as if it had been at the new one."""
        before = self.target
        if self.scene is not None:
            away = np.hypot(*(self.target - self.pose[:, :2]).T)
            self.along = self.along + (away < self.scene.lead)
            self.target = self.scene.at(self.along)
        elif self.task.follow:
            self.target = self.paths[self.every, np.minimum(self.age + 1, self.steps_per_episode)]
        new = np.hypot(*(self.target - before).T) > JUMP * self.settings.measure.reach
        self.here = np.where(new, 0.0, self.here + 1)
        return np.where(new[:, None], self.target, before)

    def _observe(self, readings: sensors.Readings, elapsed: float = 0.0) -> NDArray[np.float32]:
        self.frames, yaw_rate = readings.frames, readings.yaw_rate
        if self.settings.yaw_rate == "camera":
            yaw_rate = sensors.camera_yaw_rate(self.seen, self.age.astype(np.float64) * PERIOD)
        felt = readings.motor_angle, readings.motor_velocity, yaw_rate, self.state.phase
        samples = Samples(*felt, self.commands, readings.frames)
        if self.settings.motion is not None:
            velocities = motion.observed(self.motion, self.frames[:, 0, 2])
            samples = replace(samples, motion=velocities)
        if (spans := self.settings.averages) is not None:
            sent = act.setpoint(self.space, self.state)
            self.averages = averages.update(spans, self.averages, samples, sent, elapsed)
            samples = replace(samples, averages=self.averages)
        return observe(samples, self.settings.measure)

    def _judge(self, action: Array, seen: NDArray[np.float32], lost: Flags) -> Outcome:
        """Reward and ends, from the exact distance (paper: only the reward uses it).

        A diverged fish counts as `limit` away. Out of range counts as a truncation, not as an end.
        Every step costs its distance, so a policy would otherwise learn to leave the range.
        """
        weights, task = self.settings.reward, self.task
        away = np.where(lost, task.limit, np.hypot(*(self.target - self.pose[:, :2]).T))
        arrived = (away < task.arrival) & ~lost & (not task.follow)
        apart = away / self.settings.measure.reach
        distance, bonus = reward.of_target(weights, apart, arrived, task.follow, self._missed())
        terms = Terms(distance, reward.of_action(weights, action), bonus)
        if lost.any():
            seen = np.where(lost[:, None], np.float32(0), seen)
        over, ended = self.age >= self.steps_per_episode, arrived | lost
        truncated = (over | self._out_of_range()) & ~ended
        reached = arrived | self._followed(apart < BESIDE) & over
        return Outcome(seen, self.frames, terms.total(), terms, ended, truncated, reached)

    def _missed(self) -> Array:
        """How far every fish is from the wanted velocity (n,); NaN of one that diverged."""
        apart, went = (reward.in_plane(x) for x in (self.target - self.pose[:, :2], self.went))
        return np.asarray(reward.missed(went[:, 0], went[:, 1], apart, self.settings.measure))

    def _out_of_range(self) -> Flags:
        place = self.pose[:, :2]
        outside = (np.abs(place) > self.walls).any(axis=1)
        return np.asarray((np.hypot(*place.T) > self.task.limit) | outside)

    def _followed(self, beside: Flags) -> Flags:
        """Which fish have stayed beside their targets so far."""
        if not self.task.follow:
            return np.zeros(self.count, bool)
        counts = self.here * PERIOD > SETTLING * self.settings.measure.time
        self.counted, self.near = self.counted + counts, self.near + (beside & counts)
        return np.asarray((self.near >= KEPT * self.counted) & (self.counted > 0))
