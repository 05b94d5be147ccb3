"""A crank steers by its speed within the turn: w(phi) = w0 (1 + a cos(phi - psi)).

In the twin of the predecessor's fish, whose coefficients were fitted to its straight swims: that
its real fish turns so has not been seen.
"""

import numpy as np
import pytest

from tailbeat.fish.description import length_of
from tailbeat.fish.rollout import Start, replay_command, swim
from tailbeat.fish.store import load_fish
from tailbeat.fish.twin import Options, compile_twin

FISH = load_fish("crank-fish")
BEAT, SECONDS, SETTLED = 1.25, 12.0, 5.0  # Hz, s, s
PHASES = (90.0, 135.0, 180.0)  # deg, and each with half a turn more


def angles(depth: float, psi: float) -> np.ndarray:
    """Angle of a crank that passes every phase at its own speed, `BEAT` turns a second."""
    time = np.arange(round(SECONDS / FISH.simulation.step)) * FISH.simulation.step
    phase = np.linspace(0, 2 * np.pi, 2001)
    middle = (phase[1:] + phase[:-1]) / 2
    passed = np.cumsum(np.diff(phase) / (1 + depth * np.cos(middle - np.radians(psi))))
    passed = np.concatenate([[0.0], passed]) / passed[-1]
    turns = np.floor(time * BEAT)
    return np.asarray(2 * np.pi * turns + np.interp(time * BEAT - turns, passed, phase))


@pytest.fixture(scope="module")
def turned() -> dict[tuple[float, float], tuple[float, float]]:
    """Surge [m/s] and yaw rate [rad/s] by depth and phase."""
    cases = [(0.0, 0.0), *((0.8, psi + half) for psi in PHASES for half in (0.0, 180.0))]
    twin, step = compile_twin(FISH, Options(replayed=True)), FISH.simulation.step
    played = [angles(*case) for case in cases]
    starts = [Start(np.zeros(3), np.zeros(3), 0.0, float(a[1] / step)) for a in played]
    done = swim([twin] * len(cases), starts, [replay_command(twin, a) for a in played], 5)
    return {case: pace(one) for case, one in zip(cases, done, strict=True)}


def pace(done) -> tuple[float, float]:
    late = done.time > SETTLED
    pose, time = done.qpos[late, :3], done.time[late]
    moved = np.gradient(pose[:, :2], time, axis=0)
    surge = moved[:, 0] * np.cos(pose[:, 2]) + moved[:, 1] * np.sin(pose[:, 2])
    return float(surge.mean()), float(np.polyfit(time, pose[:, 2], 1)[0])


def test_a_crank_that_turns_evenly_swims_straight(turned):
    surge, rate = turned[0.0, 0.0]
    assert surge > 0.15 and abs(rate) < 5e-3


@pytest.mark.parametrize("psi", PHASES)
def test_half_a_turn_more_turns_to_the_other_side(turned, psi):
    (_, one), (_, other) = turned[0.8, psi], turned[0.8, psi + 180]
    assert other == pytest.approx(-one, rel=0.1) and abs(one) > 0.05  # a few beats only


def test_it_turns_within_three_lengths(turned):
    surge, rate = turned[0.8, 135.0]
    assert abs(surge / rate) < 3 * length_of(FISH)
