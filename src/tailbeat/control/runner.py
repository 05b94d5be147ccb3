"""From one fish's readings to its next setpoint; the robot's loop calls it at 50 Hz.

It uses the same observation, network and action space as training, and keeps the state between two
decisions. It uses no device and no clock. Needs only numpy and onnxruntime.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tailbeat.control import actions as act
from tailbeat.control.actions import ActionState
from tailbeat.control.observation import COMMANDS, Samples, observe
from tailbeat.control.policy import Policy, decide

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Readings:
    """Input of one decision: motor angle [rad] and velocity [rad/s], yaw rate [rad/s], and the
    three newest `frames` (3, 6) as in `observation.Samples`, newest first."""

    motor_angle: float
    motor_velocity: float
    yaw_rate: float
    frames: Array


@dataclass(frozen=True, eq=False)
class RunnerState:
    """State between two decisions: the action space's state, and the last commands (1, 3, 2),
    newest first, each a frequency [rad/s] and a centre [rad]."""

    state: ActionState
    commands: Array


@dataclass(frozen=True, eq=False)
class Decision:
    """One decision: observation (24,), action (size,), and the motor's setpoint [rad]."""

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
    NaN and the state does not change: the caller must check for NaN."""
    space = policy.contract.actions
    samples = Samples(
        np.array([readings.motor_angle]),
        np.array([readings.motor_velocity]),
        np.array([readings.yaw_rate]),
        runner_state.state.phase,
        runner_state.commands,
        readings.frames[None],
    )
    seen = observe(samples, policy.contract.measure)
    action = decide(policy, seen)
    if not np.isfinite(action).all():
        return runner_state, Decision(seen[0], action[0], float("nan"))
    state = act.step(space, runner_state.state, np.asarray(action, float), policy.contract.period)
    newest = act.command(space, state)[:, None]
    commands = np.concatenate([newest, runner_state.commands[:, :-1]], axis=1)
    setpoint = float(act.setpoint(space, state)[0])
    return RunnerState(state, commands), Decision(seen[0], action[0], setpoint)
