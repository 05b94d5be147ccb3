"""A bench made of numbers: recordings with a known truth, for the worked example and the tests.

The tail is the closed form that `identify.tail` assumes; the servo's recordings come from the
compiled engine model, which shares no code with the fit's own integration.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tailbeat.env.sensors import SensorModel
from tailbeat.fish.description import Fish
from tailbeat.fish.rollout import Start, swim
from tailbeat.fish.twin import Options, compile_twin
from tailbeat.identify.shaft import mean_held
from tailbeat.recording import Recording

Array = NDArray[np.float64]
COUNT = SensorModel().encoder_count  # rad
STEP = 5e-4  # s, of the engine


@dataclass(frozen=True)
class TailTruth:
    """What the made tail has at the shaft: N m/rad, kg m^2, N m s/rad, N m."""

    k_eff: float = 0.98
    i_eff: float = 1.1e-3
    c_eff: float = 0.011
    coulomb: float = 0.02


@dataclass(frozen=True)
class Noise:
    """What the made sensors do: torque noise and count [N m], drift [N m/s], offset [N m], sampling
    jitter as a share of the period, sensor rate [Hz]."""

    torque: float = 0.01
    torque_count: float = 0.005
    drift: float = 0.002
    offset: float = 0.05
    jitter: float = 0.2
    rate: float = 200.0


def tail_sweep(
    truth: TailTruth,
    frequencies: tuple[float, ...],
    strokes: tuple[float, ...],
    seconds: float,
    seed: int,
    noise: Noise = Noise(),
) -> Recording:
    """Every frequency [Hz] at every stroke [rad], labelled, one after the other."""
    rng = np.random.default_rng(seed)
    parts = []
    for frequency in frequencies:
        for stroke in strokes:
            actual = frequency * (1 + 0.01 * rng.normal())  # a drive is never quite as set
            time = uneven_times(seconds, noise, rng)
            phase = 2 * np.pi * actual * time + rng.uniform(0, 2 * np.pi)
            angle = stroke * np.sin(phase)
            speed = 2 * np.pi * actual * stroke * np.cos(phase)
            push = -((2 * np.pi * actual) ** 2) * angle
            torque = tail_torque(truth, angle, speed, push)
            label = np.full(time.size, f"{frequency:g} Hz {stroke:.2f} rad")
            parts.append((time, _counts(angle + 0.03), _sensed(torque, time, noise, rng), label))
    starts = np.cumsum([0.0] + [part[0][-1] + 2 / noise.rate for part in parts[:-1]])
    time = np.concatenate([start + part[0] for start, part in zip(starts, parts, strict=True)])
    angle, torque, label = (np.concatenate([part[i] for part in parts]) for i in (1, 2, 3))
    columns = {"angle_rad": angle, "torque_nm": torque}
    return Recording("tail-sweep", time, columns, {"made": "true"}, {"condition": label})


def slow_pull(truth: TailTruth, stroke: float, period: float, seed: int) -> Recording:
    """A triangle of `period` [s], three times: what a static test sees."""
    noise = Noise(rate=20.0, drift=0.0)
    rng = np.random.default_rng(seed)
    time = uneven_times(3 * period, noise, rng)
    cycle = (time / period + 0.25) % 1.0
    angle = stroke * (1 - 4 * np.abs(cycle - 0.5))
    speed = np.where(cycle < 0.5, 1.0, -1.0) * 4 * stroke / period
    torque = _sensed(tail_torque(truth, angle, speed, 0 * angle), time, noise, rng)
    return Recording(
        "tail-static", time, {"angle_rad": _counts(angle), "torque_nm": torque}, {"made": "true"}
    )


def release(truth: TailTruth, angle: float, seconds: float, seed: int) -> Recording:
    """Held at `angle` [rad] for half a second, let go; viscous damping alone."""
    rng = np.random.default_rng(seed)
    time = uneven_times(seconds, Noise(), rng)
    since = np.maximum(time - 0.5, 0.0)
    decay = truth.c_eff / (2 * truth.i_eff)
    swing = np.sqrt(truth.k_eff / truth.i_eff - decay**2)
    wave = np.cos(swing * since) + decay / swing * np.sin(swing * since)
    signal = angle * np.exp(-decay * since) * wave
    return Recording("tail-release", time, {"angle_rad": _counts(signal)}, {"made": "true"})


def tail_torque(truth: TailTruth, angle: Array, speed: Array, push: Array) -> Array:
    """Shaft torque [N m] of angle, speed, acceleration."""
    return np.asarray(
        truth.k_eff * angle
        + truth.c_eff * speed
        + truth.i_eff * push
        + truth.coulomb * np.sign(speed)
    )


def uneven_times(seconds: float, noise: Noise, rng: np.random.Generator) -> Array:
    """Sample times [s] from 0 with jitter."""
    count = int(seconds * noise.rate)
    time = (np.arange(count) + noise.jitter * rng.uniform(-1, 1, count)) / noise.rate
    return np.asarray(time - time[0])


def _sensed(torque: Array, time: Array, noise: Noise, rng: np.random.Generator) -> Array:
    shown = torque + noise.offset + noise.drift * time + noise.torque * rng.normal(size=time.size)
    return np.asarray(np.round(shown / noise.torque_count) * noise.torque_count)


def _counts(angle: Array) -> Array:
    return np.asarray(np.round(angle / COUNT) * COUNT)


def servo_run(fish: Fish, command: Recording, seed: int, rate: float = 100.0) -> Recording:
    """The fish's own servo against its own tail in air, on a command, as a loop would record it.

    The loop passes at uneven times; at each it sends the command of that moment, which holds until
    the next, and reads the encoder.
    """
    rng = np.random.default_rng(seed)
    passes = uneven_times(float(command.time[-1]), Noise(rate=rate), rng)
    sent = np.interp(passes, command.time, command.columns["command_rad"])
    air = fish.medium.model_copy(update={"density": 1e-9, "viscosity": 0.0})
    calm = fish.simulation.model_copy(update={"step": STEP, "integrator": "implicitfast"})
    dry = fish.model_copy(update={"medium": air, "simulation": calm, "added_inertia": 0.0})
    twin = compile_twin(dry, Options(root="fixed"))
    held = mean_held(passes, sent, np.arange(0, passes[-1] + 3 * STEP, STEP))
    done = swim([twin], [Start.at_rest()], [held], 1)[0]
    angle = _counts(np.interp(passes, done.time, done.qpos[:, twin.motor]))
    return Recording(
        command.name,
        passes,
        {"command_rad": sent, "angle_rad": angle},
        {"made": "true", "load": "tail"},
    )
