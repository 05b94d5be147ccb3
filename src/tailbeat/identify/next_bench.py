"""What the test benches could still tell about a prediction: tail conditions and servo commands.

The fish's file has an interval beside each number of tail and servo. Each number is moved by one
standard deviation, and the twin plays the goal's commands and every bench recording with it. To
first order this gives what the doubts do to the goal, and how much of them a recording would take
away (the linear Bayes estimate, as for swims in `next_swim`).

The numbers count as independent, except that a servo's torques are known only in proportion to
those of its load. What swims tell about tail and servo is left out, so a bench's gain is at most
what is said.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tailbeat.fish.description import Fish, Servo
from tailbeat.fish.store import with_values
from tailbeat.identify.protocol import RATE, limits, servo_commands, tail_sweep
from tailbeat.identify.response import split
from tailbeat.identify.servo import BLOCK, DEVIATION, described_servo, tail_load
from tailbeat.identify.servo_doubt import IN_PROPORTION, LOAD_DOUBT
from tailbeat.identify.shaft import Bench, Load, free_run
from tailbeat.recording import Recording

Array = NDArray[np.float64]
Intervals = Mapping[str, tuple[float, float]]  # of numbers by dotted path, 95 %, in SI
SIGMAS = 2 * 1.96  # standard deviations in a 95 % interval
TORQUE = 0.02  # error of a tail condition's response, over its size; chosen: 16 of the pool's agree
CLAMPING = 60.0  # s to prepare a recording on a test bench; chosen
COMMON = "servo torques"  # the doubt of their load
Moved = Mapping[str, tuple[Fish, ...]]  # by the number that was moved: up, or up and down


@dataclass(frozen=True, eq=False)
class BenchRecording:
    """A recording that a test bench could make: its `kind`, the lab time in `minutes`, and what it
    would tell about the doubts (q, q), an information in units of their deviations."""

    kind: str
    minutes: float
    told: Array


def doubted(fish: Fish, known: Intervals) -> Moved:
    """The fish with one number moved up by one standard deviation, for each number of tail and
    servo that has an interval; of the servo's torques also all together. Empty without any, or if
    the tail has no `k_eff`: then no test bench has seen it.

    The largest torque matters only to commands that reach it, which a higher and a lower one tell
    differently. So the fish with a lower one stands beside."""
    if fish.tail.k_eff is None:
        return {}
    load = _load_doubt(fish)
    moved = {
        path: values
        for path in known
        if (values := _moved(fish, path, known[path], load)) is not None
    }
    if any(_torque(fish, path) for path in moved):
        moved[COMMON] = [
            {
                path: value * (1 + load)
                for path, value in _servo(fish).items()
                if path.rpartition(".")[2] in IN_PROPORTION
            }
        ]
    return {name: tuple(with_values(fish, one) for one in each) for name, each in moved.items()}


def _moved(
    fish: Fish, path: str, interval: tuple[float, float], load: float
) -> list[dict[str, float]] | None:
    """The numbers to set for one doubt; None for one that is neither tail's nor servo's."""
    away = (interval[1] - interval[0]) / SIGMAS
    tail, servo = fish.tail, _servo(fish)
    if path == "tail.k_eff" and tail.k_eff:
        stiffer = 1 + away / tail.k_eff
        hinges = {f"tail.links.{i}.stiffness": k.stiffness for i, k in enumerate(tail.links)}
        return [{name: stiffer * k for name, k in {path: tail.k_eff, **hinges}.items()}]
    if path in ("tail.damping_time", "tail.friction"):
        return [{path: getattr(tail, path.removeprefix("tail.")) + away}]
    if path not in servo:
        return None
    if _torque(fish, path):  # what is its own, beside the load's doubt
        away = max(away**2 - (load * servo[path]) ** 2, 0.0) ** 0.5
    up = servo[path] + away
    if path.endswith("force_limit"):
        return [{path: up}, {path: servo[path] ** 2 / up}]
    return [{path: up}]


def one_of(sides: Sequence[Array], pick: Callable[[Array], np.intp]) -> Array:
    """The effect of one doubt, from those of the fish moved up and down; of two, as `pick` (argmin
    or argmax) says by their sizes. Turned so that it is that of moving up."""
    chosen = int(pick(np.array([float(np.sum(one**2)) for one in sides])))
    return np.asarray(sides[chosen] if chosen == 0 else -sides[chosen])


def _servo(fish: Fish) -> dict[str, float]:
    """The active servo's numbers by dotted path."""
    own = fish.servos[fish.servo].model_dump()
    return {f"servos.{fish.servo}.{name}": value for name, value in own.items()}


