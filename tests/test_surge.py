"""Added mass that acts across a part and not along it."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tailbeat.fish.description import Fish
from tailbeat.fish.rollout import Start, swim
from tailbeat.fish.store import load_fish, with_values
from tailbeat.fish.twin import compile_twin

MASS, INERTIA, ADDED = 1.0, 0.01, 0.8  # kg, kg m^2, kg: ADDED across, spread over LENGTH
LENGTH = 0.3


def hull(added_along: float, blunt: float = 0.0) -> Fish:
    """A head that carries water in an ideal fluid, its tail a speck of a stiff link."""
    zero = dict.fromkeys(("blunt", "slender", "angular", "kutta", "magnus"), 0.0)
    head = {
        "parts": [
            {
                "name": "hull",
                "position": (0.0, 0.0, 0.0),
                "size": (LENGTH, 0.05, 0.1),
                "zone": "head",
                "added_mass": ADDED,
            }
        ],
        "inertial": {"mass": MASS, "centre": (0.0, 0.0, 0.0), "inertia": (INERTIA,) * 3},
    }
    link = {
        "hinge": -0.15,
        "stiffness": 10.0,
        "guides": [(-0.16, 0.01)],
        "parts": [{"name": "speck", "position": (-0.155, 0, 0), "size": (0.01,) * 3, "mass": 1e-5}],
    }
    servo = {"kp": 1, "kv": 0.1, "armature": 1e-3, "damping": 0.1, "force_limit": 1, "delay": 0}
    return Fish.model_validate(
        {
            "name": "hull",
            "medium": {"density": 1000.0, "viscosity": 0.0},
            "simulation": {"step": 0.002, "integrator": "Euler"},
            "band": (1.0, 4.0),
            "zones": {"head": {**zero, "blunt": blunt}},
            "head": head,
            "motor": {
                "kind": "pulley",
                "position": (-0.1, 0, 0),
                "radius": 0.01,
                "mass": 1e-5,
                "range": (-1.0, 1.0),
            },
            "servo": "s",
            "servos": {"s": servo},
            "tendons": {"head_guides": [(-0.14, 0.01)]},
            "tail": {"links": [link], "damping_time": 0.01},
            "added_inertia": 1.0,
            "added_along": added_along,
        }
    )


def coast(fish: Fish, start: Start, seconds: float) -> np.ndarray:
    """Poses (k, 3) every 20 ms, the motor at rest."""
    twin = compile_twin(fish)
    step = twin.model.opt.timestep
    return swim([twin], [start], [np.zeros(round(seconds / step))], round(0.02 / step))[0].qpos


def kirchhoff(along: float, velocity: tuple[float, float, float], time: np.ndarray) -> np.ndarray:
    """Poses (k, 3) of a rigid body in ideal water: Lamb, Hydrodynamics, art. 126, planar."""
    surge, sway = MASS + along * ADDED, MASS + ADDED
    turning = INERTIA + ADDED / 12 * (LENGTH**2 + 0.05**2)

    def rate(_: float, s: np.ndarray) -> list[float]:
        yaw, u, v, w = s[2:]
        c, d = np.cos(yaw), np.sin(yaw)
        return [c * u - d * v, d * u + c * v, w, sway * v * w / surge, -surge * u * w / sway,
                (surge - sway) * u * v / turning]  # fmt: skip

    start = [0.0, 0.0, 0.0, *velocity]
    return solve_ivp(rate, (0, time[-1]), start, t_eval=time, rtol=1e-9).y[:3].T


@pytest.mark.parametrize(
    "velocity",
    [(0.2, 0.02, 0.1), (-0.2, 0.03, 0.0), (0.1, 0.1, -0.4), (0.2, 0.1, 2.0), (0.3, -0.1, 3.0)],
)
def test_a_rigid_fish_in_ideal_water_moves_by_kirchhoffs_equations(velocity) -> None:
    """Tight turns too: a surge force that was late by 20 ms erred there by 5 % of the way."""
    time = np.arange(0, 1.5, 0.02)
    found = coast(hull(0.0), Start(np.zeros(3), np.array(velocity)), time[-1])
    exact, blind = kirchhoff(0.0, velocity, time), kirchhoff(1.0, velocity, time)
    n = min(len(found), len(time))
    way = np.abs(exact[:n] - exact[0]).max(axis=0)
    error = np.abs(found[:n, :3] - exact[:n]).max(axis=0)
    assert error[2] < 0.02 * max(way[2], 0.05)
    assert np.hypot(*error[:2]) < 0.004 * np.hypot(*way[:2])
    # the case can tell: without the correction the body never turns by Munk's moment
    assert np.abs(blind[:n, 2] - exact[:n, 2]).max() > 10 * error[2]


def test_along_the_chord_the_water_carried_does_not_count() -> None:
    """Drag alone slows a coasting hull: v = v0 / (1 + v0 k t / m), m the mass without water."""
    fish, v0, k = hull(0.0, blunt=0.4), 0.4, 1000 * 0.4 * np.pi * 0.025 * 0.05
    found = coast(fish, Start(np.zeros(3), np.array([v0, 0, 0])), 4.0)[:, 0]
    time = 0.02 * np.arange(len(found))
    way = {m: m / k * np.log1p(v0 * k * time / m) for m in (MASS, MASS + ADDED)}
    assert found[-1] == pytest.approx(way[MASS][-1], rel=0.01)
    assert found[-1] < 0.9 * way[MASS + ADDED][-1]


def test_the_share_along_lies_between() -> None:
    ways = [
        coast(hull(s, blunt=0.4), Start(np.zeros(3), np.array([0.4, 0, 0])), 4.0)[-1, 0]
        for s in (0.0, 0.5, 1.0)
    ]
    assert ways[0] < ways[1] < ways[2]


def test_a_shipped_fish_mirrors_with_it() -> None:
    fish = load_fish("pulley-fish-pool").model_copy(update={"added_along": 0.0})
    twin, time = compile_twin(fish), np.arange(0, 4, 0.004)
    commands = [sign * 0.6 * np.sin(2 * np.pi * 1.5 * time) for sign in (1, -1)]
    left, right = swim([twin] * 2, [Start.at_rest()] * 2, commands, 5)
    assert right.qpos[:, 1:] == pytest.approx(-left.qpos[:, 1:], abs=1e-6)
    assert left.qpos[-1, 0] > 0.5


def test_a_twin_that_diverges_stops_alone():
    fish = load_fish("pulley-fish-pool")
    wild = with_values(fish, {f"zones.{zone}.kutta": 1e5 for zone in fish.zones})
    command = 0.6 * np.sin(0.05 * np.arange(300))
    sound, lost = compile_twin(fish), compile_twin(wild)
    rest = Start.at_rest()
    alone = swim([sound], [rest], [command], 5)[0]
    both = swim([lost, sound], [rest, rest], [command, command], 5)
    assert [one.diverged for one in both] == [True, False] and not both[0].qpos.any()
    assert np.array_equal(both[1].qpos, alone.qpos) and alone.qpos[-1].any()
