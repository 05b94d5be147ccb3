"""From one fish's readings to its next setpoint; the robot's loop calls it at 50 Hz.

It uses the same observation, network and action space as training, and keeps the state between two
decisions. It uses no device and no clock. Needs only numpy and onnxruntime.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tailbeat.control import actions as act
from tailbeat.control import averages, motion
from tailbeat.control.actions import PERIOD, ActionState
from tailbeat.control.corrections import corrected_frames, zero
from tailbeat.control.motion import MotionState
from tailbeat.control.observation import COMMANDS, Samples, observe
from tailbeat.control.policy import Policy, decide

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Readings:
    """Input of one decision: motor angle [rad] and velocity [rad/s], yaw rate [rad/s], and the
    three newest `frames` (3, 6) as in `observation.Samples`, newest first; `elapsed` [s] since the
    last decision."""

    motor_angle: float
    motor_velocity: float
    yaw_rate: float
    frames: Array
    elapsed: float = PERIOD


@dataclass(frozen=True, eq=False)
class RunnerState:
    """State between two decisions: the action space's state, and the last commands (1, 3, 2),
    newest first, each a frequency [rad/s] and a centre [rad]. `motion` is the filters' state,
    `averages` (1, 2, 7) are the averages; both are None before the first decision and for a policy
    that does not see them."""

    state: ActionState
    commands: Array
    motion: MotionState | None = None
    averages: Array | None = None


@dataclass(frozen=True, eq=False)
class Decision:
    """One decision: observation (k,), action (size,), and the motor's setpoint [rad]."""

    observation: NDArray[np.float32]
    action: NDArray[np.float32]
    setpoint: float


def begin(policy: Policy) -> RunnerState:
    """The state at the start: a straight tail at rest."""
    space = policy.contract.actions
    state = act.reset(space, 1)
    return RunnerState(state, np.repeat(act.command(space, state)[:, None], COMMANDS, axis=1))


def steer(
    policy: Policy, runner_state: RunnerState, readings: Readings
) -> tuple[RunnerState, Decision]:
    """The next state and the decision. If an output of the network is not finite, the setpoint is
    NaN and the commands do not change: the caller must check for NaN."""
    space, readings = policy.contract.actions, _corrected(policy, readings)
    moved = _moved(policy, runner_state, readings)
    samples = Samples(
        np.array([readings.motor_angle]),
        np.array([readings.motor_velocity]),
        np.array([readings.yaw_rate]),
        runner_state.state.phase,
        runner_state.commands,
        readings.frames[None],
        None if moved is None else motion.observed(moved, readings.frames[:1, 2]),
    )
    kept = _averaged(policy, runner_state, samples, readings.elapsed)
    seen = observe(replace(samples, averages=kept), policy.contract.measure)
    action = decide(policy, seen)
    if not np.isfinite(action).all():
        unmoved = runner_state if moved is None else replace(runner_state, motion=moved)
        return unmoved, Decision(seen[0], action[0], float("nan"))
    state = act.step(space, runner_state.state, np.asarray(action, float), policy.contract.period)
    newest = act.command(space, state)[:, None]
    commands = np.concatenate([newest, runner_state.commands[:, :-1]], axis=1)
    setpoint = float(act.setpoint(space, state)[0]) + zero(policy.contract.corrections)
    return RunnerState(state, commands, moved, kept), Decision(seen[0], action[0], setpoint)


def _corrected(policy: Policy, readings: Readings) -> Readings:
    """The readings without what is known to be wrong on this robot."""
    known = policy.contract.corrections
    if known is None:
        return readings
    gyro = known.yaw_rate if policy.contract.yaw_rate == "imu" else 0.0
    return replace(
        readings,
        motor_angle=readings.motor_angle - known.shaft,
        yaw_rate=readings.yaw_rate - gyro,
        frames=corrected_frames(known, readings.frames[None])[0],
    )


def _moved(policy: Policy, runner_state: RunnerState, readings: Readings) -> MotionState | None:
    """The filters' state with this decision's frames; None if the policy sees no velocities."""
    constants, frames = policy.contract.motion, readings.frames[None]
    if constants is None:
        return None
    if runner_state.motion is None:
        return motion.begin(constants, frames)
    return motion.update(constants, runner_state.motion, frames, readings.elapsed)


def _averaged(
    policy: Policy, runner_state: RunnerState, samples: Samples, elapsed: float
) -> Array | None:
    """The averages with this decision's samples; None if the policy sees none."""
    constants = policy.contract.averages
    if constants is None:
        return None
    if runner_state.averages is None:
        return averages.begin(1)
    setpoint = act.setpoint(policy.contract.actions, runner_state.state)
    return averages.update(constants, runner_state.averages, samples, setpoint, elapsed)