def _torque(fish: Fish, path: str) -> bool:
    return path in _servo(fish) and path.rpartition(".")[2] in IN_PROPORTION


def _load_doubt(fish: Fish) -> float:
    """Standard deviation of the scale of a servo's torques that were measured against the fish's
    tail (see `servo_doubt.load_doubt`)."""
    kp, load, widest = fish.servos[fish.servo].kp, tail_load(fish), limits(fish).angle
    return float(np.hypot(LOAD_DOUBT, DEVIATION * kp / (load.stiffness * widest)))


# ---- what recordings would tell -----------------------------------------------------------------


def bench_recordings(fish: Fish, moved: Moved) -> dict[str, BenchRecording]:
    """Every condition of the tail's protocol, and every servo command, by name."""
    own = Shaft(fish.servos[fish.servo], tail_load(fish))
    shafts = [
        [Shaft(one.servos[one.servo], tail_load(one)) for one in each] for each in moved.values()
    ]
    limit, doubt = limits(fish), _load_doubt(fish)
    conditions = {
        f"tail at {label}": _of_condition(own, shafts, part, label)
        for part, label in split(tail_sweep(fish, limit))
    }
    commands = {
        name: _of_command(own, shafts, command, doubt)
        for name, command in servo_commands(fish, limit).items()
    }
    return conditions | commands


class Shaft(NamedTuple):
    """A servo and the tail in air that it turns."""

    servo: Servo
    tail: Load


def _of_condition(
    own: Shaft, moved: Sequence[Sequence[Shaft]], part: Recording, label: str
) -> BenchRecording:
    omega = 2 * np.pi * float(label.split()[0])
    stroke = float(np.abs(part.columns["command_rad"]).max())
    expected = _response(own.tail, omega, stroke)
    away = [(_response(each[0].tail, omega, stroke) - expected) / abs(expected) for each in moved]
    seen = np.array([[one.real, one.imag] for one in away]) / TORQUE
    return BenchRecording("tail condition", _minutes(part), seen @ seen.T)


def _response(tail: Load, omega: float, stroke: float) -> complex:
    """T / Theta [N m/rad] of a tail in air (see `tail.py`)."""
    rub = 4 * tail.friction / (np.pi * stroke)
    return complex(tail.stiffness - tail.inertia * omega**2, tail.damping * omega + rub)


def _of_command(
    own: Shaft, moved: Sequence[Sequence[Shaft]], command: Recording, doubt: float
) -> BenchRecording:
    """The load's `doubt`, a fraction, is one number more, which no recording tells."""
    error = DEVIATION * np.sqrt(BLOCK * RATE)  # the residuals of one block count as one
    expected = _angle(own, command)
    away = [[_angle(one, command) - expected for one in each] for each in moved]
    shown = np.array([one_of(each, np.argmin) for each in away]) / error
    seen = np.nan_to_num(shown)  # a servo that is unstable at the step tells nothing
    hidden = (_angle(Shaft(own.servo, _scaled(own.tail, 1 + doubt)), command) - expected) / error
    across = seen @ hidden
    told = seen @ seen.T - np.outer(across, across) / (1 + hidden @ hidden)
    return BenchRecording("servo command", _minutes(command), told)


def _scaled(load: Load, factor: float) -> Load:
    names = ("stiffness", "damping", "inertia", "friction")
    return replace(load, **{name: factor * getattr(load, name) for name in names})


def _angle(shaft: Shaft, command: Recording) -> Array:
    """Angle (k,) [rad] of a shaft on a test bench."""
    rows, load = command.columns["command_rad"], shaft.tail
    bench = Bench(command.name, command.time, rows, np.zeros_like(rows), np.ones_like(rows), load)
    return np.asarray(free_run(described_servo(shaft.servo), [bench])[0][0])


def _minutes(recording: Recording) -> float:
    return float((np.ptp(recording.time) + CLAMPING) / 60)


def left(goals: Array, told: Sequence[Array]) -> float:
    """Mean square deviation of goals (q, g), each moved by one deviation of q doubts, that is left
    after recordings that have `told` (q, q)."""
    if not goals.size:
        return 0.0
    known = np.eye(len(goals)) + np.sum([*told, np.zeros((len(goals),) * 2)], axis=0)
    return float(np.trace(goals.T @ np.linalg.solve(known, goals)) / goals.shape[1])
